//! A scan transferred by the sensor protocol gives the same pose as the original scan.

use super::sensor::{above, sensor, serve, settings};
use coaxis::device::ProfileSensor;
use coaxis::device::gocator::server::{Form, View, taken_from};
use coaxis::device::gocator::{Settings, Travel};
use coaxis::estimation::{self, Method, Outcome, Pose, Progress, estimate};
use coaxis::scan::synthetic::{Part, make};
use coaxis::scan::{Columns, Scan, Station};

const MM_PER_TICK: f64 = 0.001;

fn pose(scan: &Scan) -> Pose {
    let settings = estimation::Settings { method: Method::Cylinder, ..estimation::Settings::default() };
    match estimate(scan, &settings, &Progress::default()).outcome {
        Outcome::Accepted(pose) => *pose,
        Outcome::Refused(refusal) => panic!("refused: {refusal}"),
    }
}

#[tokio::test]
async fn the_pose_from_received_profiles_is_that_of_the_scan() {
    let (scan, truth) = make(&Part::with_interference(4)).expect("a part");
    let placement = above().place().expect("rigid");
    let taken = taken_from(&scan, &placement, MM_PER_TICK, 1_000.0).expect("in planes");
    let profiles_count = taken.len();
    let view = View::reaching(&taken, Form::PointCloud, 2.0);
    let server = serve(view, taken, None).await;
    let travel = Some(Travel::Encoder { mm_per_tick: MM_PER_TICK, start_mm: 0.0, zero_ticks: None });
    let mut sensor = sensor(&Settings { travel, ..settings(&server) });
    sensor.connect().await.expect("there");
    sensor.start(profiles_count as u64).await.expect("started");
    let (mut stations, mut y, mut z): (Vec<Station>, Vec<f32>, Vec<f32>) = Default::default();
    while stations.len() < profiles_count {
        for profile in sensor.receive().await.expect("complete") {
            let start = y.len();
            y.extend(profile.y);
            z.extend(profile.z);
            stations.push(Station { x: profile.travel_mm, start, end: y.len() });
        }
    }
    sensor.stop().await.expect("nothing lost");
    let arrived = Scan::new(stations, Columns::F32 { y, z }, "sensor".to_owned()).expect("a scan");
    let (arrived, sent) = (pose(&arrived), pose(&scan));
    // The quantization steps of 9 and 8 µm have uncertainties of 2.6 and 2.3 µm, uniform and independent, where the noise has 50:
    // they move the pose by a twentieth of its uncertainty from noise. Five times that is allowed.
    let share = 0.25;
    let bound = truth.bound.expect("noise has a bound");
    let at = sent.x_ref;
    let [arrived_yz, sent_yz] = [arrived.axis.at(at), sent.axis.at(at)];
    let moved = [
        (arrived_yz[0] - sent_yz[0], bound.y_ref_mm),
        (arrived_yz[1] - sent_yz[1], bound.z_ref_mm),
        ((arrived.axis.deflection().degrees() - sent.axis.deflection().degrees()), bound.deflection_deg),
        ((arrived.axis.pitch().degrees() - sent.axis.pitch().degrees()), bound.pitch_deg),
        (arrived.radius - sent.radius, bound.radius_mm),
    ];
    for (moved, bound) in moved {
        assert!(moved.abs() < share * bound, "moved by {moved}, where noise has the bound {bound}");
    }
}

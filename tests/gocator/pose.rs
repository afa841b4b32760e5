//! A scan over the wire gives the pose that the same scan gives as it is.

use crate::sensor::{above, sensor, serve, settings};
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
async fn the_pose_from_arrived_profiles_is_that_of_the_scan() {
    let (scan, _) = make(&Part::with_interference(4)).expect("a part");
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
        for profile in sensor.receive().await.expect("whole") {
            let start = y.len();
            y.extend(profile.y);
            z.extend(profile.z);
            stations.push(Station { x: profile.travel_mm, start, end: y.len() });
        }
    }
    sensor.stop().await.expect("nothing lost");
    let arrived = Scan::new(stations, Columns::F32 { y, z }, "sensor".to_owned()).expect("a scan");
    let (arrived, sent) = (pose(&arrived), pose(&scan));
    // Half a step of 9 and 8 µm, even and independent, is 2.6 µm at each of 256000 points, beside 50 µm of noise: what it
XX    let at = sent.x_ref;
    let [arrived_yz, sent_yz] = [arrived.axis.at(at), sent.axis.at(at)];
    for (found, wanted) in arrived_yz.into_iter().zip(sent_yz) {
        assert!((found - wanted).abs() < 1e-3, "{found} mm over the wire, {wanted} mm as it is");
    }
    assert!((arrived.axis.p - sent.axis.p).abs() < 2e-6, "{} and {}", arrived.axis.p, sent.axis.p);
    assert!((arrived.axis.q - sent.axis.q).abs() < 2e-6, "{} and {}", arrived.axis.q, sent.axis.q);
    assert!((arrived.radius - sent.radius).abs() < 1e-3);
}

//! The sensor with its protocol meets the contract of every adaptor, in every form of its output.

use super::sensor::{STEP_MM, sensor, serve, settings, taken, view};
use coaxis::device::contract::motion::check_sensor_scan;
use coaxis::device::contract::{Report, check_sensor};
use coaxis::device::gocator::server::Form;
use coaxis::device::simulated::{Mounting, Settings, World};
use coaxis::motion::{Axes, AxisLimits, Pair};

/// Profiles of a scan.
const PROFILES: usize = 50;
/// Rate of a sensor that is triggered by its clock.
const RATE_HZ: f64 = 500.0;

fn assert_passed(report: &Report) {
    assert!(report.passed(), "{report:#?}");
}

/// A cell of which only the stage is used.
fn world() -> World {
    let axis = AxisLimits { lower: -1.0, upper: 1.0, speed: 1.0, acceleration: 1.0, jerk: 1.0, step: 1.0 };
    let at = |x: f64| Mounting { mount_mm: [x, 0.0, 0.0], limits: Axes::from_fn(|_| axis) };
    let settings = Settings { time_factor: 10.0, ..Settings::default() };
    World::new(&settings, &Pair { m1: at(150.0), m2: at(650.0) }).expect("settings that are allowed")
}

#[tokio::test]
async fn the_sensor_meets_the_contract_in_every_form() {
    let way_mm = PROFILES as f64 * STEP_MM;
    for form in [Form::PointCloud, Form::Uniform, Form::Surface] {
        let mut profiles = taken();
        profiles.truncate(PROFILES);
        let server = serve(view(form), profiles, Some(RATE_HZ)).await;
        let (mut sensor, mut stage) = (sensor(&settings(&server)), world().stage());
        assert_passed(&check_sensor(&mut sensor).await);
        assert_passed(&check_sensor_scan(&mut sensor, &mut stage, PROFILES as u64, way_mm, 1).await);
        assert!(!*server.running().borrow(), "the laser is off");
    }
}

//! Every number of the cell with its key, its least and its greatest value, and what must lie below what.

use super::Cell;
use super::check::key_of;
use super::devices::Manipulator;
use super::error::CellError;
use crate::motion::Carrier;

/// A number with its key, its least and its greatest value.
type Range = (String, f64, f64, f64);

impl Cell {
    /// Whether every number is within its range, and every lower one below its upper one.
    pub(super) fn check_numbers(&self) -> Result<(), CellError> {
        let mut ranges = self.ranges();
        for carrier in Carrier::ALL {
            limits(key_of(carrier), self.manipulators.get(carrier), &mut ranges);
        }
        for (key, value, least, most) in ranges {
            // Written so that what is no number fails it, too.
            if !(least..=most).contains(&value) {
                return Err(CellError::OutOfRange { key, value, least, most });
            }
        }
        for carrier in Carrier::ALL {
            order(key_of(carrier), self.manipulators.get(carrier))?;
        }
        let lease = &self.lease;
        below("lease.ttl_min_ms", "lease.ttl_max_ms", real(lease.ttl_min_ms), real(lease.ttl_max_ms))
    }

    fn ranges(&self) -> Vec<Range> {
        let (lease, timing, together, scan) = (&self.lease, &self.timing, &self.together, &self.scan);
        let tolerance = &together.tolerance;
        let named: [(&str, f64, f64, f64); 23] = [
            ("plan_age_max_s", real(self.plan_age_max_s), 1.0, 3_600.0),
            ("lease.ttl_min_ms", real(lease.ttl_min_ms), 100.0, 600_000.0),
            ("lease.ttl_max_ms", real(lease.ttl_max_ms), 1_000.0, 600_000.0),
            ("lease.ttl_ms", real(lease.ttl_ms), real(lease.ttl_min_ms), real(lease.ttl_max_ms)),
            ("timing.poll_ms", real(timing.poll_ms), 5.0, 100.0),
            ("timing.poll_moving_ms", real(timing.poll_moving_ms), 5.0, 50.0),
            ("timing.reply_ms", real(timing.reply_ms), 20.0, 300.0),
            ("timing.connect_ms", real(timing.connect_ms), 20.0, 30_000.0),
            ("timing.acknowledge_ms", real(timing.acknowledge_ms), 20.0, 300.0),
            ("timing.watchdog_ms", real(timing.watchdog_ms), 100.0, 400.0),
            ("timing.arrival_ms", real(timing.arrival_ms), 100.0, 600_000.0),
            ("timing.scan_stall_ms", real(timing.scan_stall_ms), 50.0, 60_000.0),
            ("together.strain_max_mm", together.strain_max_mm, 1e-6, 100.0),
            ("together.run_on_max_mm", together.run_on_max_mm, 0.01, 100.0),
            ("together.twist_max_deg", together.twist_max_deg, 1e-6, 90.0),
            ("together.clearance_min_mm", together.clearance_min_mm, 0.0, 10_000.0),
            ("together.tolerance.x_mm", tolerance.x_mm, 1e-6, 10.0),
            ("together.tolerance.y_mm", tolerance.y_mm, 1e-6, 10.0),
            ("together.tolerance.z_mm", tolerance.z_mm, 1e-6, 10.0),
            ("together.tolerance.c_deg", tolerance.c_deg, 1e-6, 10.0),
            ("scan.profiles_count", real(scan.profiles_count), 2.0, 1e6),
            ("scan.speed_mm_s", scan.speed_mm_s, 1e-3, 10_000.0),
            ("scan.place_tolerance_mm", scan.place_tolerance_mm, 1e-3, 10_000.0),
        ];
        named.into_iter().map(|(key, value, least, most)| (key.to_owned(), value, least, most)).collect()
    }
}

fn limits(key: &str, manipulator: &Manipulator, ranges: &mut Vec<Range>) {
    const FAR: f64 = 100_000.0;
    const TURNS: f64 = 3_600.0;
    for (axis, value) in ["x", "y", "z"].iter().zip(manipulator.mount_mm) {
        ranges.push((format!("{key}.mount_mm ({axis})"), value, -FAR, FAR));
    }
    ranges.push((format!("{key}.half_span_mm"), manipulator.half_span_mm, 0.0, FAR));
    let limits = &manipulator.limits;
    for (axis, own) in [("x", &limits.x), ("y", &limits.y), ("z", &limits.z)] {
        let mut push = |name: &str, value, least, most| {
            ranges.push((format!("{key}.limits.{axis}.{name}"), value, least, most));
        };
        push("lower_mm", own.lower_mm, -FAR, FAR);
        push("upper_mm", own.upper_mm, -FAR, FAR);
        push("step_mm", own.step_mm, 1e-6, FAR);
        push("speed_mm_s", own.speed_mm_s, 1e-6, FAR);
        push("acceleration_mm_s2", own.acceleration_mm_s2, 1e-6, 1e6);
        push("jerk_mm_s3", own.jerk_mm_s3, 1e-6, 1e8);
    }
    let turn = &limits.c;
    let mut push = |name: &str, value, least, most| ranges.push((format!("{key}.limits.c.{name}"), value, least, most));
    push("lower_deg", turn.lower_deg, -TURNS, TURNS);
    push("upper_deg", turn.upper_deg, -TURNS, TURNS);
    push("step_deg", turn.step_deg, 1e-6, TURNS);
    push("speed_deg_s", turn.speed_deg_s, 1e-6, TURNS);
    push("acceleration_deg_s2", turn.acceleration_deg_s2, 1e-6, 1e6);
    push("jerk_deg_s3", turn.jerk_deg_s3, 1e-6, 1e8);
}

fn order(key: &str, manipulator: &Manipulator) -> Result<(), CellError> {
    let limits = &manipulator.limits;
    for (axis, own) in [("x", &limits.x), ("y", &limits.y), ("z", &limits.z)] {
        below(&format!("{key}.limits.{axis}.lower_mm"), "upper_mm", own.lower_mm, own.upper_mm)?;
    }
    below(&format!("{key}.limits.c.lower_deg"), "upper_deg", limits.c.lower_deg, limits.c.upper_deg)
}

fn below(key: &str, beside: &'static str, value: f64, limit: f64) -> Result<(), CellError> {
    if value < limit { Ok(()) } else { Err(CellError::NotBelow { key: key.to_owned(), beside, value, limit }) }
}

/// Counts and milliseconds here are far below 2⁵³; greater ones only have to stay out of range.
#[expect(clippy::cast_precision_loss, reason = "beyond 2⁵³ every range is left")]
const fn real(value: u64) -> f64 {
    value as f64
}

//! What is ordered of a scan: where it goes, how fast, with how many profiles; whether that can be, and whether the profiles
//! came from there.

use super::answer::Order;
use super::error::ServiceError;
use super::jobs::{Commander, Ending};
use crate::motion::{Pair, Position};
use crate::scan::Cloud;
use serde::{Deserialize, Serialize};

/// Where a scan goes. What is left out is as configured.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ScanWay {
    /// Where it begins, along the rail.
    pub x_from_mm: Option<f64>,
    /// Where it ends.
    pub x_to_mm: Option<f64>,
    /// Profiles in between.
    pub profiles_count: Option<u64>,
    /// How fast the stage goes.
    pub speed_mm_s: Option<f64>,
}

/// What is asked of a measurement by the sensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorRequest {
    /// Names the right to move.
    #[serde(skip)]
    pub lease_id: String,
    /// Where the scan goes.
    pub way: ScanWay,
    /// How the points are measured.
    pub order: Order,
}

/// What was commanded by a measurement by the sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorOrder {
    /// Who commanded it.
    #[serde(flatten)]
    pub by: Commander,
    /// Name of the recipe, where one was named.
    pub recipe_name: Option<String>,
    /// Where the scan began, along the rail.
    pub x_from_mm: f64,
    /// Where it was to end.
    pub x_to_mm: f64,
    /// Profiles in between.
    pub profiles_count: u64,
    /// How fast the stage was to go.
    pub speed_mm_s: f64,
    /// Where the manipulators were; mm, rad.
    pub positions: Option<Pair<Position>>,
}

/// Refuses a way that is none.
pub(super) fn check(order: &SensorOrder, profiles_max: usize) -> Result<(), ServiceError> {
    let refuse = |field, allowed: String| Err(ServiceError::Value { field, allowed });
    let profiles_max = u64::try_from(profiles_max).unwrap_or(u64::MAX);
    if !(2..=profiles_max).contains(&order.profiles_count) {
        return refuse("profiles_count", format!("between 2 and {profiles_max}"));
    }
    if !(order.x_from_mm.is_finite() && order.x_to_mm.is_finite() && order.x_from_mm != order.x_to_mm) {
        return refuse("x_to_mm", "a place along the rail other than x_from_mm".to_owned());
    }
    if !(order.speed_mm_s.is_finite() && order.speed_mm_s > 0.0) {
        return refuse("speed_mm_s", "above 0".to_owned());
    }
    Ok(())
}

/// What is the matter where the profiles do not lie where the stage was sent; a pose from them would be of another place.
pub(super) fn misplaced(cloud: &Cloud, order: &SensorOrder, tolerance_mm: f64) -> Option<Ending> {
    let (first, last) = (cloud.stripes.first()?.x, cloud.stripes.last()?.x);
    let SensorOrder { x_from_mm, x_to_mm, .. } = *order;
    let off = (first - x_from_mm).abs().max((last - x_to_mm).abs());
    (off > tolerance_mm).then(|| Ending {
        code: "scan_misplaced".to_owned(),
        text: format!(
            "the profiles lie from x = {first:.2} to {last:.2} mm, and the stage went from {x_from_mm:.2} to {x_to_mm:.2} mm; \
             check where the sensor's travel begins and how far it goes from profile to profile (for a Gocator \
             cell.sensor.gocator.travel), the number of profiles and the speed; what may differ is cell.scan.place_tolerance_mm"
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::Unit;
    use crate::scan::{Columns, Labels, Stripe};

    #[test]
    fn profiles_elsewhere_than_the_stage_went_are_no_scan() {
        let cloud = |first: f64, last: f64| Cloud {
            stripes: vec![Stripe { label: 0.0, x: first, end: 1 }, Stripe { label: 1.0, x: last, end: 2 }],
            columns: Columns::F32 { y: vec![0.0; 2], z: vec![0.0; 2] },
            labels: Labels::None,
            unit: Unit::Millimetre,
            blanks: Vec::new(),
            missing_count: 0,
        };
        let order = SensorOrder {
            by: Commander { holder: None, fence: None },
            recipe_name: None,
            x_from_mm: 200.0,
            x_to_mm: 600.0,
            profiles_count: 2,
            speed_mm_s: 50.0,
            positions: None,
        };
        assert_eq!(misplaced(&cloud(201.0, 598.0), &order, 5.0).map(|ending| ending.code), None);
        for (first, last) in [(0.0, 400.0), (600.0, 200.0), (200.0, 400.0)] {
            let said = misplaced(&cloud(first, last), &order, 5.0).map(|ending| ending.code);
            assert_eq!(said.as_deref(), Some("scan_misplaced"), "{first} to {last}");
        }
    }

    #[test]
    fn a_way_that_is_none_is_refused_with_its_field() {
        let good = SensorOrder {
            by: Commander { holder: None, fence: None },
            recipe_name: None,
            x_from_mm: 0.0,
            x_to_mm: 100.0,
            profiles_count: 10,
            speed_mm_s: 50.0,
            positions: None,
        };
        check(&good, 100).expect("a way");
        let field = |order: SensorOrder| match check(&order, 100) {
            Err(ServiceError::Value { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        assert_eq!(field(SensorOrder { profiles_count: 101, ..good.clone() }), "profiles_count");
        assert_eq!(field(SensorOrder { x_to_mm: 0.0, ..good.clone() }), "x_to_mm");
        assert_eq!(field(SensorOrder { x_from_mm: f64::NAN, ..good.clone() }), "x_to_mm");
        assert_eq!(field(SensorOrder { speed_mm_s: 0.0, ..good }), "speed_mm_s");
    }
}

//! The order of a scan (start, end, speed, number of profiles), its validation, and the check that the profiles came from there.
//! The arriving profiles are converted at once to the cloud that decoding the stored file would give.

use serde::{Deserialize, Serialize};

use crate::device::Profile;
use crate::motion::{Pair, Position};
use crate::scan::decode::{DecodeError, Format, Limits, Unit};
use crate::scan::{Cloud, Columns, Labels, Stripe};
use crate::service::error::ServiceError;
use crate::service::measuring::order::MeasurementOrder;
use crate::service::measuring::pipeline::Decoded;

use super::job::{Commander, EndReason};

/// Path of a scan. Omitted values are those of the configuration.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ScanWay {
    /// Start position along the rail.
    pub x_from_mm: Option<f64>,
    /// End position.
    pub x_to_mm: Option<f64>,
    /// Number of profiles.
    pub profiles_count: Option<u64>,
    /// Speed of the stage.
    pub speed_mm_s: Option<f64>,
}

/// Parameters of a measurement by the sensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorRequest {
    /// Authorises the motion.
    #[serde(skip)]
    pub lease_id: String,
    /// Path of the scan.
    pub way: ScanWay,
    /// How the points are measured.
    pub order: MeasurementOrder,
}

/// The order of a measurement by the sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorOrder {
    /// Who commanded it.
    #[serde(flatten)]
    pub by: Commander,
    /// Name of the recipe, if one was given.
    pub recipe_name: Option<String>,
    /// Start position along the rail.
    pub x_from_mm: f64,
    /// End position.
    pub x_to_mm: f64,
    /// Number of profiles.
    pub profiles_count: u64,
    /// Speed of the stage.
    pub speed_mm_s: f64,
    /// Positions of the manipulators; mm, rad.
    pub positions: Option<Pair<Position>>,
}

/// Refuses an invalid scan path.
pub(in crate::service) fn check(order: &SensorOrder, profiles_max: usize) -> Result<(), ServiceError> {
    let refuse = |field, allowed: String| Err(ServiceError::Value { field, allowed });
    let profiles_max = u64::try_from(profiles_max).unwrap_or(u64::MAX);
    if !(2..=profiles_max).contains(&order.profiles_count) {
        return refuse("profiles_count", format!("between 2 and {profiles_max}"));
    }
    if !(order.x_from_mm.is_finite() && order.x_to_mm.is_finite() && order.x_from_mm != order.x_to_mm) {
        return refuse("x_to_mm", "a position along the rail other than x_from_mm".to_owned());
    }
    if !(order.speed_mm_s.is_finite() && order.speed_mm_s > 0.0) {
        return refuse("speed_mm_s", "above 0".to_owned());
    }
    Ok(())
}

/// The failure if the profiles do not lie where the stage was sent; their pose would be that of another position.
pub(in crate::service) fn misplaced(cloud: &Cloud, order: &SensorOrder, tolerance_mm: f64) -> Option<EndReason> {
    let (first, last) = (cloud.stripes.first()?.x, cloud.stripes.last()?.x);
    let SensorOrder { x_from_mm, x_to_mm, .. } = *order;
    let off = (first - x_from_mm).abs().max((last - x_to_mm).abs());
    (off > tolerance_mm).then(|| EndReason {
        code: "scan_misplaced".to_owned(),
        text: format!(
            "the profiles lie from x = {first:.2} to {last:.2} mm, and the stage went from {x_from_mm:.2} to {x_to_mm:.2} mm; \
             check where the sensor's travel begins and how far it goes from profile to profile (for a Gocator \
             cell.sensor.gocator.travel), the number of profiles and the speed; what may differ is cell.scan.place_tolerance_mm"
        ),
    })
}

/// The column of the stored file that contains the number of a profile.
const PROFILE_COLUMN: &str = "profile";

/// A scan that is being received.
#[derive(Debug)]
pub(in crate::service) struct IncomingScan {
    limits: Limits,
    stripes: Vec<Stripe>,
    y: Vec<f32>,
    z: Vec<f32>,
    missing_count: u64,
}

impl IncomingScan {
    /// Without a profile yet; `limits` are those of a scan file, because the scan is stored as one.
    pub(in crate::service) const fn new(limits: Limits) -> Self {
        Self { limits, stripes: Vec::new(), y: Vec::new(), z: Vec::new(), missing_count: 0 }
    }

    /// Adds the next profile.
    ///
    /// # Errors
    /// [`DecodeError`] if a file of these points would be refused: too many, or too far away.
    pub(in crate::service) fn take(&mut self, profile: &Profile) -> Result<(), DecodeError> {
        self.missing_count = self.missing_count.saturating_add(profile.missing_count);
        // The file has single precision; a profile's number is exact in double precision.
        let travel = profile.travel_mm as f32;
        let label = profile.index as f64;
        let points = profile.y.iter().zip(&profile.z).enumerate();
        for (place, (&y, &z)) in points {
            let x = if profile.x.is_empty() { travel } else { profile.x.get(place).copied().unwrap_or(f32::NAN) };
            self.take_point(label, [x, y, z])?;
        }
        Ok(())
    }

    /// The points as decoded from the file in which they will be stored.
    ///
    /// # Errors
    /// [`DecodeError::NoPoints`].
    pub(in crate::service) fn finish(self) -> Result<Decoded, DecodeError> {
        let Self { stripes, y, z, missing_count, .. } = self;
        if y.is_empty() {
            return Err(DecodeError::NoPoints { missing_count });
        }
        let cloud = Cloud {
            stripes,
            columns: Columns::F32 { y, z },
            labels: Labels::Column(PROFILE_COLUMN.to_owned()),
            unit: Unit::Millimetre,
            blanks: Vec::new(),
            missing_count,
        };
        Ok(Decoded { format: Format::Ply, cloud })
    }

    fn take_point(&mut self, label: f64, point: [f32; 3]) -> Result<(), DecodeError> {
        if !point.iter().all(|value| value.is_finite()) {
            self.missing_count += 1;
            return Ok(());
        }
        let (index, limit) = (self.y.len(), self.limits.coordinate_max_mm);
        if let Some(value) = point.iter().map(|value| f64::from(*value)).find(|value| value.abs() > limit) {
            return Err(DecodeError::CoordinateOutOfRange { index, value, limit });
        }
        if index >= self.limits.points_max {
            return Err(DecodeError::TooManyPoints { limit: self.limits.points_max });
        }
        let [x, y, z] = point;
        self.y.push(y);
        self.z.push(z);
        let (x, end) = (f64::from(x), self.y.len());
        match self.stripes.last_mut() {
            Some(last) if last.x == x && last.label == label => last.end = end,
            _ => self.stripes.push(Stripe { label, x, end }),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::Unit;
    use crate::scan::{Columns, Labels, Stripe};

    #[test]
    fn profiles_outside_the_path_of_the_stage_are_refused() {
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
    fn an_invalid_scan_path_is_refused_with_its_field() {
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

#[cfg(test)]
mod incoming_tests {
    use super::*;
    use crate::scan::decode::{Request, decode};
    use crate::scan::encode::encode_cloud;

    fn profile(index: u64, travel_mm: f64, x: &[f32], y: &[f32]) -> Profile {
        Profile { index, travel_mm, x: x.to_vec(), y: y.to_vec(), z: vec![7.5; y.len()], missing_count: 2 }
    }

    #[test]
    fn the_stored_file_reads_back_as_the_measured_points() {
        let limits = Limits::default();
        let mut arriving = IncomingScan::new(limits.clone());
        arriving.take(&profile(0, 0.1, &[], &[1.0, 2.0])).expect("taken");
        arriving.take(&profile(1, 0.1, &[], &[3.0])).expect("taken");
        arriving.take(&profile(2, 0.2, &[0.25, 0.5], &[4.0, 5.0])).expect("taken");
        let Decoded { format, mut cloud } = arriving.finish().expect("points");
        let mut bytes = Vec::new();
        encode_cloud(&cloud, &mut bytes).expect("memory takes it");
        let read = decode(format, &mut &*bytes, &Request::new(&limits));
        // A file does not contain missing points.
        assert_eq!(std::mem::take(&mut cloud.missing_count), 6);
        assert_eq!(read.expect("it reads"), cloud);
    }

    #[test]
    fn non_finite_points_are_missing_and_points_too_far_or_too_many_are_refused() {
        let limits = Limits { points_max: 2, coordinate_max_mm: 100.0, ..Limits::default() };
        let mut arriving = IncomingScan::new(limits);
        arriving.take(&profile(0, 0.0, &[], &[f32::NAN])).expect("missing");
        let far = arriving.take(&profile(1, 0.0, &[], &[-101.0])).expect_err("too far");
        assert!(matches!(far, DecodeError::CoordinateOutOfRange { value, .. } if value == -101.0), "{far}");
        let many = arriving.take(&profile(2, 0.0, &[], &[1.0, 2.0, 3.0])).expect_err("too many");
        assert!(matches!(many, DecodeError::TooManyPoints { limit: 2 }), "{many}");
        let none = IncomingScan::new(Limits::default()).finish().expect_err("nothing");
        assert!(matches!(none, DecodeError::NoPoints { .. }));
    }
}

//! A scan that the sensor takes: profiles come in one after the other and become a cloud as they come, so that nothing is
//! left to be done when the last one is here. What goes out is what the kept file reads back as.

use crate::device::Profile;
use crate::scan::decode::{DecodeError, Format, Limits, Unit};
use crate::scan::{Cloud, Columns, Labels, Stripe};

use super::measure::Decoded;

/// What the kept file calls the number of a profile.
const PROFILE_COLUMN: &str = "profile";

/// A scan in the making.
#[derive(Debug)]
pub(super) struct Arriving {
    limits: Limits,
    stripes: Vec<Stripe>,
    y: Vec<f32>,
    z: Vec<f32>,
    missing_count: u64,
}

impl Arriving {
    /// Without a profile yet; `limits` are those of a scan file, since it becomes one.
    pub(super) const fn new(limits: Limits) -> Self {
        Self { limits, stripes: Vec::new(), y: Vec::new(), z: Vec::new(), missing_count: 0 }
    }

    /// Takes the next profile.
    ///
    /// # Errors
    /// [`DecodeError`] as a file of these points would be refused: too many, or too far away.
    pub(super) fn take(&mut self, profile: &Profile) -> Result<(), DecodeError> {
        self.missing_count = self.missing_count.saturating_add(profile.missing_count);
        // The file holds single precision; a profile's number is exact in double.
        let travel = profile.travel_mm as f32;
        let label = profile.index as f64;
        let points = profile.y.iter().zip(&profile.z).enumerate();
        for (place, (&y, &z)) in points {
            let x = if profile.x.is_empty() { travel } else { profile.x.get(place).copied().unwrap_or(f32::NAN) };
            self.take_point(label, [x, y, z])?;
        }
        Ok(())
    }

    /// The points, as the file that they are kept in will be read.
    ///
    /// # Errors
    /// [`DecodeError::NoPoints`].
    pub(super) fn finish(self) -> Result<Decoded, DecodeError> {
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
    use crate::scan::decode::{Request, decode};
    use crate::scan::encode::encode_cloud;

    fn profile(index: u64, travel_mm: f64, x: &[f32], y: &[f32]) -> Profile {
        Profile { index, travel_mm, x: x.to_vec(), y: y.to_vec(), z: vec![7.5; y.len()], missing_count: 2 }
    }

    #[test]
    fn the_kept_file_reads_back_as_what_was_measured() {
        let limits = Limits::default();
        let mut arriving = Arriving::new(limits.clone());
        arriving.take(&profile(0, 0.1, &[], &[1.0, 2.0])).expect("taken");
        arriving.take(&profile(1, 0.1, &[], &[3.0])).expect("taken");
        arriving.take(&profile(2, 0.2, &[0.25, 0.5], &[4.0, 5.0])).expect("taken");
        let Decoded { format, mut cloud } = arriving.finish().expect("points");
        let mut bytes = Vec::new();
        encode_cloud(&cloud, &mut bytes).expect("memory takes it");
        let read = decode(format, &mut &*bytes, &Request::new(&limits));
        // A file has no place for points that are not there.
        assert_eq!(std::mem::take(&mut cloud.missing_count), 6);
        assert_eq!(read.expect("it reads"), cloud);
    }

    #[test]
    fn points_that_are_none_are_missing_and_points_too_far_or_too_many_are_refused() {
        let limits = Limits { points_max: 2, coordinate_max_mm: 100.0, ..Limits::default() };
        let mut arriving = Arriving::new(limits);
        arriving.take(&profile(0, 0.0, &[], &[f32::NAN])).expect("missing");
        let far = arriving.take(&profile(1, 0.0, &[], &[-101.0])).expect_err("too far");
        assert!(matches!(far, DecodeError::CoordinateOutOfRange { value, .. } if value == -101.0), "{far}");
        let many = arriving.take(&profile(2, 0.0, &[], &[1.0, 2.0, 3.0])).expect_err("too many");
        assert!(matches!(many, DecodeError::TooManyPoints { limit: 2 }), "{many}");
        let none = Arriving::new(Limits::default()).finish().expect_err("nothing");
        assert!(matches!(none, DecodeError::NoPoints { .. }));
    }
}

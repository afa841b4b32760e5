//! The motion of the stage along the rail, the encoder that reports x, and the delivery of the profiles.

use super::noise::{self, Stream};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The formation of the profiles along the rail. By default x is exact and every profile is delivered once.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Travel {
    /// Standard deviation of the encoder noise of every point, which gives each an individual x.
    pub encoder_sigma_mm: f64,
    /// Stick-slip: mean distance that the drive advances before the stage breaks loose. Profiles taken meanwhile share one x, then
    /// x jumps; the reported x is the position of the stage.
    pub stick_mm: f64,
    /// Share of the profiles that repeat the previous one bit for bit.
    pub repeated_ratio: f64,
    /// The x of a repeated profile.
    pub repeated_x: RepeatedX,
    /// Share of the profiles that are lost. The scan does not show that they were taken.
    pub lost_ratio: f64,
}

/// The x of a repeated profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RepeatedX {
    /// Its own x: a profile is delivered twice.
    #[default]
    Same,
    /// The x of the next profile, whose points are replaced by the previous ones: the sensor delivers an old buffer.
    New,
}

/// The delivery of a profile from sensor to file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Delivery {
    Once,
    Twice,
    /// The points of the previous profile under the x of this one.
    Stale,
    Lost,
}

/// The stage during one scan.
pub(super) struct Stage {
    travel: Travel,
    chance: ChaCha8Rng,
    /// Position at which it sticks, and the advance of the drive at which it breaks loose.
    stuck: Option<(f64, f64)>,
}

impl Travel {
    pub(super) fn start(&self, seed: u64) -> Stage {
        Stage { travel: *self, chance: Stream::Travel.of(seed), stuck: None }
    }
}

impl Stage {
    /// Position of the stage while the drive is at `drive_x`, mm.
    pub(super) fn place(&mut self, drive_x: f64) -> f64 {
        let mean = self.travel.stick_mm;
        if mean <= 0.0 {
            return drive_x;
        }
        match self.stuck {
            Some((x, ahead)) if drive_x - x < ahead => x,
            _ => {
                let ahead = -mean * (1.0 - self.chance.random_range(0.0..1.0_f64)).ln();
                self.stuck = Some((drive_x, ahead));
                drive_x
            }
        }
    }

    /// The x that the encoder reports for a point at `x`, mm.
    pub(super) fn encoder_x(&mut self, x: f64) -> f64 {
        let sigma = self.travel.encoder_sigma_mm;
        if sigma > 0.0 { x + sigma * noise::normal(&mut self.chance) } else { x }
    }

    /// The delivery of the next profile.
    pub(super) fn delivery(&mut self) -> Delivery {
        let Travel { repeated_ratio, repeated_x, lost_ratio, .. } = self.travel;
        let mut happens = |ratio: f64| ratio > 0.0 && self.chance.random_bool(ratio.min(1.0));
        match (happens(lost_ratio), happens(repeated_ratio), repeated_x) {
            (true, ..) => Delivery::Lost,
            (_, true, RepeatedX::Same) => Delivery::Twice,
            (_, true, RepeatedX::New) => Delivery::Stale,
            (_, false, _) => Delivery::Once,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Scan;
    use crate::scan::synthetic::{Part, make};

    fn scanned(travel: Travel, laser_tilt_deg: f64) -> Scan {
        let mut part = Part { profiles_count: 1000, points_count: 20, travel, ..Part::smooth(1) };
        part.laser_plane.about_z_deg = laser_tilt_deg;
        let (scan, truth) = make(&part).expect("a scan");
        assert_eq!(truth.inner_ratio_per_profile.len(), scan.stations().len());
        scan
    }

    fn places(scan: &Scan) -> Vec<f64> {
        scan.stations().iter().map(|station| station.x).collect()
    }

    fn profile(scan: &Scan, index: usize) -> Vec<[f64; 3]> {
        scan.points_of(&scan.stations()[index]).collect()
    }

    #[test]
    fn encoder_noise_has_its_standard_deviation_and_does_not_change_y_and_z() {
        let plain = scanned(Travel::default(), 0.0);
        let noisy = scanned(Travel { encoder_sigma_mm: 0.02, ..Travel::default() }, 0.0);
        assert!(plain.is_planar() && !noisy.is_planar() && plain.columns() == noisy.columns());
        let off = |station| noisy.points_of(station).map(|[x, ..]| x - station.x).collect::<Vec<_>>();
        let off: Vec<f64> = noisy.stations().iter().flat_map(off).collect();
        let sigma = (off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64).sqrt();
        // 20 000 points determine it to 1/√40 000 = 0.5 %.
        assert!((sigma - 0.02).abs() < 0.02 * 0.02, "{sigma}");
    }

    #[test]
    fn a_sticking_stage_repeats_x_and_then_jumps_to_the_drive() {
        let even = places(&scanned(Travel::default(), 0.0));
        let mut stuck = places(&scanned(Travel { stick_mm: 4.0, ..Travel::default() }, 0.0));
        assert!(stuck.is_sorted() && stuck.iter().zip(&even).all(|(stuck, drive)| stuck <= drive));
        assert!(stuck.iter().all(|x| even.contains(x)));
        stuck.dedup();
        // It sticks for an exponential distance of 4 mm, rounded up to the profile spacing of 0.8 mm, so for 4.4 mm on average:
        // about 182 positions on 800 mm, ± their square root.
        assert!((150..215).contains(&stuck.len()), "{}", stuck.len());
    }

    #[test]
    fn a_profile_delivered_twice_is_identical_and_counts_twice() {
        for tilt in [0.0, 5.0] {
            let scan = scanned(Travel { repeated_ratio: 0.1, ..Travel::default() }, tilt);
            let pairs = (1..scan.stations().len()).filter(|index| profile(&scan, *index) == profile(&scan, index - 1));
            let repeated_count = pairs.count();
            assert_eq!(scan.stations().len(), 1000 + repeated_count);
            // 1000 draws of 0.1 scatter by 9.5.
            assert!((60..140).contains(&repeated_count), "{repeated_count}");
        }
    }

    #[test]
    fn a_stale_profile_has_the_previous_points_under_a_new_x() {
        let even = places(&scanned(Travel::default(), 0.0));
        for tilt in [0.0, 5.0] {
            let scan = scanned(Travel { repeated_ratio: 0.1, repeated_x: RepeatedX::New, ..Travel::default() }, tilt);
            assert_eq!(places(&scan), even);
            let is_stale = |index: &usize| {
                let (before, now) = (profile(&scan, index - 1), profile(&scan, *index));
                let moved = even[*index] - even[index - 1];
                before.iter().zip(&now).all(|(a, b)| a[1..] == b[1..] && (b[0] - a[0] - moved).abs() < 1e-9)
            };
            let stale_count = (1..1000).filter(is_stale).count();
            assert!((60..140).contains(&stale_count), "{stale_count}");
        }
    }

    #[test]
    fn lost_profiles_do_not_change_the_others() {
        let all = scanned(Travel::default(), 0.0);
        let some = scanned(Travel { lost_ratio: 0.3, ..Travel::default() }, 0.0);
        // 1000 draws of 0.3 scatter by 14.5.
        assert!((642..758).contains(&some.stations().len()), "{}", some.stations().len());
        assert!(some.blanks().is_empty());
        let of_all: Vec<_> = (0..1000).map(|index| profile(&all, index)).collect();
        assert!((0..some.stations().len()).all(|index| of_all.contains(&profile(&some, index))));
    }
}

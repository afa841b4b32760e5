//! The position of the stage when a frame was taken, from the frame's stamp.

use super::codec::Stamp;
use crate::device::error::ScanFault;
use serde::{Deserialize, Serialize};

/// Ticks of the sensor's clock per second: 1.024 per microsecond.
const CLOCK_HZ: f64 = 1.024e6;

/// How the position of a frame on the rail is determined.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "by", rename_all = "snake_case", deny_unknown_fields)]
pub enum Travel {
    /// By the encoder that is connected to the sensor.
    Encoder {
        /// Travel along x per tick; negative if the encoder counts against x.
        mm_per_tick: f64,
        /// x of the first profile, or of `zero_ticks` if that is given.
        #[serde(default)]
        start_mm: f64,
        /// Ticks at `start_mm`, for a referenced encoder; if it is missing, each scan counts from its first profile.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        zero_ticks: Option<i64>,
    },
    /// By the sensor's clock, for a stage of constant speed.
    Time {
        /// Speed along x; negative if the stage moves against x.
        speed_mm_s: f64,
        /// x of the first profile.
        #[serde(default)]
        start_mm: f64,
    },
}

/// Why a rule for the travel is not valid.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TravelError {
    /// A number is zero or not finite.
    #[error("travel: {field} must be a finite number other than 0, got {value}")]
    NoStep {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// The start is not finite.
    #[error("travel: start_mm must be a finite number, got {value}")]
    Start {
        /// Its value.
        value: f64,
    },
}

impl Travel {
    /// Checks the rule.
    ///
    /// # Errors
    /// [`TravelError`] names the invalid field.
    pub fn check(&self) -> Result<(), TravelError> {
        let (field, value, start_mm) = match *self {
            Self::Encoder { mm_per_tick, start_mm, .. } => ("mm_per_tick", mm_per_tick, start_mm),
            Self::Time { speed_mm_s, start_mm } => ("speed_mm_s", speed_mm_s, start_mm),
        };
        if !value.is_finite() || value == 0.0 {
            return Err(TravelError::NoStep { field, value });
        }
        if start_mm.is_finite() { Ok(()) } else { Err(TravelError::Start { value: start_mm }) }
    }

    /// x of the first profile of a scan, mm; `None` if it depends on the encoder.
    pub(super) fn start_mm(&self) -> Option<f64> {
        match *self {
            Self::Encoder { start_mm, zero_ticks: None, .. } | Self::Time { start_mm, .. } => Some(start_mm),
            Self::Encoder { zero_ticks: Some(_), .. } => None,
        }
    }
}

/// Determines the travel of the frames of one scan.
#[derive(Debug)]
pub(super) struct Odometer {
    travel: Travel,
    seen: Option<Seen>,
}

#[derive(Debug, Clone, Copy)]
struct Seen {
    first: Stamp,
    last: Stamp,
    /// Sign of the first step; 0 before it.
    direction: i128,
}

impl Odometer {
    pub(super) fn new(travel: Travel) -> Self {
        Self { travel, seen: None }
    }

    /// The position of the stage, mm along the rail.
    pub(super) fn at(&mut self, stamp: &Stamp) -> Result<f64, Stuck> {
        let seen = match self.seen {
            None => Seen { first: *stamp, last: *stamp, direction: 0 },
            Some(seen) => self.step(seen, stamp)?,
        };
        self.seen = Some(seen);
        Ok(match self.travel {
            Travel::Encoder { mm_per_tick, start_mm, zero_ticks } => {
                let zero = zero_ticks.unwrap_or(seen.first.encoder);
                start_mm + mm_per_tick * ticks_between(zero, stamp.encoder) as f64
            }
            Travel::Time { speed_mm_s, start_mm } => {
                let ticks = stamp.timestamp.wrapping_sub(seen.first.timestamp);
                start_mm + speed_mm_s * ticks as f64 / CLOCK_HZ
            }
        })
    }

    fn step(&self, seen: Seen, stamp: &Stamp) -> Result<Seen, Stuck> {
        let advanced = match self.travel {
            Travel::Time { .. } if stamp.timestamp <= seen.last.timestamp => {
                return Err(Stuck::Clock { from: seen.last.timestamp, to: stamp.timestamp });
            }
            Travel::Time { .. } => 1,
            Travel::Encoder { .. } => ticks_between(seen.last.encoder, stamp.encoder).signum(),
        };
        if advanced == 0 || advanced == -seen.direction {
            return Err(ScanFault::EncoderReversed { from: seen.last.encoder, to: stamp.encoder }.into());
        }
        Ok(Seen { last: *stamp, direction: advanced, ..seen })
    }
}

fn ticks_between(from: i64, to: i64) -> i128 {
    i128::from(to) - i128::from(from)
}

/// Why the position of a frame is not known.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum Stuck {
    #[error(transparent)]
    Encoder(#[from] ScanFault),
    #[error("the sensor's clock went from {from} to {to}")]
    Clock { from: u64, to: u64 },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamp(encoder: i64, timestamp: u64) -> Stamp {
        Stamp { encoder, timestamp, ..Stamp::default() }
    }

    fn along(travel: Travel, stamps: &[(i64, u64)]) -> Vec<Result<f64, Stuck>> {
        let mut odometer = Odometer::new(travel);
        stamps.iter().map(|&(encoder, timestamp)| odometer.at(&stamp(encoder, timestamp))).collect()
    }

    #[test]
    fn a_decreasing_encoder_with_a_negative_scale_gives_increasing_travel() {
        let travel = Travel::Encoder { mm_per_tick: -0.01, start_mm: 5.0, zero_ticks: None };
        assert_eq!(along(travel, &[(100, 0), (50, 0), (-100, 0)]), [Ok(5.0), Ok(5.5), Ok(7.0)]);
        let travel = Travel::Encoder { mm_per_tick: -0.01, start_mm: 5.0, zero_ticks: Some(0) };
        assert_eq!(along(travel, &[(100, 0), (50, 0)]), [Ok(4.0), Ok(4.5)]);
    }

    #[test]
    fn a_second_of_the_sensors_clock_has_1024000_ticks() {
        let travel = Travel::Time { speed_mm_s: 20.0, start_mm: 1.0 };
        assert_eq!(along(travel, &[(0, 7), (0, 7 + 1_024_000)]), [Ok(1.0), Ok(21.0)]);
        assert_eq!(along(travel, &[(0, 7), (0, 7)])[1], Err(Stuck::Clock { from: 7, to: 7 }));
    }

    #[test]
    fn an_encoder_that_stops_or_reverses_is_a_fault() {
        let travel = Travel::Encoder { mm_per_tick: 0.5, start_mm: 0.0, zero_ticks: None };
        let reversed = |from, to| Err(ScanFault::EncoderReversed { from, to }.into());
        assert_eq!(along(travel, &[(3, 0), (4, 0), (4, 0)])[2], reversed(4, 4));
        assert_eq!(along(travel, &[(3, 0), (4, 0), (3, 0)])[2], reversed(4, 3));
        assert_eq!(along(travel, &[(3, 0), (2, 0), (1, 0), (2, 0)])[3], reversed(1, 2));
        let [first, second] = [i64::MIN, i64::MAX];
        assert_eq!(along(travel, &[(first, 0), (second, 0)])[1], Ok(0.5 * u64::MAX as f64), "no overflow");
    }

    #[test]
    fn a_step_of_zero_is_refused() {
        for value in [0.0, f64::NAN, f64::INFINITY] {
            let travel = Travel::Encoder { mm_per_tick: value, start_mm: 0.0, zero_ticks: None };
            assert!(travel.check().is_err(), "{value}");
            assert!(Travel::Time { speed_mm_s: value, start_mm: 0.0 }.check().is_err(), "{value}");
        }
    }
}

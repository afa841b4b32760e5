//! Controls a scan: the stage moves to the start, the sensor is armed, the stage moves to the end at its speed, and the received
//! profiles are counted. Pure: readings, outcomes, counts and the time are the inputs, commands are the output. The profiles
//! themselves go from the driver of the sensor directly to the client of the scan.
//!
//! ```text
//! stage to start --arrived--> arm sensor --ready--> stage to end, profiles arrive --all received, stage at end--> finished
//!                                             \-- a gap, a lost profile, no profile for too long --> fail
//! ```

use super::driver::messages::{Outcome, StageCommand};
use super::failure::Failure;
use super::settings::{ScanOrder, Settings};
use crate::device::{DeviceError, ScanFault, SensorDeadlines, StageReading};
use std::time::Duration;
use tokio::time::Instant;

/// The next step of a scan.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum ScanStep {
    /// There is nothing to do yet.
    Wait,
    /// Move the stage.
    Carry(StageCommand),
    /// Start the sensor.
    Arm,
    /// All profiles were received, and the stage is at rest.
    Finished,
    /// The scan cannot go on.
    Fail(Failure),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// The stage moves to the start.
    Approach { since: Option<Instant>, until: Instant },
    /// The sensor starts.
    Arm,
    /// The stage moves to the end.
    Travel { since: Option<Instant>, until: Instant, there: bool },
}

/// A scan that is being taken.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scanning {
    order: ScanOrder,
    stage: String,
    sensor: String,
    tolerance_mm: f64,
    /// Longest time for the start of the sensor.
    arm: Duration,
    /// Longest time until the first profile.
    first: Duration,
    /// Longest time from profile to profile.
    stall: Duration,
    arrival: Duration,
    /// The reading of the stage when the scan began: its position and its greatest speed.
    from: StageReading,
    phase: Phase,
    received_count: u64,
    whole: bool,
    /// When the last profile was received; before the first one, the start of the travel.
    heard_at: Instant,
}

impl Scanning {
    /// Begins a scan that was checked against the limits of the stage.
    pub(super) fn new(
        order: ScanOrder,
        names: (String, String),
        from: StageReading,
        (settings, own): (&Settings, &SensorDeadlines),
        now: Instant,
    ) -> Self {
        let way_s = (order.x_from_mm - from.actual_mm).abs() / from.speed_mm_s;
        let gap_s = (order.x_to_mm - order.x_from_mm).abs() / order.speed_mm_s / order.profiles_count as f64;
        Self {
            order,
            stage: names.0,
            sensor: names.1,
            tolerance_mm: settings.stage_tolerance_mm,
            arm: settings.arrival + settings.scan_stall.max(own.start),
            // The adaptor must detect a silent sensor first, because it can ask the sensor for the reason.
            first: (settings.scan_stall + 2 * seconds(gap_s)).max(own.first_profile + own.reply),
            stall: settings.scan_stall + 2 * seconds(gap_s),
            arrival: settings.arrival,
            from,
            phase: Phase::Approach { since: None, until: now + settings.arrival + seconds(way_s) },
            received_count: 0,
            whole: false,
            heard_at: now,
        }
    }

    /// The first command.
    pub(super) fn begin(&self) -> ScanStep {
        ScanStep::Carry(StageCommand::MoveTo { target_mm: self.order.x_from_mm, speed_mm_s: self.from.speed_mm_s })
    }

    /// The fraction of the profiles that were received, 0 to 1.
    pub(super) fn progress(&self) -> f64 {
        self.received_count as f64 / self.order.profiles_count.max(1) as f64
    }

    /// The latest time at which [`Self::time`] must be called.
    pub(super) fn deadline(&self) -> Instant {
        match self.phase {
            Phase::Approach { until, .. } => until,
            // The driver of the sensor has its own deadline, which is earlier.
            Phase::Arm => self.heard_at + self.arm,
            Phase::Travel { until, .. } if self.whole => until,
            // A sensor may send all of its profiles only after the stage has arrived.
            Phase::Travel { there: true, .. } => self.heard_at + self.quiet(),
            Phase::Travel { until, .. } => until.min(self.heard_at + self.quiet()),
        }
    }

    /// Longest time until the next profile.
    const fn quiet(&self) -> Duration {
        if self.received_count == 0 { self.first } else { self.stall }
    }

    /// Takes the outcome of a command to the stage.
    pub(super) fn stage_outcome(&mut self, now: Instant, outcome: Outcome) -> ScanStep {
        match outcome {
            Outcome::Taken { .. } => {
                match &mut self.phase {
                    Phase::Approach { since, .. } | Phase::Travel { since, .. } => *since = Some(now),
                    Phase::Arm => {}
                }
                ScanStep::Wait
            }
            Outcome::Overtaken | Outcome::Cut => ScanStep::Wait,
            Outcome::Refused(error) => ScanStep::Fail(Failure::Device(error)),
            Outcome::Unknown(failure) => ScanStep::Fail(failure),
        }
    }

    /// Takes the outcome of the command to the sensor.
    pub(super) fn sensor_outcome(&mut self, now: Instant, outcome: Outcome) -> ScanStep {
        match outcome {
            Outcome::Taken { .. } if self.phase == Phase::Arm => {
                let ScanOrder { x_from_mm, x_to_mm, speed_mm_s, .. } = self.order;
                let way_s = (x_to_mm - x_from_mm).abs() / speed_mm_s;
                self.heard_at = now;
                self.phase = Phase::Travel { since: None, until: now + self.arrival + seconds(way_s), there: false };
                ScanStep::Carry(StageCommand::MoveTo { target_mm: x_to_mm, speed_mm_s })
            }
            Outcome::Taken { .. } | Outcome::Overtaken | Outcome::Cut => ScanStep::Wait,
            Outcome::Refused(error) => ScanStep::Fail(Failure::Device(error)),
            Outcome::Unknown(failure) => ScanStep::Fail(failure),
        }
    }

    /// Takes a reading of the stage.
    pub(super) fn read(&mut self, now: Instant, asked_at: Instant, reading: &StageReading) -> ScanStep {
        let order = self.order;
        let fresh = |since: Option<Instant>| since.is_some_and(|since| asked_at >= since);
        match &mut self.phase {
            Phase::Approach { since, .. } if fresh(*since) && self.tolerance_mm >= off(reading, order.x_from_mm) => {
                (self.phase, self.heard_at) = (Phase::Arm, now);
                ScanStep::Arm
            }
            Phase::Travel { since, there, .. } if fresh(*since) && self.tolerance_mm >= off(reading, order.x_to_mm) => {
                *there = true;
                self.conclude()
            }
            Phase::Approach { .. } | Phase::Arm | Phase::Travel { .. } => ScanStep::Wait,
        }
    }

    /// Takes the number of profiles that were received so far.
    pub(super) fn received(&mut self, now: Instant, received_count: u64) -> ScanStep {
        (self.received_count, self.heard_at) = (received_count, now);
        ScanStep::Wait
    }

    /// Takes the end of the acquisition.
    pub(super) fn ended(&mut self, result: Result<(), Failure>) -> ScanStep {
        match result {
            Ok(()) => {
                self.whole = true;
                self.conclude()
            }
            Err(failure) => ScanStep::Fail(failure),
        }
    }

    /// Checks the deadline.
    pub(super) fn time(&self, now: Instant, last: Option<&StageReading>) -> ScanStep {
        if now < self.deadline() {
            return ScanStep::Wait;
        }
        let ScanOrder { x_from_mm, x_to_mm, profiles_count: expected_count, .. } = self.order;
        let received_count = self.received_count;
        ScanStep::Fail(match self.phase {
            Phase::Approach { .. } => self.not_arrived(last, x_from_mm),
            Phase::Arm => Failure::Device(DeviceError::Silent {
                device: self.sensor.clone(),
                within: now.saturating_duration_since(self.heard_at),
            }),
            Phase::Travel { .. } if self.whole => self.not_arrived(last, x_to_mm),
            Phase::Travel { there: true, .. } => {
                let fault = ScanFault::Incomplete { received_count, expected_count };
                Failure::Device(DeviceError::ScanFault { device: self.sensor.clone(), fault })
            }
            Phase::Travel { until, .. } if now >= until => self.not_arrived(last, x_to_mm),
            Phase::Travel { there: false, .. } => {
                let (device, within) = (self.sensor.clone(), self.quiet());
                Failure::ScanStalled { device, received_count, expected_count, within }
            }
        })
    }

    fn conclude(&self) -> ScanStep {
        match self.phase {
            Phase::Travel { there: true, .. } if self.whole => ScanStep::Finished,
            Phase::Approach { .. } | Phase::Arm | Phase::Travel { .. } => ScanStep::Wait,
        }
    }

    fn not_arrived(&self, last: Option<&StageReading>, target_mm: f64) -> Failure {
        let actual_mm = last.map_or(f64::NAN, |reading| reading.actual_mm);
        Failure::StageNotArrived { device: self.stage.clone(), actual_mm, target_mm, within: self.arrival }
    }
}

/// The distance of the stage from its target, mm; infinite while it moves.
fn off(reading: &StageReading, target_mm: f64) -> f64 {
    if reading.moves { f64::INFINITY } else { (reading.actual_mm - target_mm).abs() }
}

/// A calculated time, limited to one year.
fn seconds(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::from_secs(31_536_000)).min(Duration::from_secs(31_536_000))
}

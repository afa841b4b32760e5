//! Supervises the axes between two set-points. Input: readings of both manipulators. Output: the first axis that has stopped or
//! lags while another axis moves on. Pure.
//!
//! Two tests compare each axis with the other axes and not with a clock, so that no model of the device's ramps is needed:
//!
//! | test | an axis that is not yet at its target fails if |
//! |---|---|
//! | standstill | it has not progressed since its last reading, or has not started within 60 ms, while another axis has progressed since |
//! | following error | it is behind the farthest axis, in proportion to their distances, by more than the strain or twist limit plus the contribution of a ramp plus its travel in 60 ms |
//!
//! The time of a reading is the time of its request, because the answer cannot be older. If neither an axis nor the heartbeat has
//! changed since the previous reading, the device has not updated its status; such a reading counts only after 100 ms.

use crate::device::Reading;
use crate::motion::{Arrangement, Axes, Axis, AxisLimits, Carrier, Pair, Position, Waypoint};
use std::time::Duration;
use tokio::time::Instant;

/// How much later than another axis an axis may start.
const START_WITHIN: Duration = Duration::from_millis(60);
/// Longest time for which an unchanged status counts as not updated.
const UNCHANGED_WITHIN: Duration = Duration::from_millis(100);
/// Readings closer together than this do not show a standstill.
const APART: Duration = Duration::from_millis(15);
/// The least progress that counts, as a fraction of the settling tolerance: above the resolution of any encoder that suits the
/// tolerance.
const PROGRESS_SHARE: f64 = 0.02;

/// An axis that does not follow the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lag {
    pub(super) axis: Axis,
    /// Actual position; mm or rad.
    pub(super) actual: f64,
    /// Expected position by the progress of the other axes; mm or rad.
    pub(super) expected: f64,
}

/// The progress of one axis towards its target.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Track {
    start: f64,
    /// Signed distance to the target.
    way: f64,
    speed: f64,
    limits: AxisLimits,
    /// An axis closer to its target than this has arrived.
    reach: f64,
    /// An axis with a greater following error than this lags.
    allowed: f64,
    actual: f64,
    /// Greatest distance from the start in any reading.
    travel: f64,
    /// Request time of the newest reading with progress.
    went_at: Option<Instant>,
    /// Request time of the newest reading.
    seen_at: Option<Instant>,
}

/// The supervision of both manipulators between two set-points.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Following {
    tracks: Pair<Axes<Option<Track>>>,
    /// Request time of the first reading that showed an axis in motion.
    started_at: Option<Instant>,
    /// Heartbeat of the newest reading, and when the status was last updated.
    renewed: Pair<Option<(u16, Instant)>>,
}

impl Following {
    /// Begins with a new set-point at the actual positions of the axes.
    pub(super) fn new(arrangement: &Arrangement, from: &Pair<Position>, to: &Waypoint, moves: &Pair<bool>) -> Self {
        let tracks = Pair::from_fn(|carrier| {
            Axes::from_fn(|axis| {
                let speed = *to.speeds.get(carrier).get(axis);
                let (start, target) = (*from.get(carrier).get(axis), *to.targets.get(carrier).get(axis));
                let goes = *moves.get(carrier) && speed > 0.0;
                goes.then(|| Track::new(arrangement, (carrier, axis), (start, target), speed))
            })
        });
        Self { tracks, started_at: None, renewed: Pair::default() }
    }

    /// Takes a reading of a manipulator, and returns the axis that does not follow, if there is one.
    pub(super) fn read(&mut self, carrier: Carrier, asked_at: Instant, reading: &Reading) -> Option<Lag> {
        if !self.is_renewed(carrier, asked_at, reading) {
            return None;
        }
        for (axis, one) in reading.axes.iter() {
            if let Some(track) = self.tracks.get_mut(carrier).get_mut(axis)
                && track.read(asked_at, one.actual)
            {
                self.started_at.get_or_insert(asked_at);
            }
        }
        Axis::ALL.into_iter().find_map(|axis| self.lag(carrier, axis, asked_at))
    }

    fn is_renewed(&mut self, carrier: Carrier, asked_at: Instant, reading: &Reading) -> bool {
        let tracks = self.tracks.get(carrier);
        let still = reading.axes.iter().all(|(axis, one)| {
            tracks.get(axis).as_ref().is_none_or(|track| track.actual.to_bits() == one.actual.to_bits())
        });
        match self.renewed.get(carrier) {
            Some((heartbeat, at)) if still && *heartbeat == reading.heartbeat => {
                asked_at.saturating_duration_since(*at) >= UNCHANGED_WITHIN
            }
            Some(_) | None => {
                *self.renewed.get_mut(carrier) = Some((reading.heartbeat, asked_at));
                true
            }
        }
    }

    /// Tests an axis after its reading.
    fn lag(&self, carrier: Carrier, axis: Axis, asked_at: Instant) -> Option<Lag> {
        let track = self.tracks.get(carrier).get(axis).as_ref().filter(|track| !track.is_there())?;
        let others = || self.others(carrier, axis);
        let fails = self.stands(track, others(), asked_at) || track.lags(others(), asked_at);
        fails.then(|| {
            let share = others().map(Track::share).fold(0.0, f64::max);
            let expected = track.start + track.way.signum() * (share * track.way.abs()).max(track.travel);
            Lag { axis, actual: track.actual, expected }
        })
    }

    fn others(&self, carrier: Carrier, axis: Axis) -> impl Iterator<Item = &Track> {
        let all = self.tracks.iter().flat_map(|(one, axes)| axes.iter().map(move |(other, track)| (one, other, track)));
        all.filter(move |(one, other, _)| (*one, *other) != (carrier, axis)).filter_map(|(.., track)| track.as_ref())
    }

    /// Whether an axis is at a standstill while another one has moved on.
    fn stands<'a>(&self, track: &Track, others: impl Iterator<Item = &'a Track>, asked_at: Instant) -> bool {
        let Some(others_went_at) = others.filter_map(|other| other.went_at).max() else { return false };
        let (since, within) = match (track.went_at, self.started_at) {
            (Some(at), _) => (at, APART),
            (None, Some(at)) => (at, START_WITHIN),
            (None, None) => return false,
        };
        let stood = asked_at.saturating_duration_since(since);
        others_went_at > since && stood >= within && track.expected(stood) >= 2.0 * track.least_progress()
    }
}

impl Track {
    fn new(
        arrangement: &Arrangement,
        (carrier, axis): (Carrier, Axis),
        (start, target): (f64, f64),
        speed: f64,
    ) -> Self {
        let limits = *arrangement.supports.get(carrier).limits.get(axis);
        let bound = match axis {
            Axis::X | Axis::Y | Axis::Z => arrangement.strain_max_mm,
            Axis::C => arrangement.twist_max,
        };
        Self {
            start,
            way: target - start,
            speed,
            limits,
            reach: *arrangement.settle_tolerance.get(axis),
            allowed: bound + speed * speed / (2.0 * limits.acceleration) + speed * START_WITHIN.as_secs_f64(),
            actual: start,
            travel: 0.0,
            went_at: None,
            seen_at: None,
        }
    }

    /// Takes a reading and returns whether it shows progress.
    fn read(&mut self, asked_at: Instant, actual: f64) -> bool {
        (self.actual, self.seen_at) = (actual, Some(asked_at));
        let travel = (actual - self.start) * self.way.signum();
        let progressed = travel >= self.travel + self.least_progress();
        if progressed {
            (self.travel, self.went_at) = (travel, Some(asked_at));
        }
        progressed
    }

    fn least_progress(&self) -> f64 {
        self.reach * PROGRESS_SHARE
    }

    fn is_there(&self) -> bool {
        self.travel >= self.way.abs() - self.reach
    }

    /// The fraction of its distance that it has certainly covered.
    fn share(&self) -> f64 {
        let sure = (self.travel - self.reach) / self.way.abs();
        if sure.is_finite() { sure.clamp(0.0, 1.0) } else { 0.0 }
    }

    /// The least distance that it moves from rest within a time, by its jerk, acceleration and speed limits.
    fn expected(&self, time: Duration) -> f64 {
        let t = time.as_secs_f64();
        let AxisLimits { acceleration, jerk, .. } = self.limits;
        (self.speed * t).min(0.5 * acceleration * t * t).min(jerk * t * t * t / 6.0)
    }

    /// Whether it is too far behind the farthest of the others. Axes that were read later are ignored, because they would be ahead
    /// by the distance that they have moved in between.
    fn lags<'a>(&self, others: impl Iterator<Item = &'a Self>, asked_at: Instant) -> bool {
        let comparable = others.filter(|other| other.seen_at.is_some_and(|seen_at| seen_at <= asked_at));
        let share = comparable.map(Self::share).fold(0.0, f64::max);
        share * self.way.abs() - self.travel > self.allowed
    }
}

//! What lies between the encoders of a made manipulator and its clamp: backlash and cross-coupling. In: where the encoders are.
//! Out: where the clamp is.

use crate::motion::{Axes, Position};

/// The clamp of one manipulator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Mechanics {
    backlash: Axes<f64>,
    coupling_ratio: f64,
    /// Where each axis' load is: within half the backlash of its encoder.
    loads: Position,
}

impl Mechanics {
    /// Every axis in the middle of its backlash.
    pub(super) const fn new(start: Position, backlash: Axes<f64>, coupling_ratio: f64) -> Self {
        Self { backlash, coupling_ratio, loads: start }
    }

    /// The encoders have moved; the loads are pushed along once the backlash is used up.
    pub(super) fn follow(&mut self, encoders: &Position) {
        self.loads = self.loads.map(|axis, load| {
            let (encoder, half) = (*encoders.get(axis), 0.5 * self.backlash.get(axis).abs());
            load.max(encoder - half).min(encoder + half)
        });
    }

    /// Where the clamp is. The linear axes are not quite square: each shows a share of the other two.
    pub(super) fn clamp(&self) -> Position {
        let Axes { x, y, z, c } = self.loads;
        let share = self.coupling_ratio;
        Axes { x: x + share * (y + z), y: y + share * (x + z), z: z + share * (x + y), c }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_back_loses_the_backlash_and_a_motion_on_does_not() {
        let backlash = Axes::from_fn(|_| 0.05);
        let mut clamp = Mechanics::new(Axes::default(), backlash, 0.0);
        let mut at = |y: f64| {
            clamp.follow(&Axes { y, ..Axes::default() });
            clamp.clamp().y
        };
        let seen = [at(1.0), at(2.0), at(1.98), at(1.95), at(1.0)];
        let due = [0.975, 1.975, 1.975, 1.975, 1.025];
        for (seen, due) in seen.into_iter().zip(due) {
            assert!((seen - due).abs() < 1e-12, "{seen} instead of {due}");
        }
    }

    #[test]
    fn a_linear_axis_shows_its_share_in_the_two_others_and_not_in_the_turn() {
        let mut clamp = Mechanics::new(Axes::default(), Axes::default(), 0.02);
        clamp.follow(&Axes { z: 10.0, ..Axes::default() });
        assert_eq!(clamp.clamp(), Axes { x: 0.2, y: 0.2, z: 10.0, c: 0.0 });
    }
}

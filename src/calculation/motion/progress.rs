//! How far along its way a motion is at a time: s(t) from 0 to 1, from rest to rest, in the shortest time that greatest speed,
//! acceleration and jerk of s allow.
//!
//! ```text
//! jerk  +J  0  -J   0   -J  0  +J          tj  time at greatest jerk: the least of A/J, √(V/J), ∛(1/2J)
//! time  tj ta  tj  tv   tj ta  tj          ta  at greatest acceleration a = J tj;  tv  at greatest speed v = a (tj + ta)
//! ```
//!
//! The way of both ramps is v (2 tj + ta); it is what V allows, or all of the way, whichever is less. The second half is the
//! first one backwards.

/// Greatest rates of s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pace {
    /// ds/dt, 1/s.
    pub(super) speed: f64,
    /// d²s/dt², 1/s².
    pub(super) acceleration: f64,
    /// d³s/dt³, 1/s³.
    pub(super) jerk: f64,
}

/// The profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Progress {
    jerk: f64,
    jerk_time: f64,
    steady_time: f64,
    cruise_time: f64,
}

impl Progress {
    /// The quickest one. All three rates above zero.
    pub(super) fn new(pace: &Pace) -> Self {
        let Pace { speed, acceleration, jerk } = *pace;
        let jerk_time = (acceleration / jerk).min((speed / jerk).sqrt()).min((0.5 / jerk).cbrt());
        let reached = jerk * jerk_time;
        let to_speed = speed / reached - jerk_time;
        let to_half = 0.5 * ((jerk_time * jerk_time + 4.0 / reached).sqrt() - 3.0 * jerk_time);
        let steady_time = to_speed.min(to_half).max(0.0);
        let ramp = 2.0 * jerk_time + steady_time;
        let cruise_time = (1.0 / (reached * (jerk_time + steady_time)) - ramp).max(0.0);
        Self { jerk, jerk_time, steady_time, cruise_time }
    }

    /// From start to end, s.
    pub(super) fn duration(&self) -> f64 {
        2.0 * self.ramp() + self.cruise_time
    }

    /// When s is reached.
    pub(super) fn time_at(&self, s: f64) -> f64 {
        if s > 0.5 {
            return self.duration() - self.time_at(1.0 - s);
        }
        // s rises with time, so halving finds it; fifty halvings leave nothing that double precision could tell.
        let (mut early, mut late) = (0.0, 0.5 * self.duration());
        for _ in 0..52 {
            let middle = 0.5 * (early + late);
            if self.first_half(middle) < s { early = middle } else { late = middle }
        }
        0.5 * (early + late)
    }

    /// s at a time.
    #[cfg(test)]
    pub(super) fn at(&self, time: f64) -> f64 {
        let left = self.duration() - time;
        if time <= left { self.first_half(time) } else { 1.0 - self.first_half(left) }
    }

    fn ramp(&self) -> f64 {
        2.0 * self.jerk_time + self.steady_time
    }

    fn first_half(&self, time: f64) -> f64 {
        let (j, tj, ta) = (self.jerk, self.jerk_time, self.steady_time);
        let top = j * tj * (tj + ta);
        let ramp_way = 0.5 * top * self.ramp();
        let left = self.ramp() - time;
        if time <= tj {
            j * time * time * time / 6.0
        } else if left >= tj {
            let since = time - tj;
            j * tj * (tj * tj / 6.0 + 0.5 * tj * since + 0.5 * since * since)
        } else if left >= 0.0 {
            ramp_way - top * left + j * left * left * left / 6.0
        } else {
            ramp_way - top * left
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rsruckig::prelude::*;

    /// The duration of the same motion by another program, which plans for time optimum.
    fn duration_by_ruckig(pace: &Pace) -> f64 {
        let mut solver = Ruckig::<1, ThrowErrorHandler>::new(None, 0.01);
        let mut input = InputParameter::<1>::new(None);
        input.target_position[0] = 1.0;
        input.max_velocity[0] = pace.speed;
        input.max_acceleration[0] = pace.acceleration;
        input.max_jerk[0] = pace.jerk;
        let mut trajectory = Trajectory::new(None);
        solver.calculate(&input, &mut trajectory).expect("a motion from rest to rest has an answer");
        trajectory.get_duration()
    }

    fn paces() -> impl Strategy<Value = Pace> {
        // Over six decades each, so that every phase is sometimes there and sometimes not.
        (-3.0..3.0, -3.0..3.0, -3.0..3.0).prop_map(|(v, a, j): (f64, f64, f64)| Pace {
            speed: 10f64.powf(v),
            acceleration: 10f64.powf(a),
            jerk: 10f64.powf(j),
        })
    }

    proptest! {
        #![proptest_config(crate::motion::tests::fixed())]

        #[test]
        fn no_motion_within_the_rates_is_quicker(pace in paces()) {
            let (ours, theirs) = (Progress::new(&pace).duration(), duration_by_ruckig(&pace));
            prop_assert!((ours / theirs - 1.0).abs() < 1e-7, "{ours} s, {theirs} s");
        }

        #[test]
        fn it_starts_and_ends_at_rest_and_keeps_its_rates(pace in paces()) {
            let progress = Progress::new(&pace);
            let (duration, n) = (progress.duration(), 2000);
            let h = duration / f64::from(n);
            let s = |i: i32| progress.at(duration * f64::from(i) / f64::from(n));
            prop_assert!(s(0) == 0.0 && s(n) == 1.0);
            // From rest, jerk alone takes it no further.
            let first = pace.jerk * h * h * h / 6.0 * (1.0 + 1e-9) + 1e-15;
            prop_assert!(s(1) <= first && 1.0 - s(n - 1) <= first, "not at rest at its ends");
            for i in 0..n {
                // Differences of values that are good to 1e-15.
                let speed = (s(i + 1) - s(i)) / h;
                prop_assert!(speed >= 0.0 && speed <= pace.speed * (1.0 + 1e-9) + 1e-15 / h);
                if i > 0 {
                    let acceleration = (s(i + 1) - 2.0 * s(i) + s(i - 1)) / (h * h);
                    prop_assert!(acceleration.abs() <= pace.acceleration * (1.0 + 1e-6) + 4e-15 / (h * h));
                }
                if i > 0 && i + 2 <= n {
                    let jerk = (s(i + 2) - 3.0 * s(i + 1) + 3.0 * s(i) - s(i - 1)) / (h * h * h);
                    prop_assert!(jerk.abs() <= pace.jerk * (1.0 + 1e-6) + 8e-15 / (h * h * h));
                }
            }
        }

        #[test]
        fn the_time_of_a_place_is_the_time_at_which_it_is_there(pace in paces(), s in 0.0..=1.0) {
            let progress = Progress::new(&pace);
            prop_assert!((progress.at(progress.time_at(s)) - s).abs() < 1e-12);
        }
    }
}

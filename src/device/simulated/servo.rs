//! One driven axis: goes to a target with limited speed and acceleration, or brakes. In: steps of simulated time. Out: where it
//! is.

/// How closely a target is met before the axis stands, mm or rad.
const AT_TARGET: f64 = 1e-9;

/// An axis under way or at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Servo {
    position: f64,
    velocity: f64,
    target: f64,
    speed: f64,
    acceleration: f64,
    braking: bool,
}

impl Servo {
    /// At rest at `position`.
    pub(super) const fn at(position: f64, acceleration: f64) -> Self {
        Self { position, velocity: 0.0, target: position, speed: 0.0, acceleration, braking: false }
    }

    /// Where it is.
    pub(super) const fn position(&self) -> f64 {
        self.position
    }

    /// Whether it stands where it was sent.
    pub(super) fn rests(&self) -> bool {
        self.velocity == 0.0 && !self.braking && self.position == self.target
    }

    /// Sends it to `target` with at most `speed`.
    pub(super) const fn go(&mut self, target: f64, speed: f64) {
        (self.target, self.speed, self.braking) = (target, speed, false);
    }

    /// Comes to rest at the greatest deceleration, wherever that is.
    pub(super) const fn brake(&mut self) {
        self.braking = true;
    }

    /// Something holds it: it stands where it is, and goes on trying unless it brakes.
    pub(super) fn stick(&mut self) {
        self.velocity = 0.0;
        if self.braking {
            (self.target, self.braking) = (self.position, false);
        }
    }

    /// Moves on by `dt` seconds.
    pub(super) fn step(&mut self, dt: f64) {
        let left = self.target - self.position;
        let wanted = if self.braking { 0.0 } else { self.approach(left.abs(), dt).copysign(left) };
        let change = self.acceleration * dt;
        self.velocity += (wanted - self.velocity).clamp(-change, change);
        self.position += self.velocity * dt;
        if self.braking && self.velocity == 0.0 {
            (self.target, self.braking) = (self.position, false);
        }
        if !self.braking && (self.target - self.position).abs() < AT_TARGET && self.velocity.abs() <= change {
            (self.position, self.velocity) = (self.target, 0.0);
        }
    }

    /// The greatest speed from which it still comes to rest within `left`. In steps of a·dt the way is v²/2a + v·dt/2.
    fn approach(&self, left: f64, dt: f64) -> f64 {
        let step = self.acceleration * dt;
        let braking = step * ((0.25 + 2.0 * left / (step * dt)).sqrt() - 0.5);
        self.speed.min(braking).min(left / dt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.001;

    #[test]
    fn it_arrives_exactly_and_in_the_time_of_a_trapezoid() {
        // 30 mm at 10 mm/s and 50 mm/s²: s/v + v/a = 3.2 s.
        for target in [30.0, -30.0] {
            let mut servo = Servo::at(0.0, 50.0);
            servo.go(target, 10.0);
            let (mut steps, mut farthest) = (0, 0.0_f64);
            while !servo.rests() {
                servo.step(DT);
                farthest = farthest.max(servo.position().abs());
                steps += 1;
                assert!(steps < 10_000);
            }
            assert!(servo.position() == target && farthest <= 30.0 + 1e-9, "{farthest}");
            assert!((f64::from(steps) * DT - 3.2).abs() < 0.01, "{steps}");
        }
    }

    #[test]
    fn it_never_exceeds_its_speed_and_brakes_within_the_way_that_physics_gives() {
        let mut servo = Servo::at(0.0, 50.0);
        servo.go(100.0, 10.0);
        for _ in 0..1_000 {
            let before = servo.position();
            servo.step(DT);
            assert!(servo.position() - before <= 10.0 * DT + 1e-12);
        }
        let from = servo.position();
        servo.brake();
        while !servo.rests() {
            servo.step(DT);
        }
        // v²/2a = 1 mm.
        assert!((servo.position() - from - 1.0).abs() < 0.02, "{}", servo.position() - from);
    }
}

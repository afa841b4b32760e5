//! Converts the configuration of the cell for motion, cell and simulation: lengths remain in mm, degrees become radians,
//! milliseconds become durations. Also the calibration of a scan by a simulated sensor, which the simulation provides.

use super::settings::SensorAdaptor;
use super::settings::{Cell, Timing};
use super::settings::{LinearLimits, SupportLimits, TurnLimits};
use crate::cell::Settings;
use crate::device::simulated::{Mounting, Straightness};
use crate::estimation::TypeB;
use crate::motion::{Arrangement, Axes, AxisLimits, Pair, Support};
use std::time::Duration;

impl Cell {
    /// Positions and limits of the manipulators.
    #[must_use]
    pub fn arrangement(&self) -> Arrangement {
        let together = &self.together;
        let tolerance = &together.tolerance;
        Arrangement {
            supports: self.manipulators.map(|_, manipulator| Support {
                mount_mm: manipulator.mount_mm,
                limits: axes(&manipulator.limits),
                half_span_mm: manipulator.half_span_mm,
            }),
            strain_max_mm: together.strain_max_mm,
            run_on_max_mm: together.run_on_max_mm,
            twist_max: together.twist_max_deg.to_radians(),
            clearance_min_mm: together.clearance_min_mm,
            settle_tolerance: Axes {
                x: tolerance.x_mm,
                y: tolerance.y_mm,
                z: tolerance.z_mm,
                c: tolerance.c_deg.to_radians(),
            },
        }
    }

    /// The settings of the cell's task and drivers.
    #[must_use]
    pub fn settings(&self) -> Settings {
        let Timing {
            poll_ms,
            poll_moving_ms,
            reply_ms,
            connect_ms,
            acknowledge_ms,
            watchdog_ms,
            arrival_ms,
            scan_stall_ms,
        } = self.timing;
        let ms = Duration::from_millis;
        Settings {
            poll: ms(poll_ms),
            poll_moving: ms(poll_moving_ms),
            reply: ms(reply_ms),
            connect: ms(connect_ms),
            acknowledge: ms(acknowledge_ms),
            watchdog: ms(watchdog_ms),
            arrival: ms(arrival_ms),
            scan_stall: ms(scan_stall_ms),
            lease_least: ms(self.lease.ttl_min_ms),
            lease_most: ms(self.lease.ttl_max_ms),
            ..Settings::new(self.arrangement())
        }
    }

    /// The calibration of a scan by the sensor as the configuration declares it (`estimation.type_b`). Values that it does not
    /// declare come from the simulated stage if the sensor is simulated.
    #[must_use]
    pub fn type_b_of_scans(&self, stated: TypeB) -> TypeB {
        if self.sensor.adaptor != SensorAdaptor::Simulated || stated.is_stated() {
            return stated;
        }
        let Straightness { standard_mm, correlation_length_mm } = self.simulated.straightness();
        TypeB {
            stage_straightness_mm: standard_mm,
            // The range that a recipe may declare.
            stage_straightness_length_mm: correlation_length_mm.clamp(1.0, 1e5),
            ..stated
        }
    }

    /// The positions and limits of the simulated manipulators.
    #[must_use]
    pub fn mountings(&self) -> Pair<Mounting> {
        self.manipulators
            .map(|_, manipulator| Mounting { mount_mm: manipulator.mount_mm, limits: axes(&manipulator.limits) })
    }
}

fn axes(limits: &SupportLimits) -> Axes<AxisLimits> {
    Axes { x: linear(&limits.x), y: linear(&limits.y), z: linear(&limits.z), c: turn(&limits.c) }
}

const fn linear(limits: &LinearLimits) -> AxisLimits {
    AxisLimits {
        lower: limits.lower_mm,
        upper: limits.upper_mm,
        speed: limits.speed_mm_s,
        acceleration: limits.acceleration_mm_s2,
        jerk: limits.jerk_mm_s3,
        step: limits.step_mm,
    }
}

const fn turn(limits: &TurnLimits) -> AxisLimits {
    AxisLimits {
        lower: limits.lower_deg.to_radians(),
        upper: limits.upper_deg.to_radians(),
        speed: limits.speed_deg_s.to_radians(),
        acceleration: limits.acceleration_deg_s2.to_radians(),
        jerk: limits.jerk_deg_s3.to_radians(),
        step: limits.step_deg.to_radians(),
    }
}

//! The simulated cell itself: a part on two manipulators, and a stage with a sensor above it, with a common simulated time. Input:
//! the requests of the adaptors, each at its time. Output: the answers of the devices, and the true pose.

use super::controller::{Controller, ControllerSettings, Record};
use super::drives::Carriage;
use super::faults::{Device, Fault, Faults, Struck};
use super::part::{HeldPart, Place};
use super::scanning::{ProfileMaker, Scanning};
use super::settings::{Mounting, SettingError, Settings, check_mountings};
use crate::device::clock::now;
use crate::device::manipulator::{Mode, Safety};
use crate::geometry::AxisLine;
use crate::motion::{Axes, Axis, Carrier, Pair, Position};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// The simulated cell. Clones share the same cell.
#[derive(Debug, Clone)]
pub struct World {
    began: Instant,
    settings: Arc<Settings>,
    profile_maker: Arc<ProfileMaker>,
    cell: Arc<Mutex<SimulatedCell>>,
}

/// The state of the cell.
#[derive(Debug)]
pub(super) struct SimulatedCell {
    pub(super) controllers: Pair<Controller>,
    pub(super) carriage: Carriage,
    pub(super) scanning: Scanning,
    pub(super) faults: Faults,
    part: HeldPart,
}

impl World {
    /// A cell at rest, with nothing enabled and the part at the place given by the settings.
    ///
    /// # Errors
    /// [`SettingError`] names the first setting that is out of range.
    pub fn new(settings: &Settings, mountings: &Pair<Mounting>) -> Result<Self, SettingError> {
        settings.check()?;
        check_mountings(mountings)?;
        let mut controllers = mountings.map(|_, mounting| Controller::new(controller_settings(settings, mounting)));
        let start = Pair::from_fn(|carrier| controllers.get_mut(carrier).clamp(Duration::ZERO));
        let cell = SimulatedCell {
            part: HeldPart::put(&settings.part, mountings.map(|_, mounting| mounting.mount_mm), start),
            carriage: Carriage::new(settings.stage.clone(), settings.time_factor),
            scanning: Scanning::default(),
            faults: Faults::default(),
            controllers,
        };
        Ok(Self {
            began: now(),
            profile_maker: Arc::new(ProfileMaker::new(settings)),
            settings: Arc::new(settings.clone()),
            cell: Arc::new(Mutex::new(cell)),
        })
    }

    /// The handle that injects faults.
    #[must_use]
    pub fn faults(&self) -> FaultSwitch {
        FaultSwitch { world: self.clone() }
    }

    /// The true axis of the part at this moment.
    #[must_use]
    pub fn truth(&self) -> AxisLine {
        self.at_now(|cell, now| cell.place(now).axis())
    }

    /// The true rotation of the part about its axis since the start, rad.
    #[must_use]
    pub fn true_roll(&self) -> f64 {
        self.at_now(|cell, now| cell.place(now).roll)
    }

    /// The commands that a manipulator has received.
    #[must_use]
    pub fn record(&self, carrier: Carrier) -> Record {
        self.at_now(|cell, _| cell.controllers.get(carrier).record().clone())
    }

    /// The number of targets and speeds that the stage refused because they were outside its limits.
    #[must_use]
    pub fn stage_out_of_limits_count(&self) -> u64 {
        self.at_now(|cell, _| cell.carriage.out_of_limits_count())
    }

    /// Sets the states of the safety functions, e.g. presses an emergency stop or opens a guard.
    pub fn set_safety(&self, carrier: Carrier, safety: Safety) {
        self.at_now(|cell, now| cell.controllers.get_mut(carrier).set_safety(safety, now));
    }

    /// Blocks an axis, or frees it; the device reports no fault.
    pub fn set_stuck(&self, carrier: Carrier, axis: Axis, stuck: bool) {
        self.at_now(|cell, now| cell.controllers.get_mut(carrier).set_stuck(axis, stuck, now));
    }

    /// Whether the sensor's laser is on.
    #[must_use]
    pub fn laser_is_on(&self) -> bool {
        self.at_now(|cell, _| cell.scanning.is_armed())
    }

    /// The true position of a manipulator's clamp at this moment.
    #[must_use]
    pub fn clamp(&self, carrier: Carrier) -> Position {
        self.at_now(|cell, now| cell.controllers.get_mut(carrier).clamp(now))
    }

    /// Sets the mode switch of a manipulator.
    pub fn set_mode(&self, carrier: Carrier, mode: Mode) {
        self.at_now(|cell, now| cell.controllers.get_mut(carrier).set_mode(mode, now));
    }

    /// The settings of the cell.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    pub(super) fn profile_maker(&self) -> &Arc<ProfileMaker> {
        &self.profile_maker
    }

    /// Executes an action at this moment, after all events until now.
    pub(super) fn at_now<T>(&self, act: impl FnOnce(&mut SimulatedCell, Duration) -> T) -> T {
        let now = now().saturating_duration_since(self.began);
        let mut cell = self.lock();
        cell.advance(now);
        act(&mut cell, now)
    }

    /// After a panic elsewhere the values are old, but consistent.
    fn lock(&self) -> MutexGuard<'_, SimulatedCell> {
        self.cell.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn controller_settings(settings: &Settings, mounting: &Mounting) -> ControllerSettings {
    let own = &settings.manipulators;
    let (linear, turn) = (own.backlash_mm, own.backlash_deg.to_radians());
    ControllerSettings {
        homed: own.homed,
        time_factor: settings.time_factor,
        watchdog_max: Duration::from_secs_f64(own.watchdog_ms / 1000.0),
        homing_s: own.homing_s,
        backlash: Axes { x: linear, y: linear, z: linear, c: turn },
        coupling_ratio: own.coupling_ratio,
        ..ControllerSettings::exact(mounting.limits)
    }
}

impl SimulatedCell {
    /// Simulates all events until `now` in order, so that a profile sees the part where it was when the profile was taken.
    fn advance(&mut self, now: Duration) {
        while let Some(at) = self.carriage.step_towards(now) {
            self.take_profiles(at);
        }
        self.take_profiles(now);
        for carrier in Carrier::ALL {
            self.controllers.get_mut(carrier).advance(now);
        }
    }

    pub(super) fn take_profiles(&mut self, at: Duration) {
        while let Some(x) = self.scanning.due(self.carriage.position()) {
            let place = self.place(at);
            self.scanning.trigger(x, place);
        }
    }

    fn place(&mut self, at: Duration) -> Place {
        let clamps = Pair::from_fn(|carrier| self.controllers.get_mut(carrier).clamp(at));
        self.part.at(&clamps)
    }

    /// Applies a fault of a device itself; faults of links are applied by the links.
    pub(super) fn apply_fault(&mut self, device: Device, fault: &Fault, now: Duration) {
        match (device, fault) {
            (Device::Manipulator(carrier), Fault::LimitHit { axis }) => {
                self.controllers.get_mut(carrier).hit_limit(*axis, now);
            }
            (Device::Stage, Fault::Stall) => self.carriage.stall(true),
            _ => {}
        }
    }
}

/// Injects faults into the cell.
#[derive(Debug, Clone)]
pub struct FaultSwitch {
    world: World,
}

impl FaultSwitch {
    /// Injects a fault into the next exchange with the device, once.
    pub fn next(&self, device: Device, fault: Fault) {
        self.world.lock().faults.next(device, fault);
    }

    /// Injects a fault into the exchange of this number (from 1; see [`Self::steps`]), once.
    pub fn at(&self, device: Device, step: u64, fault: Fault) {
        self.world.lock().faults.at(device, step, fault);
    }

    /// Injects a fault into every exchange from now on.
    pub fn hold(&self, device: Device, fault: Fault) {
        self.world.lock().faults.hold(device, fault);
    }

    /// Ends all faults of the device, except random ones.
    pub fn clear(&self, device: Device) {
        self.world.lock().faults.clear(device);
    }

    /// Injects random faults from `seed` into this fraction of all exchanges; 0 ends it.
    pub fn by_chance(&self, seed: u64, ratio: f64) {
        self.world.lock().faults.by_chance(seed, ratio);
    }

    /// Ends a stall. The stage stays at its position.
    pub fn free_stage(&self) {
        self.world.at_now(|cell, _| cell.carriage.stall(false));
    }

    /// The number of exchanges with the device so far.
    #[must_use]
    pub fn steps(&self, device: Device) -> u64 {
        self.world.lock().faults.steps(device)
    }

    /// The faults that were injected, in order.
    #[must_use]
    pub fn struck(&self) -> Vec<Struck> {
        self.world.lock().faults.struck().to_vec()
    }
}

//! The simulated cell itself: a part on two manipulators, a stage with a sensor above it, one simulated time for all. In: requests
//! of the adaptors, each at its moment. Out: what the devices answer, and the truth.

use super::carriage::Carriage;
use super::controller::{Controller, ControllerSettings};
use super::faults::{Device, Fault, Faults, Struck};
use super::link::Link;
use super::manipulator::SimulatedManipulator;
use super::part::{HeldPart, Place};
use super::profiler::SimulatedSensor;
use super::record::Record;
use super::scanning::{Eye, Scanning};
use super::settings::{Mounting, SettingError, Settings, check_mountings};
use super::stage::SimulatedStage;
use crate::device::manipulator::{Mode, Safety};
use crate::geometry::AxisLine;
use crate::motion::{Axes, Axis, Carrier, Pair, Position};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// The simulated cell, cheap to share: clones are the same cell.
#[derive(Debug, Clone)]
pub struct World {
    began: Instant,
    settings: Arc<Settings>,
    eye: Arc<Eye>,
    cell: Arc<Mutex<MadeCell>>,
}

/// What changes in the cell.
#[derive(Debug)]
pub(super) struct MadeCell {
    pub(super) controllers: Pair<Controller>,
    pub(super) carriage: Carriage,
    pub(super) scanning: Scanning,
    pub(super) faults: Faults,
    part: HeldPart,
}

/// The machine's clock, or the one that a test has stopped.
#[expect(
    clippy::disallowed_methods,
    reason = "the made devices live on tokio's clock; this is the one place they read it"
)]
fn clock() -> Instant {
    Instant::now()
}

impl World {
    /// A cell at rest: nothing enabled, the part where the settings say.
    ///
    /// # Errors
    /// [`SettingError`] names the first setting that is out of range.
    pub fn new(settings: &Settings, mountings: &Pair<Mounting>) -> Result<Self, SettingError> {
        settings.check()?;
        check_mountings(mountings)?;
        let mut controllers = mountings.map(|_, mounting| Controller::new(controller_settings(settings, mounting)));
        let start = Pair::from_fn(|carrier| controllers.get_mut(carrier).clamp(Duration::ZERO));
        let cell = MadeCell {
            part: HeldPart::put(&settings.part, mountings.map(|_, mounting| mounting.mount_mm), start),
            carriage: Carriage::new(settings.stage.clone(), settings.time_factor),
            scanning: Scanning::default(),
            faults: Faults::default(),
            controllers,
        };
        Ok(Self {
            began: clock(),
            eye: Arc::new(Eye::new(settings)),
            settings: Arc::new(settings.clone()),
            cell: Arc::new(Mutex::new(cell)),
        })
    }

    /// A new link to a manipulator, not connected.
    #[must_use]
    pub fn manipulator(&self, carrier: Carrier) -> SimulatedManipulator {
        SimulatedManipulator::new(carrier, Link::new(self.clone(), Device::Manipulator(carrier)))
    }

    /// A new link to the sensor, not connected.
    #[must_use]
    pub fn sensor(&self) -> SimulatedSensor {
        SimulatedSensor::new(Link::new(self.clone(), Device::Sensor))
    }

    /// A new link to the stage, not connected.
    #[must_use]
    pub fn stage(&self) -> SimulatedStage {
        SimulatedStage::new(Link::new(self.clone(), Device::Stage))
    }

    /// The switch for faults.
    #[must_use]
    pub fn faults(&self) -> FaultSwitch {
        FaultSwitch { world: self.clone() }
    }

    /// Where the part's axis really is now.
    #[must_use]
    pub fn truth(&self) -> AxisLine {
        self.at_now(|cell, now| cell.place(now).axis())
    }

    /// How far the part has really turned about its axis since the start, rad.
    #[must_use]
    pub fn true_roll(&self) -> f64 {
        self.at_now(|cell, now| cell.place(now).roll)
    }

    /// What a manipulator was told so far.
    #[must_use]
    pub fn record(&self, carrier: Carrier) -> Record {
        self.at_now(|cell, _| cell.controllers.get(carrier).record().clone())
    }

    /// Targets and speeds that the stage should never have been sent, and refused.
    #[must_use]
    pub fn stage_out_of_limits_count(&self) -> u64 {
        self.at_now(|cell, _| cell.carriage.out_of_limits_count())
    }

    /// Presses an emergency stop, opens a guard, or the like.
    pub fn set_safety(&self, carrier: Carrier, safety: Safety) {
        self.at_now(|cell, now| cell.controllers.get_mut(carrier).set_safety(safety, now));
    }

    /// Holds an axis where it is, or lets it go; the device reports no fault.
    pub fn set_stuck(&self, carrier: Carrier, axis: Axis, stuck: bool) {
        self.at_now(|cell, now| cell.controllers.get_mut(carrier).set_stuck(axis, stuck, now));
    }

    /// Whether the sensor's laser is on.
    #[must_use]
    pub fn laser_is_on(&self) -> bool {
        self.at_now(|cell, _| cell.scanning.is_armed())
    }

    /// Where a manipulator's clamp really is now.
    #[must_use]
    pub fn clamp(&self, carrier: Carrier) -> Position {
        self.at_now(|cell, now| cell.controllers.get_mut(carrier).clamp(now))
    }

    /// Turns a manipulator's switch for the mode.
    pub fn set_mode(&self, carrier: Carrier, mode: Mode) {
        self.at_now(|cell, now| cell.controllers.get_mut(carrier).set_mode(mode, now));
    }

    /// What the cell is like.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    pub(super) fn eye(&self) -> &Arc<Eye> {
        &self.eye
    }

    /// Does something at this moment, after everything that has happened until now.
    pub(super) fn at_now<T>(&self, act: impl FnOnce(&mut MadeCell, Duration) -> T) -> T {
        let now = clock().saturating_duration_since(self.began);
        let mut cell = self.lock();
        cell.advance(now);
        act(&mut cell, now)
    }

    /// A panic elsewhere leaves numbers that are old, not wrong.
    fn lock(&self) -> MutexGuard<'_, MadeCell> {
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

impl MadeCell {
    /// Lets everything happen until `now`, in order: a profile sees the part where it was when the profile was taken.
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

    /// Lets a fault of a device itself come about; those of links are the links'.
    pub(super) fn suffer(&mut self, device: Device, fault: &Fault, now: Duration) {
        match (device, fault) {
            (Device::Manipulator(carrier), Fault::LimitHit { axis }) => {
                self.controllers.get_mut(carrier).hit_limit(*axis, now);
            }
            (Device::Stage, Fault::Stall) => self.carriage.stall(true),
            _ => {}
        }
    }
}

/// Makes things go wrong in the cell that it belongs to.
#[derive(Debug, Clone)]
pub struct FaultSwitch {
    world: World,
}

impl FaultSwitch {
    /// In the next exchange with the device, once.
    pub fn next(&self, device: Device, fault: Fault) {
        self.world.lock().faults.next(device, fault);
    }

    /// In the exchange of this number (from 1; see [`Self::steps`]), once.
    pub fn at(&self, device: Device, step: u64, fault: Fault) {
        self.world.lock().faults.at(device, step, fault);
    }

    /// In every exchange from now on.
    pub fn hold(&self, device: Device, fault: Fault) {
        self.world.lock().faults.hold(device, fault);
    }

    /// Nothing more goes wrong with the device, but by chance.
    pub fn clear(&self, device: Device) {
        self.world.lock().faults.clear(device);
    }

    /// In this share of all exchanges something goes wrong, by chance from `seed`; 0 ends it.
    pub fn by_chance(&self, seed: u64, ratio: f64) {
        self.world.lock().faults.by_chance(seed, ratio);
    }

    /// Ends a stall. The stage stays where it is.
    pub fn free_stage(&self) {
        self.world.at_now(|cell, _| cell.carriage.stall(false));
    }

    /// Exchanges with the device so far.
    #[must_use]
    pub fn steps(&self, device: Device) -> u64 {
        self.world.lock().faults.steps(device)
    }

    /// The faults that struck, in order.
    #[must_use]
    pub fn struck(&self) -> Vec<Struck> {
        self.world.lock().faults.struck().to_vec()
    }
}

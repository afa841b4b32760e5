//! What a PLC keeps between its controllers and its nodes: an image of the status, made anew once a cycle, and what was written
//! of the next command. In: values of nodes, and the time. Out: values of nodes.

use super::image::{command, value};
use crate::device::manipulator::{Reading, Safety};
use crate::device::opcua::clock::now;
use crate::device::opcua::layout::Node;
use crate::device::simulated::Controller;
use crate::device::states::StateCodes;
use crate::motion::{Carrier, Pair};
use opcua::types::{DataValue, StatusCode, Variant};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// How often the image is made anew, as a PLC's program runs.
const CYCLE: Duration = Duration::from_millis(5);

/// A simulated PLC with two manipulators.
#[derive(Debug)]
pub struct Plc {
    began: Instant,
    codes: StateCodes,
    stations: Mutex<Pair<Station>>,
}

#[derive(Debug)]
struct Station {
    controller: Controller,
    image: Option<Image>,
    cycles_count: u32,
    written: Vec<(Node, DataValue)>,
}

#[derive(Debug)]
struct Image {
    at: Duration,
    reading: Reading,
}

impl Plc {
    /// A PLC of these controllers; its time begins now.
    #[must_use]
    pub fn new(controllers: Pair<Controller>, codes: StateCodes) -> Self {
        let Pair { m1, m2 } = controllers;
        let stations = Mutex::new(Pair { m1: Station::new(m1), m2: Station::new(m2) });
        Self { began: now(), codes, stations }
    }

    /// Looks at a controller, or changes it, at the PLC's time.
    pub fn with<T>(&self, carrier: Carrier, act: impl FnOnce(&mut Controller, Duration) -> T) -> T {
        let now = self.time();
        act(&mut self.lock().get_mut(carrier).controller, now)
    }

    /// Presses an emergency stop, opens a guard, or the like.
    pub fn set_safety(&self, carrier: Carrier, safety: Safety) {
        self.with(carrier, |controller, now| controller.set_safety(safety, now));
    }

    fn time(&self) -> Duration {
        now().saturating_duration_since(self.began)
    }

    /// A panic elsewhere leaves numbers that are old, not wrong.
    fn lock(&self) -> MutexGuard<'_, Pair<Station>> {
        self.stations.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The value of a node in the newest image, or as it was written.
    pub(super) fn read(&self, carrier: Carrier, node: Node) -> Result<DataValue, StatusCode> {
        let now = self.time();
        let mut stations = self.lock();
        let station = stations.get_mut(carrier);
        let (reading, snapshot) = station.image(now);
        let status = value(node, reading, snapshot, self.codes).map(DataValue::new_now);
        let written = || station.written.iter().find(|(of, _)| *of == node).map(|(_, value)| value.clone());
        status.or_else(written).ok_or(StatusCode::BadNoData)
    }

    /// Takes what was written to a node. The number of a command is acted upon.
    pub(super) fn write(&self, carrier: Carrier, node: Node, value: Variant) -> StatusCode {
        let now = self.time();
        let mut stations = self.lock();
        let station = stations.get_mut(carrier);
        let Some((_, kept)) = station.written.iter_mut().find(|(of, _)| *of == node) else {
            return StatusCode::BadNotWritable;
        };
        let news = kept.value.as_ref() != Some(&value);
        *kept = DataValue::new_now(value);
        match node {
            Node::Pulse if news => station.controller.beat(now),
            Node::Sequence => {
                let Ok(command) = command(&station.written) else { return StatusCode::BadOutOfRange };
                station.controller.take(&command, now);
                station.image = None;
            }
            _ => {}
        }
        StatusCode::Good
    }
}

impl Station {
    fn new(controller: Controller) -> Self {
        let zero = |node: Node| match node {
            Node::Fence => Variant::UInt64(0),
            Node::WatchdogMs => Variant::UInt32(0),
            Node::Targets | Node::Velocities => Variant::from(vec![0.0_f64; 4]),
            _ => Variant::UInt16(0),
        };
        let written = Node::COMMAND.into_iter().chain([Node::Pulse]);
        let written = written.map(|node| (node, DataValue::new_now(zero(node)))).collect();
        Self { controller, image: None, cycles_count: 0, written }
    }

    /// The image of this cycle, and its counter: even, since nobody reads while it is made.
    fn image(&mut self, now: Duration) -> (&Reading, u32) {
        let fresh = self.image.take().filter(|image| now.saturating_sub(image.at) < CYCLE);
        if fresh.is_none() {
            self.cycles_count = self.cycles_count.wrapping_add(2);
        }
        let image = fresh.unwrap_or_else(|| Image { at: now, reading: self.controller.reading(now) });
        (&self.image.insert(image).reading, self.cycles_count)
    }
}

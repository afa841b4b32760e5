//! A [`Reading`] as the registers of the status block: what a simulated device shows. Pure.

use super::layout::Layout;
use crate::device::manipulator::{AxisReading, Reading};
use crate::motion::{Axes, Axis};

/// What a device shows besides its state.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Extras {
    /// Our heartbeat, as it came.
    pub(super) heartbeat_echo: u16,
    /// Since it started.
    pub(super) uptime_ms: u32,
    /// Counts the images.
    pub(super) snapshot: u16,
}

/// The registers; what they cannot carry is 0, and a state without a number shows as a fault.
pub(super) fn status_image(layout: &Layout, reading: &Reading, extras: Extras) -> Vec<u16> {
    let map = &layout.status;
    let mut image = Image { layout, registers: vec![0; usize::from(map.count)] };
    image.optional(map.magic, map.magic_value);
    image.put(map.heartbeat, reading.heartbeat);
    image.optional(map.heartbeat_echo, extras.heartbeat_echo);
    image.put(map.mode, layout.codes.modes.code(reading.mode));
    image.put(map.safety, image.safety(reading));
    image.put(map.state, image.state(reading.state));
    image.put(map.sequence, reading.acknowledged.sequence);
    image.put(map.result, layout.codes.results.code(reading.acknowledged.result));
    image.double(map.fault_code, reading.fault_code);
    image.put(map.axis_flags, image.axis_flags(&reading.axes));
    for (axis, reading) in reading.axes.iter() {
        image.axis(axis, reading);
    }
    if let Some(at) = map.uptime {
        image.double(at, extras.uptime_ms);
    }
    image.optional(map.snapshot, extras.snapshot);
    image.optional(map.snapshot_copy, extras.snapshot);
    image.registers
}

struct Image<'a> {
    layout: &'a Layout,
    registers: Vec<u16>,
}

impl Image<'_> {
    fn axis(&mut self, axis: Axis, reading: &AxisReading) {
        let map = &self.layout.status;
        self.put(*map.axis_states.get(axis), self.state(reading.state));
        let numbers = [
            (map.actual, reading.actual),
            (map.commanded, reading.commanded),
            (map.lower, reading.lower),
            (map.upper, reading.upper),
            (map.speed, reading.speed),
        ];
        for (places, value) in numbers {
            self.double(*places.get(axis), self.layout.numbers.bits(axis, axis.outside(value)).unwrap_or(0));
        }
    }

    fn state(&self, state: crate::device::manipulator::AxisState) -> u16 {
        self.layout.codes.states.codes().code(state)
    }

    fn safety(&self, reading: &Reading) -> u16 {
        let (bits, safety) = (self.layout.status.safety_bits, reading.safety);
        flag(safety.emergency_stop_ok, bits.emergency_stop_ok)
            | flag(safety.guard_closed, bits.guard_closed)
            | flag(safety.drives_ready, bits.drives_ready)
            | flag(safety.remote_enabled, bits.remote_enabled)
    }

    fn axis_flags(&self, axes: &Axes<AxisReading>) -> u16 {
        let bits = self.layout.status.axis_bits;
        axes.iter().fold(0, |word, (axis, reading)| {
            word | flag(reading.homed, *bits.homed.get(axis))
                | flag(reading.in_position, *bits.in_position.get(axis))
                | flag(reading.fault, *bits.fault.get(axis))
                | flag(reading.limit_hit, *bits.limit_hit.get(axis))
        })
    }

    fn optional(&mut self, at: Option<u16>, word: u16) {
        if let Some(at) = at {
            self.put(at, word);
        }
    }

    fn double(&mut self, at: u16, bits: u32) {
        let [first, second] = self.layout.word_order.registers(bits);
        self.put(at, first);
        self.put(at.saturating_add(1), second);
    }

    fn put(&mut self, at: u16, word: u16) {
        if let Some(register) = self.registers.get_mut(usize::from(at)) {
            *register = word;
        }
    }
}

fn flag(set: bool, bit: u8) -> u16 {
    u16::from(set).checked_shl(u32::from(bit)).unwrap_or(0)
}

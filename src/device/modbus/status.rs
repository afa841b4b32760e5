//! The registers of the status block as a [`Reading`], and back for the simulated device. Everything is checked: codes are in
//! their tables, numbers are finite, limits and speeds can be true. Radians inside, degrees on the wire. Pure.

use super::error::MapError;
use super::layout::{Layout, StatusMap};
use crate::device::{Acknowledged, AxisReading, AxisState, Mode, Reading, Safety};
use crate::motion::{Axes, Axis};

/// Beyond this no axis of this world is: mm, degrees. Positions may be many turns.
const POSITION_MAX: f64 = 1e6;
/// What a limit or a speed can be, in mm or degrees (and those per second), where it is not zero. In a wrong word order
/// numbers become tiny or huge, which this notices.
const LIMIT_RANGE: std::ops::RangeInclusive<f64> = 1e-3..=1e5;

/// What holds for the whole device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Head {
    pub(super) state: AxisState,
    pub(super) mode: Mode,
    pub(super) safety: Safety,
    pub(super) acknowledged: Acknowledged,
    pub(super) fault_code: u32,
    pub(super) heartbeat: u16,
}

/// A status block as it was read.
#[derive(Debug, Clone, Copy)]
pub(super) struct StatusRegisters<'a> {
    pub(super) layout: &'a Layout,
    pub(super) registers: &'a [u16],
}

impl StatusRegisters<'_> {
    /// The whole state.
    pub(super) fn reading(self) -> Result<Reading, MapError> {
        let head = self.head()?;
        let axes =
            Axes { x: self.axis(Axis::X)?, y: self.axis(Axis::Y)?, z: self.axis(Axis::Z)?, c: self.axis(Axis::C)? };
        let Head { state, mode, safety, acknowledged, fault_code, heartbeat } = head;
        Ok(Reading { state, mode, safety, acknowledged, fault_code, heartbeat, axes })
    }

    /// What holds for the whole device; looks first whether the block is whole and of this map.
    pub(super) fn head(self) -> Result<Head, MapError> {
        let map = &self.layout.status;
        self.whole(map)?;
        let codes = &self.layout.codes;
        let mode = self.word(map.mode)?;
        let result = self.word(map.result)?;
        Ok(Head {
            state: self.state("state", map.state)?,
            mode: codes.modes.mode(mode).ok_or(MapError::Code { what: "mode", code: mode })?,
            safety: self.safety(map)?,
            acknowledged: Acknowledged {
                sequence: self.word(map.sequence)?,
                result: codes.results.result(result).ok_or(MapError::Code { what: "result", code: result })?,
            },
            fault_code: self.double(map.fault_code)?,
            heartbeat: self.word(map.heartbeat)?,
        })
    }

    fn whole(self, map: &StatusMap) -> Result<(), MapError> {
        if let Some(at) = map.magic {
            let found = self.word(at)?;
            if found != map.magic_value {
                return Err(MapError::Magic { found, expected: map.magic_value });
            }
        }
        if let (Some(at), Some(copy)) = (map.snapshot, map.snapshot_copy) {
            let (first, second) = (self.word(at)?, self.word(copy)?);
            if first != second {
                return Err(MapError::Torn { first, second });
            }
        }
        Ok(())
    }

    fn safety(self, map: &StatusMap) -> Result<Safety, MapError> {
        let word = self.word(map.safety)?;
        let bits = map.safety_bits;
        Ok(Safety {
            emergency_stop_ok: is_set(word, bits.emergency_stop_ok),
            guard_closed: is_set(word, bits.guard_closed),
            drives_ready: is_set(word, bits.drives_ready),
            remote_enabled: is_set(word, bits.remote_enabled),
        })
    }

    /// One axis.
    pub(super) fn axis(self, axis: Axis) -> Result<AxisReading, MapError> {
        let map = &self.layout.status;
        let (lower, upper) = (self.limit(axis, "lower limit", map.lower)?, self.limit(axis, "upper limit", map.upper)?);
        if lower >= upper {
            return Err(MapError::Limits { axis, lower, upper });
        }
        let speed = self.limit(axis, "greatest speed", map.speed)?;
        if speed <= 0.0 {
            return Err(MapError::Value { axis, what: "greatest speed", value: speed });
        }
        let flags = self.word(map.axis_flags)?;
        let flag = |bits: Axes<u8>| is_set(flags, *bits.get(axis));
        Ok(AxisReading {
            actual: axis.inside(self.position(axis, "position", map.actual)?),
            commanded: axis.inside(self.position(axis, "commanded position", map.commanded)?),
            lower: axis.inside(lower),
            upper: axis.inside(upper),
            speed: axis.inside(speed),
            state: self.state("axis state", *map.axis_states.get(axis))?,
            homed: flag(map.axis_bits.homed),
            in_position: flag(map.axis_bits.in_position),
            fault: flag(map.axis_bits.fault),
            limit_hit: flag(map.axis_bits.limit_hit),
        })
    }

    fn state(self, what: &'static str, at: u16) -> Result<AxisState, MapError> {
        let code = self.word(at)?;
        self.layout.codes.states.codes().state(code).ok_or(MapError::Code { what, code })
    }

    fn position(self, axis: Axis, what: &'static str, places: Axes<u16>) -> Result<f64, MapError> {
        let value = self.number(axis, places)?;
        if value.abs() <= POSITION_MAX { Ok(value) } else { Err(MapError::Value { axis, what, value }) }
    }

    fn limit(self, axis: Axis, what: &'static str, places: Axes<u16>) -> Result<f64, MapError> {
        let value = self.number(axis, places)?;
        let can_be = value == 0.0 || LIMIT_RANGE.contains(&value.abs());
        if can_be { Ok(value) } else { Err(MapError::Value { axis, what, value }) }
    }

    fn number(self, axis: Axis, places: Axes<u16>) -> Result<f64, MapError> {
        Ok(self.layout.numbers.value(axis, self.double(*places.get(axis))?))
    }

    fn double(self, at: u16) -> Result<u32, MapError> {
        Ok(self.layout.word_order.bits([self.word(at)?, self.word(at.saturating_add(1))?]))
    }

    fn word(self, at: u16) -> Result<u16, MapError> {
        self.registers.get(usize::from(at)).copied().ok_or(MapError::Missing { at })
    }
}

pub(super) fn is_set(word: u16, bit: u8) -> bool {
    word.checked_shr(u32::from(bit)).is_some_and(|rest| rest & 1 == 1)
}

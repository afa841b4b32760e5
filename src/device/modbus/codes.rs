//! The numbers that a device gives to states, modes, results and commands: tables, because every maker has his own.
//! Must not know where they stand.

use super::error::LayoutError;
use crate::device::{AxisState, CommandResult, Mode};
use serde::{Deserialize, Serialize};

/// All tables of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Codes {
    /// Of the device's state, and of each axis.
    pub states: States,
    /// Of who commands.
    pub modes: ModeCodes,
    /// Of what became of a command.
    pub results: ResultCodes,
    /// Of commands.
    pub commands: CommandCodes,
}

/// A known maker's table, or one's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum States {
    /// By name.
    Preset(StatePreset),
    /// Number by number.
    Table(StateCodes),
}

impl Default for States {
    fn default() -> Self {
        Self::Preset(StatePreset::Beckhoff)
    }
}

/// Makers whose numbers are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StatePreset {
    /// TwinCAT, Tc2_MC2.
    Beckhoff,
    /// Micro800.
    Rockwell,
    /// SoftMotion SM3.
    Codesys,
}

/// The number of each state of PLCopen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "named as the states are")]
pub struct StateCodes {
    pub disabled: u16,
    pub standstill: u16,
    pub homing: u16,
    pub discrete_motion: u16,
    pub continuous_motion: u16,
    /// Not every maker has it.
    pub synchronized_motion: Option<u16>,
    pub stopping: u16,
    pub error_stop: u16,
}

impl States {
    /// The table.
    #[must_use]
    pub const fn codes(self) -> StateCodes {
        match self {
            Self::Table(codes) => codes,
            // 0 is "undefined", which is no state that could be trusted.
            Self::Preset(StatePreset::Beckhoff) => StateCodes {
                disabled: 1,
                standstill: 2,
                homing: 5,
                discrete_motion: 6,
                continuous_motion: 7,
                synchronized_motion: Some(8),
                stopping: 4,
                error_stop: 3,
            },
            Self::Preset(StatePreset::Rockwell) => StateCodes {
                disabled: 0,
                standstill: 1,
                homing: 4,
                discrete_motion: 2,
                continuous_motion: 3,
                synchronized_motion: None,
                stopping: 6,
                error_stop: 7,
            },
            Self::Preset(StatePreset::Codesys) => StateCodes {
                disabled: 0,
                standstill: 3,
                homing: 7,
                discrete_motion: 4,
                continuous_motion: 5,
                synchronized_motion: Some(6),
                stopping: 2,
                error_stop: 1,
            },
        }
    }
}

impl StateCodes {
    const fn pairs(self) -> [(&'static str, AxisState, Option<u16>); 8] {
        [
            ("disabled", AxisState::Disabled, Some(self.disabled)),
            ("standstill", AxisState::Standstill, Some(self.standstill)),
            ("homing", AxisState::Homing, Some(self.homing)),
            ("discrete_motion", AxisState::DiscreteMotion, Some(self.discrete_motion)),
            ("continuous_motion", AxisState::ContinuousMotion, Some(self.continuous_motion)),
            ("synchronized_motion", AxisState::SynchronizedMotion, self.synchronized_motion),
            ("stopping", AxisState::Stopping, Some(self.stopping)),
            ("error_stop", AxisState::ErrorStop, Some(self.error_stop)),
        ]
    }

    /// The state of a number.
    #[must_use]
    pub fn state(self, code: u16) -> Option<AxisState> {
        self.pairs().into_iter().find(|(_, _, known)| *known == Some(code)).map(|(_, state, _)| state)
    }

    /// The number of a state; none where the maker has none.
    #[must_use]
    pub fn code(self, state: AxisState) -> Option<u16> {
        self.pairs().into_iter().find(|(_, known, _)| *known == state).and_then(|(_, _, code)| code)
    }
}

/// The number of each mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(missing_docs, reason = "named as the modes are")]
pub struct ModeCodes {
    pub off: u16,
    pub manual: u16,
    pub automatic: u16,
}

impl Default for ModeCodes {
    fn default() -> Self {
        Self { off: 0, manual: 1, automatic: 2 }
    }
}

impl ModeCodes {
    const fn pairs(self) -> [(&'static str, Mode, u16); 3] {
        [
            ("off", Mode::Off, self.off),
            ("manual", Mode::Manual, self.manual),
            ("automatic", Mode::Automatic, self.automatic),
        ]
    }

    /// The mode of a number.
    #[must_use]
    pub fn mode(self, code: u16) -> Option<Mode> {
        found(self.pairs(), code)
    }

    /// The number of a mode.
    #[must_use]
    pub const fn code(self, mode: Mode) -> u16 {
        match mode {
            Mode::Off => self.off,
            Mode::Manual => self.manual,
            Mode::Automatic => self.automatic,
        }
    }
}

/// The number of each result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(missing_docs, reason = "named as the results are")]
pub struct ResultCodes {
    pub none: u16,
    pub accepted: u16,
    pub running: u16,
    pub done: u16,
    pub rejected: u16,
    pub aborted: u16,
}

impl Default for ResultCodes {
    fn default() -> Self {
        Self { none: 0, accepted: 1, running: 2, done: 3, rejected: 4, aborted: 5 }
    }
}

impl ResultCodes {
    const fn pairs(self) -> [(&'static str, CommandResult, u16); 6] {
        [
            ("none", CommandResult::None, self.none),
            ("accepted", CommandResult::Accepted, self.accepted),
            ("running", CommandResult::Running, self.running),
            ("done", CommandResult::Done, self.done),
            ("rejected", CommandResult::Rejected, self.rejected),
            ("aborted", CommandResult::Aborted, self.aborted),
        ]
    }

    /// The result of a number.
    #[must_use]
    pub fn result(self, code: u16) -> Option<CommandResult> {
        found(self.pairs(), code)
    }

    /// The number of a result.
    #[must_use]
    pub const fn code(self, result: CommandResult) -> u16 {
        match result {
            CommandResult::None => self.none,
            CommandResult::Accepted => self.accepted,
            CommandResult::Running => self.running,
            CommandResult::Done => self.done,
            CommandResult::Rejected => self.rejected,
            CommandResult::Aborted => self.aborted,
        }
    }
}

/// The number of each command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(missing_docs, reason = "named as the commands are")]
pub struct CommandCodes {
    pub enable: u16,
    pub disable: u16,
    pub reset: u16,
    pub home: u16,
    pub move_to: u16,
    pub halt: u16,
}

impl Default for CommandCodes {
    fn default() -> Self {
        Self { enable: 1, disable: 2, reset: 3, home: 4, move_to: 5, halt: 6 }
    }
}

impl CommandCodes {
    const fn pairs(self) -> [(&'static str, (), u16); 6] {
        [
            ("enable", (), self.enable),
            ("disable", (), self.disable),
            ("reset", (), self.reset),
            ("home", (), self.home),
            ("move_to", (), self.move_to),
            ("halt", (), self.halt),
        ]
    }
}

impl Codes {
    /// # Errors
    /// [`LayoutError::SameCode`] where a number means two things.
    pub(super) fn check(&self) -> Result<(), LayoutError> {
        let states = self.states.codes().pairs();
        different("codes.states", states.into_iter().filter_map(|(name, _, code)| Some((name, code?))))?;
        different("codes.modes", self.modes.pairs().into_iter().map(|(name, _, code)| (name, code)))?;
        different("codes.results", self.results.pairs().into_iter().map(|(name, _, code)| (name, code)))?;
        different("codes.commands", self.commands.pairs().into_iter().map(|(name, (), code)| (name, code)))
    }
}

fn found<T, const N: usize>(pairs: [(&'static str, T, u16); N], code: u16) -> Option<T> {
    pairs.into_iter().find(|(_, _, known)| *known == code).map(|(_, word, _)| word)
}

fn different(table: &'static str, codes: impl Iterator<Item = (&'static str, u16)>) -> Result<(), LayoutError> {
    let mut seen: Vec<(&'static str, u16)> = Vec::new();
    for (second, code) in codes {
        if let Some((first, _)) = seen.iter().find(|(_, known)| *known == code) {
            return Err(LayoutError::SameCode { table, first, second, code });
        }
        seen.push((second, code));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tc2_MC2 MC_AXISSTATE, Micro800 AXIS_REF.AxisState and SM3 SMC_AXIS_STATE, as their manuals number them.
    #[test]
    fn the_makers_tables_are_theirs() {
        let state = |preset, code| States::Preset(preset).codes().state(code);
        assert_eq!(state(StatePreset::Beckhoff, 3), Some(AxisState::ErrorStop));
        assert_eq!(state(StatePreset::Beckhoff, 2), Some(AxisState::Standstill));
        assert_eq!(state(StatePreset::Rockwell, 2), Some(AxisState::DiscreteMotion));
        assert_eq!(state(StatePreset::Rockwell, 7), Some(AxisState::ErrorStop));
        assert_eq!(state(StatePreset::Codesys, 1), Some(AxisState::ErrorStop));
        assert_eq!(state(StatePreset::Codesys, 7), Some(AxisState::Homing));
    }

    #[test]
    fn an_undefined_axis_is_no_state() {
        assert_eq!(States::default().codes().state(0), None);
        assert_eq!(States::Preset(StatePreset::Rockwell).codes().state(5), None);
    }

    #[test]
    fn a_number_that_means_two_things_is_refused() {
        let mut codes = Codes::default();
        assert_eq!(codes.check(), Ok(()));
        codes.commands.halt = 5;
        let same = LayoutError::SameCode { table: "codes.commands", first: "move_to", second: "halt", code: 5 };
        assert_eq!(codes.check(), Err(same));
    }
}

//! The numbers that a device uses for modes, results and commands. They are tables, as those of the states, because they differ
//! between manufacturers.

use super::error::LayoutError;
use crate::device::manipulator::{CommandResult, Mode};
use crate::device::states::States;
use crate::device::states::different;
use serde::{Deserialize, Serialize};

/// All code tables of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Codes {
    /// The numbers of the states of the device and of each axis.
    pub states: States,
    /// The numbers of the modes.
    pub modes: ModeCodes,
    /// The numbers of the results of commands.
    pub results: ResultCodes,
    /// The numbers of the commands.
    pub commands: CommandCodes,
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

    /// The mode with this number.
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

    /// The result with this number.
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
    const fn pairs(self) -> [(&'static str, u16); 6] {
        [
            ("enable", self.enable),
            ("disable", self.disable),
            ("reset", self.reset),
            ("home", self.home),
            ("move_to", self.move_to),
            ("halt", self.halt),
        ]
    }
}

impl Codes {
    /// # Errors
    /// [`LayoutError::SameCode`] if a number has two meanings.
    pub(super) fn check(&self) -> Result<(), LayoutError> {
        let table = |table: &'static str| move |cause| LayoutError::SameCode { table, cause };
        self.states.check().map_err(table("codes.states"))?;
        different(self.modes.pairs().map(|(name, _, code)| (name, code))).map_err(table("codes.modes"))?;
        different(self.results.pairs().map(|(name, _, code)| (name, code))).map_err(table("codes.results"))?;
        different(self.commands.pairs()).map_err(table("codes.commands"))
    }
}

fn found<T, const N: usize>(pairs: [(&'static str, T, u16); N], code: u16) -> Option<T> {
    pairs.into_iter().find(|(_, _, known)| *known == code).map(|(_, word, _)| word)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_with_two_meanings_is_refused() {
        let mut codes = Codes::default();
        assert_eq!(codes.check(), Ok(()));
        codes.commands.halt = 5;
        let said = codes.check().expect_err("refused").to_string();
        assert_eq!(said, "codes.commands: move_to and halt are both 5");
    }
}

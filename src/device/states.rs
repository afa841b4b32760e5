//! The numbers of the PLCopen states in a PLC: the table of a known manufacturer, or a custom one. Every adaptor of a PLC uses it.

use super::manipulator::AxisState;
use serde::{Deserialize, Serialize};

/// The table of a known manufacturer, or a custom one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "states must be \"beckhoff\", \"rockwell\", \"codesys\", or a table with the number of each state: disabled, standstill, homing, discrete_motion, continuous_motion, stopping, error_stop, and synchronized_motion where there is one"
)]
pub enum States {
    /// A preset, by its name.
    Preset(StatePreset),
    /// A custom table with a number for each state.
    Table(StateCodes),
}

impl Default for States {
    fn default() -> Self {
        Self::Preset(StatePreset::Beckhoff)
    }
}

/// Manufacturers whose numbers are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StatePreset {
    /// TwinCAT, Tc2_MC2; according to the manufacturer's documentation.
    Beckhoff,
    /// Micro800; according to the manufacturer's documentation.
    Rockwell,
    /// SoftMotion SM3; not verified against its documentation.
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
    /// Not every manufacturer has this state.
    pub synchronized_motion: Option<u16>,
    pub stopping: u16,
    pub error_stop: u16,
}

/// Two states have the same number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{first} and {second} are both {code}")]
pub struct SameCode {
    /// The first state.
    pub first: &'static str,
    /// The second state.
    pub second: &'static str,
    /// Their common number.
    pub code: u16,
}

/// Checks that each state of a table has a number of its own.
pub(super) fn different(codes: impl IntoIterator<Item = (&'static str, u16)>) -> Result<(), SameCode> {
    let mut seen: Vec<(&'static str, u16)> = Vec::new();
    for (second, code) in codes {
        if let Some((first, _)) = seen.iter().find(|(_, known)| *known == code) {
            return Err(SameCode { first, second, code });
        }
        seen.push((second, code));
    }
    Ok(())
}

impl States {
    /// The table of numbers.
    #[must_use]
    pub const fn codes(self) -> StateCodes {
        match self {
            Self::Table(codes) => codes,
            // 0 means "undefined", which is not a state to rely on.
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

    /// # Errors
    /// [`SameCode`] if a number means two states.
    pub(super) fn check(self) -> Result<(), SameCode> {
        different(self.codes().pairs().into_iter().filter_map(|(name, _, code)| Some((name, code?))))
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

    /// The state with this number.
    #[must_use]
    pub fn state(self, code: u16) -> Option<AxisState> {
        self.pairs().into_iter().find(|(_, _, known)| *known == Some(code)).map(|(_, state, _)| state)
    }

    /// The number of a state; that of error stop if the manufacturer has none for it.
    #[must_use]
    pub fn code(self, state: AxisState) -> u16 {
        let code = self.pairs().into_iter().find(|(_, known, _)| *known == state).and_then(|(_, _, code)| code);
        code.unwrap_or(self.error_stop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    struct Document {
        states: States,
    }

    /// Tc2_MC2 MC_AXISSTATE and Micro800 axis states are numbered as in the manufacturers' documentation; SM3 SMC_AXIS_STATE is not
    /// verified.
    #[test]
    fn the_preset_tables_match_the_documentation() {
        let state = |preset, code| States::Preset(preset).codes().state(code);
        assert_eq!(state(StatePreset::Beckhoff, 3), Some(AxisState::ErrorStop));
        assert_eq!(state(StatePreset::Beckhoff, 2), Some(AxisState::Standstill));
        assert_eq!(state(StatePreset::Rockwell, 2), Some(AxisState::DiscreteMotion));
        assert_eq!(state(StatePreset::Rockwell, 7), Some(AxisState::ErrorStop));
        assert_eq!(state(StatePreset::Codesys, 1), Some(AxisState::ErrorStop));
        assert_eq!(state(StatePreset::Codesys, 7), Some(AxisState::Homing));
    }

    #[test]
    fn an_undefined_axis_state_is_refused() {
        assert_eq!(States::default().codes().state(0), None);
        assert_eq!(States::Preset(StatePreset::Rockwell).codes().state(5), None);
    }

    #[test]
    fn a_table_with_one_number_for_two_states_is_refused() {
        for preset in [StatePreset::Beckhoff, StatePreset::Rockwell, StatePreset::Codesys] {
            assert_eq!(States::Preset(preset).check(), Ok(()), "{preset:?}");
        }
        let twice = States::Table(StateCodes { synchronized_motion: Some(2), ..States::default().codes() });
        let said = twice.check().expect_err("refused").to_string();
        assert_eq!(said, "standstill and synchronized_motion are both 2");
    }

    #[test]
    fn a_preset_or_a_complete_table_is_accepted_and_other_values_are_refused() {
        let read = |text: &str| toml::from_str::<Document>(text).map(|document| document.states);
        assert_eq!(read("states = 'codesys'"), Ok(States::Preset(StatePreset::Codesys)));
        let table =
            "disabled = 1\nstandstill = 2\nhoming = 3\ndiscrete_motion = 4\ncontinuous_motion = 5\nstopping = 6\n";
        let own = read(&format!("[states]\n{table}error_stop = 7")).expect("a table");
        assert_eq!(own.codes().state(7), Some(AxisState::ErrorStop));
        for wrong in ["states = 'beckhof'".to_owned(), format!("[states]\n{table}"), "states = 3".to_owned()] {
            let said = read(&wrong).expect_err("refused").to_string();
            assert!(said.contains("\"rockwell\"") && said.contains("error_stop"), "{said}");
        }
    }
}

//! What a made manipulator was told: each command that it executed, each that it ignored, and every target that it should never
//! have been sent. For tests and campaigns.

use crate::device::manipulator::{Action, Command};
use std::collections::VecDeque;
use std::time::Duration;

/// Entries kept of each kind; the oldest go first.
const KEPT_MAX: usize = 4096;

/// A command that was executed.
#[derive(Debug, Clone, PartialEq)]
pub struct Executed {
    /// Its sequence number.
    pub sequence: u16,
    /// What was done.
    pub action: Action,
    /// When, by the caller's clock.
    pub at: Duration,
}

/// What a controller was told.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Record {
    executed: VecDeque<Executed>,
    ignored: VecDeque<u16>,
    out_of_limits: VecDeque<Command>,
}

impl Record {
    /// Commands that were executed, in order.
    pub fn all_executed(&self) -> impl ExactSizeIterator<Item = &Executed> {
        self.executed.iter()
    }

    /// Sequence numbers that came again or too late, and were ignored, in order.
    pub fn all_ignored(&self) -> impl ExactSizeIterator<Item = u16> {
        self.ignored.iter().copied()
    }

    /// Commands with a target or a speed outside of the limits, which were refused. Whoever checks before sending leaves
    /// this empty.
    pub fn all_out_of_limits(&self) -> impl ExactSizeIterator<Item = &Command> {
        self.out_of_limits.iter()
    }

    pub(super) fn executed(&mut self, command: &Command, at: Duration) {
        let entry = Executed { sequence: command.sequence, action: command.action.clone(), at };
        keep(&mut self.executed, entry);
    }

    pub(super) fn ignored(&mut self, sequence: u16) {
        keep(&mut self.ignored, sequence);
    }

    pub(super) fn out_of_limits(&mut self, command: &Command) {
        keep(&mut self.out_of_limits, command.clone());
    }
}

fn keep<T>(kept: &mut VecDeque<T>, entry: T) {
    if kept.len() == KEPT_MAX {
        kept.pop_front();
    }
    kept.push_back(entry);
}

//! What has happened, numbered without a gap, the newest 1024 kept; readable from any number on, and waited for by a watch.

use super::failure::{Fault, StopCause};
use super::job::JobEnd;
use super::state::State;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use tokio::time::Instant;

/// How many events are kept.
pub const EVENTS_KEPT: usize = 1024;

/// Something that has happened.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// 1 for the first since the start of the cell; without gaps.
    pub number: u64,
    /// When.
    pub at: Instant,
    /// What.
    pub kind: EventKind,
}

/// What can happen.
#[derive(Debug, Clone, PartialEq)]
pub enum EventKind {
    /// The cell is busy with another command now.
    StateChanged {
        /// What it did.
        from: State,
        /// What it does.
        to: State,
    },
    /// A device's link is up; it was read, and nothing was sent.
    LinkUp {
        /// The device's name in the configuration.
        device: String,
    },
    /// A device's link is lost, or its answer cannot be used.
    LinkLost {
        /// The device's name in the configuration.
        device: String,
        /// What the link said.
        cause: String,
    },
    /// Somebody has the lease now.
    LeaseTaken {
        /// Who.
        holder: String,
        /// Its fence.
        fence: u64,
    },
    /// The lease has ended.
    LeaseEnded {
        /// Who held it.
        holder: String,
        /// Its fence.
        fence: u64,
        /// It ran out; else it was given back.
        ran_out: bool,
    },
    /// A move or a scan has begun.
    JobStarted {
        /// Its id.
        job: String,
    },
    /// A move or a scan has ended.
    JobEnded {
        /// Its id.
        job: String,
        /// How.
        end: JobEnd,
    },
    /// Every device was told to stop.
    Stopping {
        /// What asked for it; none where what was under way could not go on, or something was found moving.
        cause: Option<StopCause>,
    },
    /// A fault is latched.
    Faulted(Fault),
    /// After a reconnect, the device says what became of the command whose answer was lost.
    Resolved {
        /// The device's name in the configuration.
        device: String,
        /// Sequence number of the command.
        sequence: u16,
        /// It had taken it; else it never will.
        taken: bool,
    },
    /// A manual command was done: enabled, disabled, homed.
    ManualDone {
        /// The device's name in the configuration.
        device: String,
        /// Its verb.
        verb: &'static str,
    },
    /// A manual command was not taken, or a halt came before its word.
    ManualRefused {
        /// The device's name in the configuration.
        device: String,
        /// Its verb.
        verb: &'static str,
        /// Why.
        cause: String,
    },
    /// The faults were acknowledged and every device read.
    Reset,
    /// The cell was shut down.
    Closed,
}

/// Events from a number on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Events {
    /// In order.
    pub events: Vec<Event>,
    /// How many that were asked for are not kept any more.
    pub missed: u64,
}

/// The ring.
#[derive(Debug)]
pub(super) struct EventLog {
    kept: Mutex<VecDeque<Event>>,
    newest: watch::Sender<u64>,
}

impl EventLog {
    /// Empty.
    pub(super) fn new() -> Self {
        Self { kept: Mutex::new(VecDeque::with_capacity(EVENTS_KEPT)), newest: watch::Sender::new(0) }
    }

    /// Adds one.
    pub(super) fn add(&self, at: Instant, kind: EventKind) {
        let mut kept = self.kept();
        let number = kept.back().map_or(0, |event| event.number) + 1;
        if kept.len() == EVENTS_KEPT {
            kept.pop_front();
        }
        kept.push_back(Event { number, at, kind });
        // Published under the same lock: a reader that saw a later number first would take this one for new, again and again.
        self.newest.send_replace(number);
    }

    /// Those whose number is greater than `after`.
    pub(super) fn after(&self, after: u64) -> Events {
        let kept = self.kept();
        let Some(first) = kept.front().map(|event| event.number) else { return Events::default() };
        let missed = first.saturating_sub(after.saturating_add(1));
        Events { events: kept.iter().filter(|event| event.number > after).cloned().collect(), missed }
    }

    /// The number of the newest; changes with every event.
    pub(super) fn newest(&self) -> watch::Receiver<u64> {
        self.newest.subscribe()
    }

    fn kept(&self) -> MutexGuard<'_, VecDeque<Event>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

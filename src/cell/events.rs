//! The events of the cell, numbered without gaps. The newest 1024 are kept; they can be read from any number on, and a watch
//! channel reports each new one.

use super::failure::{Fault, JobEnd, StopCause};
use super::state::State;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use tokio::time::Instant;

/// How many events are kept.
pub const EVENTS_KEPT: usize = 1024;

/// An event.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// 1 for the first since the start of the cell; without gaps.
    pub number: u64,
    /// When it happened.
    pub at: Instant,
    /// What happened.
    pub kind: EventKind,
}

/// The kinds of events.
#[derive(Debug, Clone, PartialEq)]
pub enum EventKind {
    /// The state of the cell has changed.
    StateChanged {
        /// The state before.
        from: State,
        /// The new state.
        to: State,
    },
    /// The link to a device is up; the device was read, and nothing was sent.
    LinkUp {
        /// The device's name in the configuration.
        device: String,
    },
    /// The link to a device is lost, or its answer cannot be used.
    LinkLost {
        /// The device's name in the configuration.
        device: String,
        /// The error of the link.
        cause: String,
    },
    /// A client has taken the lease.
    LeaseTaken {
        /// Its holder.
        holder: String,
        /// Its fencing token.
        fence: u64,
    },
    /// The lease has ended.
    LeaseEnded {
        /// Its holder.
        holder: String,
        /// Its fencing token.
        fence: u64,
        /// It expired; otherwise it was released.
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
        /// How it ended.
        end: JobEnd,
    },
    /// A halt was sent to every device.
    Stopping {
        /// What caused it; none if the activity could not go on, or a device was found moving.
        cause: Option<StopCause>,
    },
    /// A fault is latched.
    Faulted(Fault),
    /// After a reconnect, the device reports whether it had taken the command whose answer was lost.
    Resolved {
        /// The device's name in the configuration.
        device: String,
        /// Sequence number of the command.
        sequence: u16,
        /// The device had taken it; otherwise it never will.
        taken: bool,
    },
    /// A manual command was done: enabled, disabled, homed.
    ManualDone {
        /// The device's name in the configuration.
        device: String,
        /// Its verb.
        verb: &'static str,
    },
    /// A manual command was refused, or a halt came before its acknowledgement.
    ManualRefused {
        /// The device's name in the configuration.
        device: String,
        /// Its verb.
        verb: &'static str,
        /// The reason.
        cause: String,
    },
    /// The faults were acknowledged, and every device was read.
    Reset,
    /// The cell was shut down.
    Closed,
}

/// The events after a number.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Events {
    /// In the order of their numbers.
    pub events: Vec<Event>,
    /// How many of the requested events are not kept any more.
    pub missed: u64,
}

/// Keeps the newest events.
#[derive(Debug)]
pub(super) struct EventLog {
    kept: Mutex<VecDeque<Event>>,
    newest: watch::Sender<u64>,
}

impl EventLog {
    /// Without events.
    pub(super) fn new() -> Self {
        Self { kept: Mutex::new(VecDeque::with_capacity(EVENTS_KEPT)), newest: watch::Sender::new(0) }
    }

    /// Adds an event.
    pub(super) fn add(&self, at: Instant, kind: EventKind) {
        let mut kept = self.kept();
        let number = kept.back().map_or(0, |event| event.number) + 1;
        if kept.len() == EVENTS_KEPT {
            kept.pop_front();
        }
        kept.push_back(Event { number, at, kind });
        // Published under the same lock: a reader that saw a later number first would take this event for new repeatedly.
        self.newest.send_replace(number);
    }

    /// Returns the events after number `after`.
    pub(super) fn after(&self, after: u64) -> Events {
        let kept = self.kept();
        let Some(first) = kept.front().map(|event| event.number) else { return Events::default() };
        let missed = first.saturating_sub(after.saturating_add(1));
        Events { events: kept.iter().filter(|event| event.number > after).cloned().collect(), missed }
    }

    /// The number of the newest event; changes with every event.
    pub(super) fn newest(&self) -> watch::Receiver<u64> {
        self.newest.subscribe()
    }

    fn kept(&self) -> MutexGuard<'_, VecDeque<Event>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

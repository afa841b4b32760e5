//! The events of the cell, numbered without gaps. The newest 1024 are kept; a client can read them from any number on, and a watch
//! channel reports each new one.

use super::failure::{Fault, JobEnd, StopCause};
use super::state::State;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use tokio::time::Instant;

/// Number of events that are kept.
pub const EVENTS_KEPT: usize = 1024;

/// An event.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// Sequence number without gaps; 1 is the first event since the start of the cell.
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
        /// True if it expired, false if it was released.
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
        /// Its cause; `None` if the activity failed, or a device was found moving.
        cause: Option<StopCause>,
    },
    /// A fault is latched.
    Faulted(Fault),
    /// After a reconnect, the device has reported whether it had accepted the command whose answer was lost.
    Resolved {
        /// The device's name in the configuration.
        device: String,
        /// Sequence number of the command.
        sequence: u16,
        /// True if the device had accepted it; otherwise the command is lost for good.
        taken: bool,
    },
    /// A manual command (enable, disable, home) was executed.
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
    /// The events in ascending order of their numbers.
    pub events: Vec<Event>,
    /// Number of the requested events that are no longer kept.
    pub missed: u64,
}

/// The log that keeps the newest events.
#[derive(Debug)]
pub(super) struct EventLog {
    kept: Mutex<VecDeque<Event>>,
    newest: watch::Sender<u64>,
}

impl EventLog {
    /// An empty log.
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
        // Published under the same lock, because a reader that saw a later number first would repeatedly treat this event as new.
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

//! Events for clients: the cell's events, the progress of jobs and the ends of measurements in one numbered list, of which the
//! newest are kept. Times are wall-clock times.

use super::measuring::record::Verdict;
use crate::cell::EventKind;
use jiff::Timestamp;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// How many events are kept.
pub(in crate::service) const EVENTS_KEPT: usize = 1024;

/// An event.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// 1 for the first of this instance; without gaps.
    pub number: u64,
    /// Wall-clock time.
    pub at: Timestamp,
    /// What happened.
    pub what: Happening,
}

/// Kinds of events.
#[derive(Debug, Clone, PartialEq)]
pub enum Happening {
    /// An event of the cell.
    Cell(EventKind),
    /// Progress of a move or a scan.
    Progress {
        /// Id of the move or of the measurement.
        job: String,
        /// 0 to 1.
        progress: f64,
    },
    /// A measurement by the sensor was recorded.
    Measured {
        /// Its id.
        measurement_id: String,
        /// Whether it has a pose.
        verdict: Verdict,
    },
    /// A measurement by the sensor failed.
    NotMeasured {
        /// Its id.
        measurement_id: String,
        /// A short code.
        code: String,
        /// What happened, as text.
        text: String,
    },
}

/// Where a client continues in the list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum After {
    /// After the event of this number; 0 for all.
    Number(u64),
    /// After an event of another instance, whose numbers do not apply to this one.
    AnotherInstance,
}

/// Events after a given number.
#[derive(Debug, Clone, PartialEq)]
pub struct Events {
    /// In order.
    pub events: Vec<Event>,
    /// How many of the requested events are no longer kept, or belong to another instance.
    pub missed_count: u64,
    /// The number after which to continue.
    pub seen: u64,
    /// The number of the newest event.
    pub newest: u64,
}

/// The ring buffer of events.
#[derive(Debug)]
pub(in crate::service) struct EventLog {
    kept: Mutex<VecDeque<Event>>,
    pub(in crate::service) newest: watch::Sender<u64>,
}

impl EventLog {
    /// An empty log.
    pub(in crate::service) fn new() -> Arc<Self> {
        Arc::new(Self { kept: Mutex::new(VecDeque::with_capacity(EVENTS_KEPT)), newest: watch::Sender::new(0) })
    }

    /// Adds an event.
    pub(in crate::service) fn add(&self, at: Timestamp, what: Happening) {
        let mut kept = self.kept();
        let number = kept.back().map_or(0, |event| event.number) + 1;
        if kept.len() == EVENTS_KEPT {
            kept.pop_front();
        }
        kept.push_back(Event { number, at, what });
        // Published under the same lock: if numbers were published out of order, a reader that has the newest would be answered at
        // once without an event, and would ask again and again.
        self.newest.send_replace(number);
    }

    /// At most `limit` of the events after `after`. A number that this instance has not reached belongs to another instance: then
    /// the result is all that are kept, with at least one missed.
    pub(in crate::service) fn after(&self, after: After, limit: usize) -> Events {
        let kept = self.kept();
        let newest = kept.back().map_or(0, |event| event.number);
        let (foreign, after) = match after {
            After::Number(number) if number <= newest => (false, number),
            After::Number(_) | After::AnotherInstance => (true, 0),
        };
        let first = kept.front().map_or(1, |event| event.number);
        let missed_count = first.saturating_sub(after.saturating_add(1)).max(u64::from(foreign));
        let events: Vec<_> = kept.iter().filter(|event| event.number > after).take(limit).cloned().collect();
        let seen = events.last().map_or(after, |event| event.number);
        Events { events, missed_count, seen, newest }
    }

    fn kept(&self) -> MutexGuard<'_, VecDeque<Event>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(count: u64) -> Arc<EventLog> {
        let log = EventLog::new();
        for _ in 0..count {
            log.add(Timestamp::UNIX_EPOCH, Happening::Cell(EventKind::Reset));
        }
        log
    }

    fn numbers(events: &Events) -> Vec<u64> {
        events.events.iter().map(|event| event.number).collect()
    }

    #[test]
    fn a_reader_continues_after_the_last_number_it_has() {
        let log = log(5);
        let events = log.after(After::Number(3), 10);
        assert_eq!((numbers(&events), events.missed_count, events.newest), (vec![4, 5], 0, 5));
        assert_eq!(numbers(&log.after(After::Number(0), 2)), [1, 2]);
        assert!(numbers(&log.after(After::Number(5), 2)).is_empty());
    }

    #[test]
    fn numbers_are_published_in_order_when_several_threads_add() {
        let log = EventLog::new();
        let mut newest = log.newest.subscribe();
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope
                    .spawn(|| (0..500).for_each(|_| log.add(Timestamp::UNIX_EPOCH, Happening::Cell(EventKind::Reset))));
            }
            let mut seen = 0;
            while seen < 2000 {
                let published = *newest.borrow_and_update();
                assert!(published >= seen, "{published} came after {seen}");
                seen = published;
                std::thread::yield_now();
            }
        });
        assert_eq!(*newest.borrow(), 2000);
    }

    #[test]
    fn dropped_events_are_counted_and_a_number_of_another_instance_starts_anew() {
        let log = log(1030);
        let events = log.after(After::Number(2), 1);
        assert_eq!((numbers(&events), events.missed_count), (vec![7], 4));
        for foreign in [After::Number(5000), After::AnotherInstance] {
            let events = log.after(foreign, 1);
            assert_eq!((numbers(&events), events.missed_count, events.seen), (vec![7], 6, 7));
        }
    }
}

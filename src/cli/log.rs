//! The log: a separate thread writes the lines to standard error. Their reader may stall (a full pipe, a stopped terminal), but the
//! service must continue, above all its stops; so lines that do not fit into the queue are dropped, and a later line reports their
//! number.

use crate::config::{Log, LogFormat};
use std::error::Error;
use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

/// Number of lines that may wait for the reader of the log.
const LINES_MAX: usize = 4096;
/// Longest time for writing the last lines at the end.
const LAST_LINES: Duration = Duration::from_millis(500);
/// Number of attempts to queue the last message within this time.
const ROOM_TRIES: u32 = 50;

/// Messages of the OPC UA library about unused keys where messages are not encrypted, and about a configuration of its own that is
/// not used. Faults of a device are reported by its adaptor.
const NOISE: [&str; 4] = [
    "opcua_client::config=off",
    "opcua_client::session::client=off",
    "opcua_core::comms::secure_channel=off",
    "opcua_crypto::certificate_store=off",
];

/// Starts the log. Dropping the returned value writes the lines so far.
pub(super) fn start(log: &Log) -> Result<LastLines, Box<dyn Error>> {
    let filter =
        EnvFilter::try_new(filter(&log.filter)).map_err(|error| format!("log.filter = {:?}: {error}", log.filter))?;
    let (lines, last_lines) = Lines::start(io::stderr(), LINES_MAX)?;
    let events =
        tracing_subscriber::fmt().with_env_filter(filter).with_ansi(io::stderr().is_terminal()).with_writer(lines);
    match log.format {
        LogFormat::Text => events.init(),
        LogFormat::Json => events.json().flatten_event(true).init(),
    }
    Ok(last_lines)
}

/// The filter with the noise excluded, unless the configured filter names it.
fn filter(asked: &str) -> String {
    if asked.contains("opcua_") { asked.to_owned() } else { format!("{asked},{}", NOISE.join(",")) }
}

enum Entry {
    Line(Vec<u8>),
    /// Answered when every earlier line has been written.
    Written(SyncSender<()>),
}

/// The sender of log lines, which never waits.
struct Lines {
    entries: SyncSender<Entry>,
    dropped_count: Arc<AtomicU64>,
}

/// Dropping it writes the remaining lines, if they are read.
pub(super) struct LastLines(SyncSender<Entry>);

/// A line that is being formatted.
struct Line<'a> {
    lines: &'a Lines,
    text: Vec<u8>,
}

impl Lines {
    fn start(out: impl Write + Send + 'static, lines_max: usize) -> io::Result<(Self, LastLines)> {
        let (entries, waiting) = sync_channel(lines_max);
        let dropped_count = Arc::new(AtomicU64::new(0));
        let lines = Self { entries: entries.clone(), dropped_count: Arc::clone(&dropped_count) };
        thread::Builder::new().name("log".to_owned()).spawn(move || write(&waiting, out, &dropped_count))?;
        Ok((lines, LastLines(entries)))
    }
}

/// Writes the waiting lines. If standard error is closed, they are dropped.
fn write(waiting: &Receiver<Entry>, mut out: impl Write, dropped_count: &AtomicU64) {
    while let Ok(entry) = waiting.recv() {
        match entry {
            Entry::Line(text) => drop(out.write_all(&text)),
            Entry::Written(said) => drop(said.try_send(())),
        }
        let lines_count = dropped_count.swap(0, Ordering::Relaxed);
        if lines_count > 0 {
            tracing::warn!(lines_count, "log lines were dropped because they were not read in time");
        }
    }
}

impl<'a> MakeWriter<'a> for Lines {
    type Writer = Line<'a>;

    fn make_writer(&'a self) -> Line<'a> {
        Line { lines: self, text: Vec::new() }
    }
}

impl Write for Line<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.text.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Line<'_> {
    fn drop(&mut self) {
        if self.lines.entries.try_send(Entry::Line(std::mem::take(&mut self.text))).is_err() {
            self.lines.dropped_count.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Drop for LastLines {
    fn drop(&mut self) {
        let (said, written) = sync_channel(1);
        // If the log is not read, the queue remains full; then the lines are lost, and the process ends.
        for _ in 0..ROOM_TRIES {
            if self.0.try_send(Entry::Written(said.clone())).is_ok() {
                let _ = written.recv_timeout(LAST_LINES);
                return;
            }
            thread::park_timeout(LAST_LINES / ROOM_TRIES);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use std::sync::mpsc::Sender;

    #[test]
    fn noise_is_excluded_from_the_log_unless_the_filter_names_it() {
        for asked in ["info", "warn,coaxis::http=debug"] {
            let filter = filter(asked);
            assert!(filter.starts_with(asked) && filter.contains(",opcua_core::comms::secure_channel=off"), "{filter}");
            EnvFilter::try_new(&filter).expect("a filter");
        }
        assert_eq!(filter("info,opcua_core=debug"), "info,opcua_core=debug");
    }

    /// A writer that blocks until it is released.
    struct Stalled {
        let_go: Receiver<()>,
        taken: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Stalled {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let _ = self.let_go.recv();
            self.taken.lock().expect("an unpoisoned lock").extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn stalled(lines_max: usize) -> (Lines, LastLines, Sender<()>, Arc<Mutex<Vec<u8>>>) {
        let (go, let_go) = std::sync::mpsc::channel();
        let taken = Arc::new(Mutex::new(Vec::new()));
        let (lines, last) = Lines::start(Stalled { let_go, taken: Arc::clone(&taken) }, lines_max).expect("a thread");
        (lines, last, go, taken)
    }

    #[test]
    fn a_stalled_reader_blocks_no_thread_and_lines_beyond_the_queue_are_dropped() {
        let (lines, last, go, taken) = stalled(2);
        for number in 0..100 {
            writeln!(lines.make_writer(), "line {number}").expect("written");
        }
        // One line may be in the writer and two in the queue.
        assert!(lines.dropped_count.load(Ordering::Relaxed) >= 97);
        drop(go);
        drop(last);
        assert!(taken.lock().expect("an unpoisoned lock").starts_with(b"line 0\n"));
    }

    #[test]
    fn the_last_lines_are_written_before_the_end() {
        let (lines, last, go, taken) = stalled(10);
        drop(go);
        writeln!(lines.make_writer(), "stopped").expect("written");
        drop(last);
        assert_eq!(taken.lock().expect("an unpoisoned lock").as_slice(), b"stopped\n");
    }
}

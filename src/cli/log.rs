//! The log: a thread of its own writes the lines to standard error. Their reader may stall (a full pipe, a stopped terminal), and
//! the service must go on, most of all its stops; so lines that do not fit into the queue are dropped, and counted in a later line.

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

/// Lines that may wait for the reader of the log.
const LINES_MAX: usize = 4096;
/// How long the last lines may take at the end.
const LAST_LINES: Duration = Duration::from_millis(500);
/// How often room is looked for meanwhile.
const ROOM_TRIES: u32 = 50;

/// What the OPC UA library says of keys that nobody wants where messages are open, and of a configuration of its own that is
/// not used. Whatever is wrong with a device its adaptor says itself.
const NOISE: [&str; 4] = [
    "opcua_client::config=off",
    "opcua_client::session::client=off",
    "opcua_core::comms::secure_channel=off",
    "opcua_crypto::certificate_store=off",
];

/// Starts the log; when what comes back is dropped, the lines so far are written out.
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

/// The lines that are written: without the noise, unless it was asked for by name.
fn filter(asked: &str) -> String {
    if asked.contains("opcua_") { asked.to_owned() } else { format!("{asked},{}", NOISE.join(",")) }
}

enum Entry {
    Line(Vec<u8>),
    /// Answers when every line before it is written.
    Written(SyncSender<()>),
}

/// Where lines go in; never waits.
struct Lines {
    entries: SyncSender<Entry>,
    dropped_count: Arc<AtomicU64>,
}

/// Writes the remaining lines when it is dropped, as far as they are read.
pub(super) struct LastLines(SyncSender<Entry>);

/// One line in the making.
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

/// If standard error is closed, the lines are dropped.
fn write(waiting: &Receiver<Entry>, mut out: impl Write, dropped_count: &AtomicU64) {
    while let Ok(entry) = waiting.recv() {
        match entry {
            Entry::Line(text) => drop(out.write_all(&text)),
            Entry::Written(said) => drop(said.try_send(())),
        }
        let lines_count = dropped_count.swap(0, Ordering::Relaxed);
        if lines_count > 0 {
            tracing::warn!(lines_count, "lines of the log were dropped; nobody read it for a while");
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
        // If the log is not read, the queue stays full: the lines are lost, and the process ends.
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
    fn noise_is_left_out_of_the_log_unless_it_is_asked_for() {
        for asked in ["info", "warn,coaxis::http=debug"] {
            let filter = filter(asked);
            assert!(filter.starts_with(asked) && filter.contains(",opcua_core::comms::secure_channel=off"), "{filter}");
            EnvFilter::try_new(&filter).expect("a filter");
        }
        assert_eq!(filter("info,opcua_core=debug"), "info,opcua_core=debug");
    }

    /// Takes nothing before it is let.
    struct Stalled {
        let_go: Receiver<()>,
        taken: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Stalled {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let _ = self.let_go.recv();
            self.taken.lock().expect("no panic").extend_from_slice(bytes);
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
    fn a_reader_that_stalls_keeps_nobody_waiting_and_costs_the_lines_that_find_no_room() {
        let (lines, last, go, taken) = stalled(2);
        for number in 0..100 {
            writeln!(lines.make_writer(), "line {number}").expect("taken");
        }
        // One may be in the writer's hands, two have room.
        assert!(lines.dropped_count.load(Ordering::Relaxed) >= 97);
        drop(go);
        drop(last);
        assert!(taken.lock().expect("no panic").starts_with(b"line 0\n"));
    }

    #[test]
    fn the_last_lines_are_written_before_the_end() {
        let (lines, last, go, taken) = stalled(10);
        drop(go);
        writeln!(lines.make_writer(), "stopped").expect("taken");
        drop(last);
        assert_eq!(taken.lock().expect("no panic").as_slice(), b"stopped\n");
    }
}

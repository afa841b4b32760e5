//! A bar on standard error for work that takes long, where a person is there to see it.

use crate::estimation::Progress;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

/// Work that is done before this needs no bar.
const PATIENCE: Duration = Duration::from_millis(400);
/// Between two looks at the work.
const INTERVAL: Duration = Duration::from_millis(100);

/// Does `work`, and shows how many profiles are done if it takes a while.
pub(super) fn with_bar<T>(name: &str, work: impl FnOnce(&Progress) -> T) -> T {
    let progress = Progress::default();
    if !std::io::stderr().is_terminal() {
        return work(&progress);
    }
    let (done, is_done) = channel::<()>();
    thread::scope(|scope| {
        let watched = &progress;
        scope.spawn(move || {
            let mut wait = PATIENCE;
            let mut bar = None;
            while is_done.recv_timeout(wait) == Err(RecvTimeoutError::Timeout) {
                wait = INTERVAL;
                bar.get_or_insert_with(|| new_bar(name)).set_position(watched.done_count() as u64);
            }
            if let Some(bar) = bar {
                bar.finish_and_clear();
            }
        });
        let result = work(&progress);
        drop(done);
        result
    })
}

fn new_bar(name: &str) -> ProgressBar {
    let style = ProgressStyle::with_template("{spinner} {msg}: {pos} profiles, {elapsed}");
    let bar = ProgressBar::no_length().with_message(name.to_owned());
    if let Ok(style) = style {
        bar.set_style(style);
    }
    bar.enable_steady_tick(INTERVAL);
    bar
}

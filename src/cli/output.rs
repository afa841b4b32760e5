//! The output of the commands: text on standard output, errors with their causes, a measurement as a table, and on a terminal a
//! progress bar for long work.

use std::error::Error;
use std::fmt::Write as _;
use std::io::{ErrorKind, IsTerminal, Write as _};
use std::process::ExitCode;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::estimation::Progress;
use crate::http::{
    MeasurementDocument, PoseDocument, ReasonDocument, ScopeDocument, TallyDocument, UncertaintyDocument, VerdictName,
};

/// Exit code of every failure other than a refusal.
pub(super) const FAILED: u8 = 1;

/// Exit code if nothing could be measured: no pose, or no cylinder.
pub(super) const REFUSED: u8 = 2;

/// The result of a command.
pub(super) type Outcome = Result<ExitCode, Box<dyn Error>>;

/// Prints an error with its causes on standard error.
#[expect(clippy::print_stderr, reason = "errors of a command are printed here")]
pub(super) fn complain(error: &dyn Error) {
    eprintln!("coaxis: {}", with_causes(error));
}

/// The text of an error and of its causes, each only once, because the text of some errors already contains their cause.
fn with_causes(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let said = error.to_string();
        if !text.contains(&said) {
            text = format!("{text}: {said}");
        }
        cause = error.source();
    }
    text
}

/// The reader of the output has closed it, as with `coaxis openapi | head`.
#[derive(Debug, thiserror::Error)]
#[error("the output was closed")]
pub(super) struct OutputClosed;

/// Writes the result of a command.
///
/// # Errors
/// [`OutputClosed`] if the reader has closed the output; otherwise the error of the operating system.
pub(super) fn print(text: &str) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).map_err(|error| match error.kind() {
        ErrorKind::BrokenPipe => OutputClosed.into(),
        _ => format!("the output cannot be written: {error}").into(),
    })
}

/// Writes a text. A reader that closes the output early, as `head` does, is no failure.
///
/// # Errors
/// The error of the operating system.
pub(super) fn print_text(text: &str) -> Outcome {
    match print(text) {
        Err(error) if !error.is::<OutputClosed>() => Err(error),
        _ => Ok(ExitCode::SUCCESS),
    }
}

/// Work that ends within this time shows no progress bar.
const PATIENCE: Duration = Duration::from_millis(400);
/// Interval between two updates of the progress bar.
const INTERVAL: Duration = Duration::from_millis(100);

/// Executes `work`, and shows the number of finished profiles if it takes longer.
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

/// The table of one measurement.
pub(super) fn table(name: &str, document: &MeasurementDocument) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_table(&mut text, name, document);
    text
}

fn write_table(text: &mut String, name: &str, document: &MeasurementDocument) -> std::fmt::Result {
    let verdict = verdict_in_words(document.verdict);
    writeln!(text, "{name}: {verdict} ({}, {} ms)", document.method, document.duration_ms)?;
    let parts = document.parts.as_deref().unwrap_or_default();
    for part in parts {
        let verdict = verdict_in_words(part.verdict);
        writeln!(text, "  part {} from x = {} mm to {} mm: {verdict}", part.name, part.x_min_mm, part.x_max_mm)?;
        write_pose(text, part.pose.as_ref().zip(part.uncertainty.as_ref()))?;
        write_profiles(text, &part.profiles)?;
        write_reasons(text, part.refusal.as_ref(), &part.conditioning.warnings)?;
    }
    if parts.is_empty() {
        write_pose(text, document.pose.as_ref().zip(document.uncertainty.as_ref()))?;
        write_profiles(text, &document.profiles)?;
        let warnings = document.conditioning.as_ref().map(|conditioning| conditioning.warnings.as_slice());
        return write_reasons(text, document.refusal.as_ref(), warnings.unwrap_or_default());
    }
    let outside_count = document.profiles.rejected.get("outside_parts").copied().unwrap_or(0);
    writeln!(text, "  outside the parts: {outside_count} of {} profiles", document.profiles.total_count)
}

const fn verdict_in_words(verdict: VerdictName) -> &'static str {
    match verdict {
        VerdictName::Accepted => "accepted",
        VerdictName::Refused => "REFUSED",
    }
}

fn write_pose(text: &mut String, found: Option<(&PoseDocument, &UncertaintyDocument)>) -> std::fmt::Result {
    let Some((pose, uncertainty)) = found else { return Ok(()) };
    let expanded = &uncertainty.expanded;
    let rows = [
        ("deflection", pose.deflection_deg, expanded.deflection_deg, "°"),
        ("pitch", pose.pitch_deg, expanded.pitch_deg, "°"),
        ("y at x = 0", pose.y_c0_mm, expanded.y_c0_mm, "mm"),
        ("z at x = 0", pose.z_c0_mm, expanded.z_c0_mm, "mm"),
        ("y at x_ref", pose.y_ref_mm, expanded.y_ref_mm, "mm"),
        ("z at x_ref", pose.z_ref_mm, expanded.z_ref_mm, "mm"),
        ("radius", Some(pose.radius_mm), Some(expanded.radius_mm), "mm"),
    ];
    let [px, py, pz] = pose.axis.point_mm;
    let [dx, dy, dz] = pose.axis.direction;
    let (position, direction) = (expanded.axis_position_mm, expanded.axis_direction_deg);
    writeln!(text, "  axis         ({px:.4}, {py:.4}, {pz:.4}) mm ± {position:.4} mm square to it")?;
    writeln!(text, "  direction    ({dx:.6}, {dy:.6}, {dz:.6}) ± {direction:.4} °")?;
    for (quantity, value, half_width, unit) in rows {
        let (Some(value), Some(half_width)) = (value, half_width) else { continue };
        writeln!(text, "  {quantity:<12} {value:>12.4} ± {half_width:.4} {unit}")?;
    }
    let ends = [
        ("end face x", pose.end_face, expanded.end_face_x_mm),
        ("far end x", pose.far_end_face, expanded.far_end_face_x_mm),
    ];
    for (quantity, face, half_width) in ends {
        let (Some(face), Some(half_width)) = (face, half_width) else { continue };
        let (x, y, z) = (face.x_mm, face.y_mm, face.z_mm);
        writeln!(text, "  {quantity:<12} {x:>12.4} ± {half_width:.4} mm, there y {y:.4}, z {z:.4}")?;
    }
    let scope = match uncertainty.scope {
        ScopeDocument::Repeatability => " of the repeatability alone; calibration is not stated (type_b)",
        ScopeDocument::Combined => "",
    };
    if let Some(x_ref_mm) = pose.x_ref_mm {
        writeln!(text, "  x_ref        {x_ref_mm:>12.4} mm")?;
    }
    writeln!(text, "  ± is the expanded uncertainty, k = 2{scope}")
}

fn write_profiles(text: &mut String, counts: &TallyDocument) -> std::fmt::Result {
    let rejected: Vec<String> = counts.rejected.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    let rejected = if rejected.is_empty() { "none rejected".to_owned() } else { rejected.join(", ") };
    writeln!(text, "  profiles     {} of {} valid; {rejected}", counts.valid_count, counts.total_count)
}

fn write_reasons(text: &mut String, refusal: Option<&ReasonDocument>, warnings: &[ReasonDocument]) -> std::fmt::Result {
    let said = refusal.into_iter().map(|refusal| ("refused", refusal));
    for (kind, reason) in said.chain(warnings.iter().map(|warning| ("warning", warning))) {
        writeln!(text, "  {kind:<12} {}: {}", reason.code, reason.detail)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    enum Refusal {
        #[error("the file is damaged: {0}")]
        Shown(#[source] std::num::ParseIntError),
        #[error("the file is damaged")]
        Linked(#[source] std::num::ParseIntError),
    }

    #[test]
    fn a_cause_is_printed_once_whether_the_error_contains_it_or_not() {
        let cause = || "x".parse::<i32>().expect_err("no number");
        let said = format!("the file is damaged: {}", cause());
        assert_eq!(with_causes(&Refusal::Shown(cause())), said);
        assert_eq!(with_causes(&Refusal::Linked(cause())), said);
    }
}

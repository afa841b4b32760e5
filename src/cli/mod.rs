//! The `coaxis` command: the service and its verbs offline, a file a command.

mod bar;
mod client;
mod completions;
mod config;
mod demo;
mod demo_cell;
mod devices;
mod doctor;
mod health;
mod log;
mod man;
mod measure;
mod openapi;
mod propose;
mod reading;
mod scene;
mod serve;
mod simulate;
mod simulate_export;
mod simulate_gocator;
mod simulate_plc;
mod simulate_sensor;
mod table;

use clap::{Parser, Subcommand};
use std::error::Error;
use std::io::{ErrorKind, Write};
use std::process::ExitCode;

/// Measures the pose of the axis of a cylindrical part from laser profile scans.
#[derive(Debug, Parser)]
#[command(name = "coaxis", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Arguments),
    Serve(serve::Arguments),
    Measure(measure::Arguments),
    Propose(propose::Arguments),
    #[command(subcommand)]
    Simulate(Box<simulate::Subject>),
    Openapi(openapi::Arguments),
    Config(config::Arguments),
    Health(health::Arguments),
    Doctor(doctor::Arguments),
    #[command(subcommand)]
    Devices(devices::Subject),
    Completions(completions::Arguments),
    Man(man::Arguments),
}

/// Anything but fine (0) and refused (2).
const FAILED: u8 = 1;
/// Nothing could be measured: no pose, or no cylinder.
const REFUSED: u8 = 2;

/// Runs the command that the process was started with.
#[must_use]
pub fn run() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(answer) => {
            // Help and version come this way, too; where the terminal is gone nobody misses them.
            let _ = answer.print();
            return if answer.use_stderr() { ExitCode::from(FAILED) } else { ExitCode::SUCCESS };
        }
    };
    let outcome = match arguments.command {
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Serve(arguments) => serve::run(&arguments),
        Command::Measure(arguments) => measure::run(&arguments),
        Command::Propose(arguments) => propose::run(&arguments),
        Command::Simulate(subject) => simulate::run(&subject),
        Command::Openapi(arguments) => openapi::run(&arguments),
        Command::Config(arguments) => config::run(&arguments),
        Command::Health(arguments) => health::run(&arguments),
        Command::Doctor(arguments) => doctor::run(&arguments),
        Command::Devices(subject) => devices::run(&subject),
        Command::Completions(arguments) => completions::run(&arguments),
        Command::Man(arguments) => man::run(&arguments),
    };
    outcome.unwrap_or_else(|error| {
        // Who closed the pipe knows why the output ends; nobody else is there to be told.
        if !error.is::<OutputClosed>() {
            complain(error.as_ref());
        }
        ExitCode::from(FAILED)
    })
}

/// What a command comes to.
type Outcome = Result<ExitCode, Box<dyn Error>>;

/// An error with its causes, for the person at the terminal.
#[expect(clippy::print_stderr, reason = "this is where a command speaks to a person")]
fn complain(error: &dyn Error) {
    eprintln!("coaxis: {}", with_causes(error));
}

/// The text of an error and of its causes, each said once: some errors show their cause already.
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

/// Nobody reads the output any more, as with `coaxis openapi | head`.
#[derive(Debug, thiserror::Error)]
#[error("the output was closed")]
struct OutputClosed;

/// Writes what a command is for.
///
/// # Errors
/// [`OutputClosed`] where nobody reads it, else what the operating system says.
fn print(text: &str) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).map_err(|error| match error.kind() {
        ErrorKind::BrokenPipe => OutputClosed.into(),
        _ => format!("the output cannot be written: {error}").into(),
    })
}

/// Writes a text that says nothing by its exit code: a reader that has seen enough, as `head` has, is no failure.
///
/// # Errors
/// What the operating system says.
fn print_text(text: &str) -> Outcome {
    match print(text) {
        Err(error) if !error.is::<OutputClosed>() => Err(error),
        _ => Ok(ExitCode::SUCCESS),
    }
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
    fn a_cause_is_said_once_whether_the_error_shows_it_or_not() {
        let cause = || "x".parse::<i32>().expect_err("no number");
        let said = format!("the file is damaged: {}", cause());
        assert_eq!(with_causes(&Refusal::Shown(cause())), said);
        assert_eq!(with_causes(&Refusal::Linked(cause())), said);
    }
}

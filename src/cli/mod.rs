//! The `coaxis` command: the service and its verbs offline, a file a command. Must not calculate itself.

mod bar;
mod client;
mod config;
mod demo;
mod health;
mod measure;
mod openapi;
mod serve;
mod simulate;
mod table;

use clap::{Parser, Subcommand};
use std::error::Error;
use std::process::ExitCode;

/// Measures the pose of the axis of a cylindrical part from laser profile scans.
#[derive(Debug, Parser)]
#[command(name = "coaxis", version, disable_help_subcommand = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Arguments),
    Serve(serve::Arguments),
    Measure(measure::Arguments),
    #[command(subcommand)]
    Simulate(simulate::Subject),
    Openapi(openapi::Arguments),
    Config(config::Arguments),
    Health(health::Arguments),
}

/// Anything but fine (0) and refused (2).
const FAILED: u8 = 1;
/// Measured, and no pose could be had.
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
        Command::Simulate(subject) => simulate::run(&subject),
        Command::Openapi(arguments) => openapi::run(&arguments),
        Command::Config(arguments) => config::run(&arguments),
        Command::Health(arguments) => health::run(&arguments),
    };
    outcome.unwrap_or_else(|error| {
        complain(error.as_ref());
        ExitCode::from(FAILED)
    })
}

/// What a command comes to.
type Outcome = Result<ExitCode, Box<dyn Error>>;

/// An error with its causes, for the person at the terminal.
#[expect(clippy::print_stderr, reason = "this is where a command speaks to a person")]
fn complain(error: &dyn Error) {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    eprintln!("coaxis: {text}");
}

/// Writes what a command is for.
#[expect(clippy::print_stdout, reason = "this is what the command is for")]
fn print(text: &str) {
    print!("{text}");
}

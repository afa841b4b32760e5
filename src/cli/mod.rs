//! The `coaxis` command: the service and its offline functions, with one file for each command.

mod client;
mod config;
mod demo;
mod devices;
mod doctor;
mod documents;
mod log;
mod measure;
mod output;
mod propose;
mod reading;
mod serve;
mod simulate;
mod simulate_devices;
mod simulate_scene;

use clap::{CommandFactory, Parser, Subcommand};
use output::{FAILED, OutputClosed, complain};
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
    Openapi(documents::ApiArguments),
    Config(config::Arguments),
    Health(client::Arguments),
    Doctor(doctor::Arguments),
    #[command(subcommand)]
    Devices(devices::Subject),
    Completions(documents::CompletionsArguments),
    Man(documents::ManArguments),
}

/// Runs the command that the process was started with.
#[must_use]
pub fn run() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(answer) => {
            // Help and version are also printed here; if the terminal is closed, they are dropped.
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
        Command::Openapi(arguments) => documents::print_api(&arguments),
        Command::Config(arguments) => config::run(&arguments),
        Command::Health(arguments) => client::run(&arguments),
        Command::Doctor(arguments) => doctor::run(&arguments),
        Command::Devices(subject) => devices::run(&subject),
        Command::Completions(arguments) => documents::print_completions(&arguments, &mut Arguments::command()),
        Command::Man(arguments) => documents::print_man(&arguments, Arguments::command()),
    };
    outcome.unwrap_or_else(|error| {
        // If the reader has closed the output, no message is needed.
        if !error.is::<OutputClosed>() {
            complain(error.as_ref());
        }
        ExitCode::from(FAILED)
    })
}

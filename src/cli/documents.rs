//! The documents about coaxis itself: `coaxis man` (the manual page of the command or of a subcommand), `coaxis completions` (for a
//! shell) and `coaxis openapi` (the API, or the table of its problem codes).

use clap::Command;
use clap_complete::{Shell, generate};
use clap_mangen::Man;

use crate::http::{Code, openapi_json};

use super::output::{Outcome, print_text};

/// Print a manual page, e.g. coaxis man serve > /usr/share/man/man1/coaxis-serve.1
#[derive(Debug, clap::Args)]
pub(super) struct ManArguments {
    /// Of which command, e.g. simulate scan [default: coaxis itself]
    command: Vec<String>,
}

pub(super) fn print_man(arguments: &ManArguments, mut command: Command) -> Outcome {
    command.build();
    let mut name = command.get_name().to_owned();
    for next in &arguments.command {
        let found = command.find_subcommand(next).cloned();
        command = found.ok_or_else(|| format!("{name} has no command {next}; {name} --help lists them"))?;
        name = format!("{name}-{next}");
    }
    let mut page = Vec::new();
    Man::new(command).title(name).render(&mut page)?;
    print_text(&String::from_utf8(page)?)
}

/// Print the completions for a shell, e.g. coaxis completions bash > /etc/bash_completion.d/coaxis
#[derive(Debug, clap::Args)]
pub(super) struct CompletionsArguments {
    /// Which shell
    shell: Shell,
}

pub(super) fn print_completions(arguments: &CompletionsArguments, command: &mut Command) -> Outcome {
    let mut script = Vec::new();
    generate(arguments.shell, command, "coaxis", &mut script);
    print_text(&String::from_utf8(script)?)
}

/// Print the OpenAPI document
#[derive(Debug, clap::Args)]
pub(super) struct ApiArguments {
    /// Print the table of problem codes instead, as Markdown
    #[arg(long)]
    problems: bool,
}

pub(super) fn print_api(arguments: &ApiArguments) -> Outcome {
    print_text(&if arguments.problems { Code::table() } else { openapi_json()? })
}

//! `coaxis man`: the manual page of the command or of one of its subcommands.

use super::{Outcome, print_text};
use clap::CommandFactory;
use clap_mangen::Man;

/// Print a manual page, e.g. coaxis man serve > /usr/share/man/man1/coaxis-serve.1
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Of which command, e.g. simulate scan [default: coaxis itself]
    command: Vec<String>,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut command = super::Arguments::command();
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

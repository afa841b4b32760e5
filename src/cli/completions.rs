//! `coaxis completions`: what a shell needs to complete commands and options.

use super::{Outcome, print_text};
use clap::CommandFactory;
use clap_complete::{Shell, generate};

/// Print the completions for a shell, e.g. coaxis completions bash > /etc/bash_completion.d/coaxis
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Which shell
    shell: Shell,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut script = Vec::new();
    generate(arguments.shell, &mut super::Arguments::command(), "coaxis", &mut script);
    print_text(&String::from_utf8(script)?)
}

//! `coaxis openapi`: the document of the API, or the table of its problem codes.

use super::{Outcome, print_text};
use crate::http::{Code, openapi_json};

/// Print the OpenAPI document
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Print the table of problem codes instead, as Markdown
    #[arg(long)]
    problems: bool,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    print_text(&if arguments.problems { Code::table() } else { openapi_json()? })
}

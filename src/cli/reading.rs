//! Flags for reading a scan file, shared by all commands that read one.

use crate::scan::decode::{Decimal, Format, Unit};
use crate::service::Recipe;

/// How the files are read, if they do not contain it themselves.
#[derive(Debug, clap::Args)]
pub(super) struct ReadingArguments {
    /// Format of the file, where name and content do not say
    #[arg(long, value_parser = format)]
    pub(super) format: Option<Format>,
    /// Unit of the file's coordinates: mm, m, um or inch
    #[arg(long, value_parser = unit)]
    unit: Option<Unit>,
    /// Sign before the decimals of a text file's numbers, where its cells do not show it: point or comma
    #[arg(long, value_name = "SIGN", value_parser = decimal)]
    decimal: Option<Decimal>,
    /// Distance between the profiles of a file that is a matrix of heights; its first column is y where --y-pitch-mm is left out
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    x_pitch_mm: Option<f64>,
    /// Distance between the points of a profile in such a matrix; its first column is x where --x-pitch-mm is left out. With both, a
    /// profile is a row, or with --profile-by column a column
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    y_pitch_mm: Option<f64>,
    /// Values of x, y or z, in the unit of the file, that mark a point as missing, separated by commas. Such values are looked for
    /// where none is given
    #[arg(long = "missing", value_name = "VALUE", value_delimiter = ',', allow_hyphen_values = true)]
    missing_values: Option<Vec<f64>>,
}

impl ReadingArguments {
    /// The flags as part of a recipe.
    pub(super) fn recipe(&self) -> Recipe {
        Recipe {
            unit: self.unit,
            decimal: self.decimal,
            x_pitch_mm: self.x_pitch_mm,
            y_pitch_mm: self.y_pitch_mm,
            missing_values: self.missing_values.clone(),
            ..Recipe::default()
        }
    }
}

/// The value with this name, or an error that lists the names.
pub(super) fn named<T, const N: usize>(
    found: Option<T>,
    all: [T; N],
    name: fn(T) -> &'static str,
) -> Result<T, String> {
    found.ok_or_else(|| format!("there is {}", all.map(name).join(", ")))
}

pub(super) fn format(name: &str) -> Result<Format, String> {
    named(Format::from_name(name), Format::ALL, Format::name)
}

fn unit(name: &str) -> Result<Unit, String> {
    named(Unit::from_name(name), Unit::ALL, Unit::name)
}

fn decimal(name: &str) -> Result<Decimal, String> {
    named(Decimal::from_name(name), Decimal::ALL, Decimal::name)
}

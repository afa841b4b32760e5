//! The names that requests choose from, as closed sets: methods, formats, units. Each converts to its domain type.

use super::problem::{Code, Problem};
use crate::estimation::{EndFaceRule, Method, Orientation, RadiusRule};
use crate::scan::decode::{Decimal, Format, Unit};
use crate::service::RecipeName;
use serde::de::{Deserializer, Error as _};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use utoipa::ToSchema;

/// A way to show a measurement or the cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::http) enum View {
    /// The whole document.
    Full,
    /// Integers in one flat object, for a PLC.
    Plc,
}

/// How the pose is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Method)]
pub(in crate::http) enum MethodName {
    /// One robust fit of one cylinder to every point of every profile.
    Cylinder,
    /// The Gaussian associated cylinder: unweighted least squares of the distances of all points.
    LeastSquares,
    /// The published robust method.
    SectionLine,
    /// The same without re-weighting and without the inner-point rule; for comparison only.
    SectionLinePlain,
}

/// In which directions the axis is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Orientation)]
pub(in crate::http) enum OrientationName {
    /// Along X, the rail, if it lies there, else in any direction, with a warning.
    Auto,
    /// Along X within `tilt_max_deg`.
    Rail,
    /// In any direction.
    Any,
}

/// How the radius is treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = RadiusRule)]
pub(in crate::http) enum RadiusName {
    /// From the data alone.
    Free,
    /// The nominal radius, exactly.
    Fixed,
    /// The nominal radius with its uncertainty, weighed against the data.
    Prior,
}

/// Which end faces of the part are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = EndFaceRule)]
pub(in crate::http) enum EndFaceName {
    /// Neither.
    None,
    /// That at the smaller x.
    Near,
    /// That at the larger x.
    Far,
    /// Both.
    Both,
}

/// How a scan is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Format)]
pub(in crate::http) enum FormatName {
    /// Text tables; also under the names txt, xyz, asc, tsv, pts, ds.
    Csv,
    /// The sectioned text that Gocator sensors export.
    GocatorCsv,
    /// Polygon files, vertices only.
    Ply,
    /// Point cloud library files.
    Pcd,
    /// One numpy array.
    Npy,
    /// Numpy arrays in a zip archive.
    Npz,
    /// Profiles in JSON.
    Json,
}

/// Unit of a file's coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Unit)]
pub(in crate::http) enum UnitName {
    /// Millimetres.
    Mm,
    /// Metres.
    M,
    /// Micrometres.
    Um,
    /// Inches.
    Inch,
}

/// Sign before the decimals of a text file's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Decimal)]
pub(in crate::http) enum DecimalName {
    /// `1.5`; a comma separates thousands.
    Point,
    /// `1,5`; a point separates thousands.
    Comma,
}

/// Parses a name like the offline command: the same spellings, and the same message for an unknown one.
macro_rules! read_by_name {
    ($($name:ty, $domain:ty, $what:literal;)+) => {$(
        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let name = Cow::<'de, str>::deserialize(deserializer)?;
                <$domain>::from_name(&name).map(Self::from).ok_or_else(|| {
                    let names = <$domain>::ALL.map(<$domain>::name).join(", ");
                    let shown: String = name.chars().take(40).collect();
                    D::Error::custom(format!("there is no {} {shown:?}; there is {names}", $what))
                })
            }
        }
    )+};
}

read_by_name! {
    MethodName, Method, "method";
    OrientationName, Orientation, "orientation";
    EndFaceName, EndFaceRule, "end face";
    FormatName, Format, "format";
    UnitName, Unit, "unit";
    DecimalName, Decimal, "decimal sign";
}

impl From<DecimalName> for Decimal {
    fn from(name: DecimalName) -> Self {
        match name {
            DecimalName::Point => Self::Point,
            DecimalName::Comma => Self::Comma,
        }
    }
}

impl From<Decimal> for DecimalName {
    fn from(sign: Decimal) -> Self {
        match sign {
            Decimal::Point => Self::Point,
            Decimal::Comma => Self::Comma,
        }
    }
}

impl From<Format> for FormatName {
    fn from(format: Format) -> Self {
        match format {
            Format::Csv => Self::Csv,
            Format::GocatorCsv => Self::GocatorCsv,
            Format::Ply => Self::Ply,
            Format::Pcd => Self::Pcd,
            Format::Npy => Self::Npy,
            Format::Npz => Self::Npz,
            Format::Json => Self::Json,
        }
    }
}

impl From<MethodName> for Method {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::Cylinder => Self::Cylinder,
            MethodName::LeastSquares => Self::LeastSquares,
            MethodName::SectionLine => Self::SectionLine,
            MethodName::SectionLinePlain => Self::SectionLinePlain,
        }
    }
}

impl From<Method> for MethodName {
    fn from(method: Method) -> Self {
        match method {
            Method::Cylinder => Self::Cylinder,
            Method::LeastSquares => Self::LeastSquares,
            Method::SectionLine => Self::SectionLine,
            Method::SectionLinePlain => Self::SectionLinePlain,
        }
    }
}

impl From<OrientationName> for Orientation {
    fn from(name: OrientationName) -> Self {
        match name {
            OrientationName::Auto => Self::Auto,
            OrientationName::Rail => Self::Rail,
            OrientationName::Any => Self::Any,
        }
    }
}

impl From<Orientation> for OrientationName {
    fn from(orientation: Orientation) -> Self {
        match orientation {
            Orientation::Auto => Self::Auto,
            Orientation::Rail => Self::Rail,
            Orientation::Any => Self::Any,
        }
    }
}

impl From<RadiusName> for RadiusRule {
    fn from(name: RadiusName) -> Self {
        match name {
            RadiusName::Free => Self::Free,
            RadiusName::Fixed => Self::Fixed,
            RadiusName::Prior => Self::Prior,
        }
    }
}

impl From<RadiusRule> for RadiusName {
    fn from(rule: RadiusRule) -> Self {
        match rule {
            RadiusRule::Free => Self::Free,
            RadiusRule::Fixed => Self::Fixed,
            RadiusRule::Prior => Self::Prior,
        }
    }
}

impl From<EndFaceName> for EndFaceRule {
    fn from(name: EndFaceName) -> Self {
        match name {
            EndFaceName::None => Self::None,
            EndFaceName::Near => Self::Near,
            EndFaceName::Far => Self::Far,
            EndFaceName::Both => Self::Both,
        }
    }
}

impl From<EndFaceRule> for EndFaceName {
    fn from(rule: EndFaceRule) -> Self {
        match rule {
            EndFaceRule::None => Self::None,
            EndFaceRule::Near => Self::Near,
            EndFaceRule::Far => Self::Far,
            EndFaceRule::Both => Self::Both,
        }
    }
}

impl From<FormatName> for Format {
    fn from(name: FormatName) -> Self {
        match name {
            FormatName::Csv => Self::Csv,
            FormatName::GocatorCsv => Self::GocatorCsv,
            FormatName::Ply => Self::Ply,
            FormatName::Pcd => Self::Pcd,
            FormatName::Npy => Self::Npy,
            FormatName::Npz => Self::Npz,
            FormatName::Json => Self::Json,
        }
    }
}

impl From<UnitName> for Unit {
    fn from(name: UnitName) -> Self {
        match name {
            UnitName::Mm => Self::Millimetre,
            UnitName::M => Self::Metre,
            UnitName::Um => Self::Micrometre,
            UnitName::Inch => Self::Inch,
        }
    }
}

impl From<Unit> for UnitName {
    fn from(unit: Unit) -> Self {
        match unit {
            Unit::Millimetre => Self::Mm,
            Unit::Metre => Self::M,
            Unit::Micrometre => Self::Um,
            Unit::Inch => Self::Inch,
        }
    }
}

/// The name of a recipe.
pub(in crate::http) fn recipe_name(name: String) -> Result<RecipeName, Problem> {
    RecipeName::parse(&name).ok_or_else(|| {
        Problem::new(Code::RecipeUnknown, format!("there is no recipe {name}; list them with GET /v1/recipes"))
            .with("recipe", name)
    })
}

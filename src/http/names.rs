//! The words that requests choose from, as closed sets: methods, formats, units. Each turns into the domain's own.

use crate::estimation::{EndFaceRule, Method, Orientation, RadiusRule};
use crate::scan::decode::{Format, Unit};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A way to show a measurement or the cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum View {
    /// The whole document.
    Full,
    /// Integers in one flat object, for a PLC.
    Plc,
}

/// How the pose is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Method)]
pub(super) enum MethodName {
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Orientation)]
pub(super) enum OrientationName {
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
pub(super) enum RadiusName {
    /// From the data alone.
    Free,
    /// The nominal radius, exactly.
    Fixed,
    /// The nominal radius with its uncertainty, weighed against the data.
    Prior,
}

/// Which end faces of the part are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = EndFaceRule)]
pub(super) enum EndFaceName {
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Format)]
pub(super) enum FormatName {
    /// Text tables: CSV, TXT, XYZ, ASC.
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Unit)]
pub(super) enum UnitName {
    /// Millimetres.
    Mm,
    /// Metres.
    M,
    /// Micrometres.
    Um,
    /// Inches.
    Inch,
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

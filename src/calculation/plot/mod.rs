//! Pictures of a measurement as self-contained SVG: the result, and the data that support it.
//!
//! The input is a scan and its estimate, the output text; equal input gives equal bytes. Every picture stays below about 1 MB
//! whatever the size of the scan, and states the result with its uncertainty, or the reason why the scan was refused. The pictures
//! of a refused scan show its points.

mod about_axis;
mod centres;
mod end_view;
mod grid;
mod header;
mod marks;
mod overlays;
mod palette;
mod panel;
mod residual_map;
mod scale;
mod section;
mod svg;

pub use header::Subject;

use crate::estimation::Estimate;
use crate::scan::Scan;

/// The pictures that can be drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Picture {
    /// The centres of the profiles along x, the axis through them, and their deviations from it; without a pose the points from
    /// above and from the side.
    Centres,
    /// The unrolled surface: signed distance of the points from the fitted cylinder; without a pose the surface from above.
    ResidualMap,
    /// One profile: its points, their weights and its section.
    Section,
    /// All points viewed along the axis; without a pose along X.
    EndView,
}

impl Picture {
    /// All pictures.
    pub const ALL: [Self; 4] = [Self::Centres, Self::ResidualMap, Self::Section, Self::EndView];

    /// The name used in requests and file names.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Centres => "centres",
            Self::ResidualMap => "residual_map",
            Self::Section => "section",
            Self::EndView => "end_view",
        }
    }

    /// The picture of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|picture| picture.name() == name)
    }
}

/// Draws one picture: an SVG 1.1 document of 1000 × 700 pixels.
#[must_use]
pub fn draw(picture: Picture, scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    match picture {
        Picture::Centres => centres::centres(scan, estimate, subject),
        Picture::ResidualMap => residual_map::residual_map(scan, estimate, subject),
        Picture::Section => section::section(scan, estimate, subject),
        Picture::EndView => end_view::end_view(scan, estimate, subject),
    }
}

#[cfg(test)]
mod tests;

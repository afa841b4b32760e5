//! Pictures of a measurement as self-contained SVG, for people: what was found, and why it should be believed.
//!
//! A scan and its estimate come in, text goes out; equal input gives equal bytes. Knows estimation, scan and geometry;
//! must not know files, clocks, requests or who looks. Every picture stays below about 1 MB whatever the size of the
//! scan, and states the result with its uncertainty, or why the scan was refused; of a refused scan it shows the points.

mod about_axis;
mod area;
mod centres;
mod end_faces;
mod end_view;
mod grid;
mod header;
mod legend;
mod marks;
mod notice;
mod palette;
mod panel;
mod points;
mod residual_map;
mod result;
mod section;
mod section_points;
mod seen;
mod spread;
mod surface;
mod svg;
mod ticks;

#[cfg(test)]
mod tests;

use crate::estimation::Estimate;
use crate::scan::Scan;
use jiff::Timestamp;

/// What can be drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Picture {
    /// The centres of the profiles along x, the axis through them, and how far they lie from it; without a pose the points
    /// from above and from the side.
    Centres,
    /// The unrolled surface: signed distance of the points from the fitted cylinder; without a pose the surface from above.
    ResidualMap,
    /// One profile: its points, their weights and its section.
    Section,
    /// All points seen along the axis; without a pose along X.
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

/// What the pictures say besides the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Subject<'a> {
    /// What was measured, e.g. the id of the measurement or the name of the file; any text.
    pub title: &'a str,
    /// When it was measured, where that is known.
    pub measured_at: Option<Timestamp>,
    /// Name of the recipe, where there is one.
    pub recipe: Option<&'a str>,
    /// What measured it, where that is known.
    pub software: Option<&'a str>,
    /// The setting `epsilon_mm` of the estimation.
    pub epsilon_mm: f64,
    /// Index in the scan of the profile that [`Picture::Section`] shows; `None` takes the valid one nearest to the middle, or the
    /// middle one where none is valid.
    pub profile: Option<usize>,
    /// Number that the first profile of the scan is known by; 0 but for a part of a scan.
    pub first_profile: usize,
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

//! What a scan file holds, before anyone decided which points make a profile.

use super::columns::Columns;
use super::decode::Unit;

/// Successive points of a file that share a label and an x: the laser's stripe, or a piece of it.
///
/// Run-length coding keeps x out of the way where a file is organised, and costs nothing to take apart where it is not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stripe {
    /// Value of the profile column, or number of the row; 0 where there is neither.
    pub label: f64,
    /// Common x, mm.
    pub x: f64,
    /// One past the stripe's last point; it starts where the one before it ends.
    pub end: usize,
}

/// What the labels of the stripes are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Labels {
    /// The file says nothing about profiles.
    None,
    /// The number of a row of organised data.
    Row,
    /// The value of the column of this name.
    Column(String),
}

/// The points of a file, in its own order, finite and in millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct Cloud {
    /// Runs of points that share a label and an x.
    pub stripes: Vec<Stripe>,
    /// y and z of every point.
    pub columns: Columns,
    /// What the labels mean.
    pub labels: Labels,
    /// The unit that the file's coordinates were read in.
    pub unit: Unit,
    /// Planes of rows or profiles of which the file holds none but missing points, as far as it says where they are, mm.
    pub blanks: Vec<f64>,
    /// Points that the file marks as missing (NaN, infinite, empty cell); they are in no column.
    pub missing_count: u64,
}

impl Cloud {
    /// The points in the order of the file, mm.
    pub fn points(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        let mut start = 0;
        self.stripes.iter().flat_map(move |stripe| {
            let range = std::mem::replace(&mut start, stripe.end)..stripe.end;
            range.filter_map(move |index| self.columns.get(index).map(|[y, z]| [stripe.x, y, z]))
        })
    }
}

//! The types that the whole module uses: the four axes of a manipulator, and the two manipulators. Lengths in
//! millimetres, angles in radians, times in seconds.

use serde::{Deserialize, Serialize};

/// One of a manipulator's four axes. X, Y and Z lie along the axes of the rail frame; C turns about the part's axis, from
/// +Y towards +Z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// Along the rail.
    X,
    /// Across.
    Y,
    /// Up.
    Z,
    /// The turn.
    C,
}

impl Axis {
    /// All, in the order of every list.
    pub const ALL: [Self; 4] = [Self::X, Self::Y, Self::Z, Self::C];

    /// The name used in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::C => "c",
        }
    }

    /// The unit that its values have at the edges.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::X | Self::Y | Self::Z => "mm",
            Self::C => "deg",
        }
    }

    /// A value as the edges know it (mm, or degrees), from one as it is known inside (mm, or radians).
    #[must_use]
    pub const fn outside(self, inside: f64) -> f64 {
        match self {
            Self::X | Self::Y | Self::Z => inside,
            Self::C => inside.to_degrees(),
        }
    }

    /// A value as it is known inside (mm, or radians), from one as the edges know it (mm, or degrees).
    #[must_use]
    pub const fn inside(self, outside: f64) -> f64 {
        match self {
            Self::X | Self::Y | Self::Z => outside,
            Self::C => outside.to_radians(),
        }
    }
}

/// Something for each axis of a manipulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axes<T> {
    /// Along the rail.
    pub x: T,
    /// Across.
    pub y: T,
    /// Up.
    pub z: T,
    /// The turn.
    pub c: T,
}

/// Where a manipulator's axes are: mm, mm, mm, rad.
pub type Position = Axes<f64>;

impl<T> Axes<T> {
    /// That of one axis.
    pub const fn get(&self, axis: Axis) -> &T {
        match axis {
            Axis::X => &self.x,
            Axis::Y => &self.y,
            Axis::Z => &self.z,
            Axis::C => &self.c,
        }
    }

    /// That of one axis, to change it.
    pub const fn get_mut(&mut self, axis: Axis) -> &mut T {
        match axis {
            Axis::X => &mut self.x,
            Axis::Y => &mut self.y,
            Axis::Z => &mut self.z,
            Axis::C => &mut self.c,
        }
    }

    /// Made axis by axis.
    pub fn from_fn(mut make: impl FnMut(Axis) -> T) -> Self {
        Self { x: make(Axis::X), y: make(Axis::Y), z: make(Axis::Z), c: make(Axis::C) }
    }

    /// Each with its axis.
    pub fn iter(&self) -> impl Iterator<Item = (Axis, &T)> {
        Axis::ALL.into_iter().map(|axis| (axis, self.get(axis)))
    }

    /// Changed axis by axis.
    pub fn map<U>(&self, mut change: impl FnMut(Axis, &T) -> U) -> Axes<U> {
        Axes::from_fn(|axis| change(axis, self.get(axis)))
    }
}

/// One of the two manipulators that carry the part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Carrier {
    /// The one at the smaller x.
    M1,
    /// The one at the greater x.
    M2,
}

impl Carrier {
    /// Both.
    pub const ALL: [Self; 2] = [Self::M1, Self::M2];

    /// The id used in addresses and documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::M1 => "m1",
            Self::M2 => "m2",
        }
    }
}

/// Something for each manipulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pair<T> {
    /// That of the one at the smaller x.
    pub m1: T,
    /// That of the one at the greater x.
    pub m2: T,
}

impl<T> Pair<T> {
    /// That of one manipulator.
    pub const fn get(&self, carrier: Carrier) -> &T {
        match carrier {
            Carrier::M1 => &self.m1,
            Carrier::M2 => &self.m2,
        }
    }

    /// That of one manipulator, to change it.
    pub const fn get_mut(&mut self, carrier: Carrier) -> &mut T {
        match carrier {
            Carrier::M1 => &mut self.m1,
            Carrier::M2 => &mut self.m2,
        }
    }

    /// Made one by one.
    pub fn from_fn(mut make: impl FnMut(Carrier) -> T) -> Self {
        Self { m1: make(Carrier::M1), m2: make(Carrier::M2) }
    }

    /// Each with its manipulator.
    pub fn iter(&self) -> impl Iterator<Item = (Carrier, &T)> {
        Carrier::ALL.into_iter().map(|carrier| (carrier, self.get(carrier)))
    }

    /// Changed one by one.
    pub fn map<U>(&self, mut change: impl FnMut(Carrier, &T) -> U) -> Pair<U> {
        Pair::from_fn(|carrier| change(carrier, self.get(carrier)))
    }
}

/// The limits of one axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisLimits {
    /// Least value; mm, or rad.
    pub lower: f64,
    /// Greatest value; mm, or rad.
    pub upper: f64,
    /// Greatest speed; mm/s, or rad/s.
    pub speed: f64,
    /// Greatest acceleration; mm/s², or rad/s².
    pub acceleration: f64,
    /// Greatest jerk; mm/s³, or rad/s³.
    pub jerk: f64,
    /// Longest travel that one request may ask for; mm, or rad.
    pub step: f64,
}

/// Where both manipulators are, and how fast they are to be there: one set-point of a path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Waypoint {
    /// Since the start of the path, s.
    pub at_s: f64,
    /// Targets; absolute.
    pub targets: Pair<Position>,
    /// Speeds from the previous waypoint to this one, such that all axes arrive at `at_s`; mm/s, rad/s. Zero where
    /// an axis stays.
    pub speeds: Pair<Position>,
}

/// Set-points in order of time: what the cell executes. The first is where the path starts, at 0 s.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// At least two.
    pub waypoints: Vec<Waypoint>,
    /// Which manipulators move; commands go to no other.
    pub moves: Pair<bool>,
}

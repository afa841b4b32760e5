//! The types of this module: the four axes of a manipulator, and the two manipulators. Lengths in millimetres, angles in radians,
//! times in seconds.

use serde::{Deserialize, Serialize};

/// One of a manipulator's four axes. X, Y and Z lie along the axes of the rail frame; C turns about the part's axis, from +Y
/// towards +Z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// Along the rail.
    X,
    /// Horizontally across the rail.
    Y,
    /// Vertically.
    Z,
    /// The turn.
    C,
}

impl Axis {
    /// All axes, in the order of every list.
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

    /// The unit of its values in documents and messages.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::X | Self::Y | Self::Z => "mm",
            Self::C => "deg",
        }
    }

    /// Converts an internal value (mm, or radians) into the unit of documents and messages (mm, or degrees).
    #[must_use]
    pub const fn outside(self, inside: f64) -> f64 {
        match self {
            Self::X | Self::Y | Self::Z => inside,
            Self::C => inside.to_degrees(),
        }
    }

    /// Converts a value in the unit of documents and messages (mm, or degrees) into an internal one (mm, or radians).
    #[must_use]
    pub const fn inside(self, outside: f64) -> f64 {
        match self {
            Self::X | Self::Y | Self::Z => outside,
            Self::C => outside.to_radians(),
        }
    }
}

/// One value for each axis of a manipulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axes<T> {
    /// Along the rail.
    pub x: T,
    /// Horizontally across the rail.
    pub y: T,
    /// Vertically.
    pub z: T,
    /// The turn.
    pub c: T,
}

/// Positions of a manipulator's axes: mm, mm, mm, rad.
pub type Position = Axes<f64>;

impl<T> Axes<T> {
    /// The value of one axis.
    pub const fn get(&self, axis: Axis) -> &T {
        match axis {
            Axis::X => &self.x,
            Axis::Y => &self.y,
            Axis::Z => &self.z,
            Axis::C => &self.c,
        }
    }

    /// The mutable value of one axis.
    pub const fn get_mut(&mut self, axis: Axis) -> &mut T {
        match axis {
            Axis::X => &mut self.x,
            Axis::Y => &mut self.y,
            Axis::Z => &mut self.z,
            Axis::C => &mut self.c,
        }
    }

    /// Calls `make` for each axis.
    pub fn from_fn(mut make: impl FnMut(Axis) -> T) -> Self {
        Self { x: make(Axis::X), y: make(Axis::Y), z: make(Axis::Z), c: make(Axis::C) }
    }

    /// The values with their axes.
    pub fn iter(&self) -> impl Iterator<Item = (Axis, &T)> {
        Axis::ALL.into_iter().map(|axis| (axis, self.get(axis)))
    }

    /// Applies `change` to the value of each axis.
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

/// One value for each manipulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pair<T> {
    /// The value of the one at the smaller x.
    pub m1: T,
    /// The value of the one at the greater x.
    pub m2: T,
}

impl<T> Pair<T> {
    /// The value of one manipulator.
    pub const fn get(&self, carrier: Carrier) -> &T {
        match carrier {
            Carrier::M1 => &self.m1,
            Carrier::M2 => &self.m2,
        }
    }

    /// The mutable value of one manipulator.
    pub const fn get_mut(&mut self, carrier: Carrier) -> &mut T {
        match carrier {
            Carrier::M1 => &mut self.m1,
            Carrier::M2 => &mut self.m2,
        }
    }

    /// Calls `make` for each manipulator.
    pub fn from_fn(mut make: impl FnMut(Carrier) -> T) -> Self {
        Self { m1: make(Carrier::M1), m2: make(Carrier::M2) }
    }

    /// The values with their manipulators.
    pub fn iter(&self) -> impl Iterator<Item = (Carrier, &T)> {
        Carrier::ALL.into_iter().map(|carrier| (carrier, self.get(carrier)))
    }

    /// Applies `change` to the value of each manipulator.
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
    /// Longest travel of one request; mm, or rad.
    pub step: f64,
}

/// Target positions of both manipulators and their speeds on the way: one set-point of a path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Waypoint {
    /// Since the start of the path, s.
    pub at_s: f64,
    /// Targets; absolute.
    pub targets: Pair<Position>,
    /// Speeds from the previous waypoint to this one, at which all axes arrive at `at_s`; mm/s, rad/s. Zero for an axis that stays.
    pub speeds: Pair<Position>,
}

/// Set-points in order of time, which the cell executes. The first is the start of the path, at 0 s.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// At least two set-points.
    pub waypoints: Vec<Waypoint>,
    /// Which manipulators move; commands are sent to no other.
    pub moves: Pair<bool>,
}

//! Where the axes of the two manipulators have to go so that the part lies where it is wanted, and how they get there without
//! straining it. Pure calculation: positions and limits in, a path or a refusal out. Knows geometry; must not know devices.

mod axes;

pub use axes::{Axes, Axis, AxisLimits, Carrier, Pair, Path, Position, Waypoint};

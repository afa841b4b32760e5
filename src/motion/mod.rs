//! Where the axes of the two manipulators have to go so that the part lies where it is wanted, and how they get there without
//! straining it. Pure calculation: positions and limits in, a path or a refusal out. Knows geometry; must not know devices.

mod arrangement;
mod axes;
mod kinematics;
mod refusal;

pub use arrangement::{Arrangement, ArrangementError, Support};
pub use axes::{Axes, Axis, AxisLimits, Carrier, Pair, Path, Position, Waypoint};
pub use kinematics::{PartPose, PoseTarget, carried};
pub use refusal::{MotionRefusal, PathFault};

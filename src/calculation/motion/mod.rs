//! Where the axes of the two manipulators have to go so that the part lies where it is wanted, and how they get there without
//! straining it. Pure calculation: positions and limits in, a path or a refusal out. Knows geometry; must not know devices.
//!
//! ```text
//! measured pose, target -> kinematics: eight targets -> course (rigid) ----\
//! targets of axes ----------------------------------> course (straight) ----+-> waypoints -> check -> Plan
//!                                          progress, run_on: its time --/    (strain, run_on)
//! ```

mod arrangement;
mod axes;
mod check;
mod course;
mod kinematics;
mod plan;
mod progress;
mod refusal;
mod run_on;
mod strain;
mod waypoints;

#[cfg(test)]
mod tests;

pub use arrangement::{Arrangement, ArrangementError, Support};
pub use axes::{Axes, Axis, AxisLimits, Carrier, Pair, Path, Position, Waypoint};
pub use check::check_path;
pub use kinematics::{PartPose, PoseTarget, carried};
pub use plan::{AxisTravel, MoveTargets, Plan, plan_alignment, plan_move};
pub use refusal::{MotionRefusal, PathFault};

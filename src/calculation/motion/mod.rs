//! Calculates the targets of the axes of the two manipulators that bring the part into its target pose, and a path on which they do
//! not strain it. The input is positions and limits, the output a path or a refusal.
//!
//! ```text
//! measured pose, target -> kinematics: eight targets -> Course::rigid ----\
//! targets of axes ----------------------------------> Course::straight ---+-> plan (set-points) -> check -> Plan
//!                                                 course: its time --/                (strain)
//! ```

mod arrangement;
mod axes;
mod check;
mod course;
mod kinematics;
mod plan;
mod refusal;
mod strain;

#[cfg(test)]
mod tests;

pub use arrangement::{Arrangement, ArrangementError, Support};
pub use axes::{Axes, Axis, AxisLimits, Carrier, Pair, Path, Position, Waypoint};
pub use check::check_path;
pub use kinematics::{PartPose, PoseTarget, carried};
pub use plan::{AxisTravel, MoveTargets, Plan, plan_alignment, plan_move};
pub use refusal::{MotionRefusal, PathFault};

//! Axes, signs and the few shapes that everything else is said in. Knows no other room.
//!
//! The rail frame, right-handed, lengths in millimetres, angles in radians:
//!
//! ```text
//!        Z  up, towards the sensor
//!        |
//!        |   . the part's axis: y = y_c0 + p x, z = z_c0 + q x, direction (1, p, q)
//!        |  .
//!        | .
//!        O-----------> X  along the stage's travel (the rail); profile i lies in the plane x = x_i
//!       /
//!      /
//!     Y  completes the right-handed frame
//! ```
//!
//! Deflection is atan p (towards +Y), pitch is atan q (towards +Z). Degrees appear only at the edges.

mod angle;
mod axis;
mod axis_line;
mod frame;
mod section;

pub use angle::Angle;
pub use axis::Axis;
pub use axis_line::AxisLine;
pub use frame::{Frame, FrameError};
pub use section::SectionEllipse;

//! Frames, axes, signs and the shapes that all other modules use.
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

mod axis;
mod frame;

pub use axis::{Angle, Axis, AxisLine, SectionEllipse};
pub use frame::{Frame, FrameError};

//! Synthetic scans of a cylindrical part with holes, clamps, drop-outs, spikes and noise on it, and their true values.
//! The same part and seed give the same scan on every machine.
//!
//! ```text
//! surface --laser plane--> true point --noise, sensor--> (y, z) --travel--> (x, y, z) --export--> Scan --placed--> cloud
//! ```
//!
//! A feature displaces its points along the line of sight from the axis, so that the true section is the ellipse of
//! [`AxisLine::section`](crate::geometry::AxisLine::section). Every effect beyond noise, drop-outs and spikes draws from a random stream of its own: switching one
//! on does not change the noise of the points.

mod acquire;
mod export;
mod features;
mod noise;
mod part;
mod sensor;
mod travel;
mod truth;

pub use acquire::{make, make_profile, make_several};
pub use export::{Coordinates, Export, Sentinel, SentinelPlace, Steps};
pub use features::{Bead, ClampShape, Edge, Edges, Feature, Interference, Neighbour};
pub use part::{Part, SPIKE_MM, Sampling, Side, Surroundings};
pub use sensor::{Bend, Curl, LaserPlane, Reflections, Ripple, SensorErrors};
pub use travel::{RepeatedX, Travel};
pub use truth::{Bound, PlacedTruth, PlacementError, Truth, placed, random_frame};

#[cfg(test)]
mod tests;

//! Axes on the wire: lengths in millimetres, turns in degrees, units in every name. Must not know what they are used for.

use crate::motion::{Axes, Axis, AxisTravel, Carrier, Pair, Plan};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Targets of one manipulator; an axis that is not named stays.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = AxisTargets)]
pub(super) struct TargetsDocument {
    /// Along the rail.
    x_mm: Option<f64>,
    /// Across.
    y_mm: Option<f64>,
    /// Up.
    z_mm: Option<f64>,
    /// The turn, from +Y towards +Z.
    c_deg: Option<f64>,
}

impl From<TargetsDocument> for Axes<Option<f64>> {
    fn from(targets: TargetsDocument) -> Self {
        let TargetsDocument { x_mm, y_mm, z_mm, c_deg } = targets;
        Self { x: x_mm, y: y_mm, z: z_mm, c: c_deg.map(f64::to_radians) }
    }
}

/// What each axis of both manipulators would do, or does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = Travels)]
pub(super) struct TravelsDocument {
    /// The manipulator at the smaller x.
    m1: ManipulatorTravelDocument,
    /// The manipulator at the greater x.
    m2: ManipulatorTravelDocument,
}

/// What each axis of a manipulator would do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = ManipulatorTravel)]
pub(super) struct ManipulatorTravelDocument {
    /// Whether anything is sent to it.
    moves: bool,
    /// Along the rail.
    x: LinearTravelDocument,
    /// Across.
    y: LinearTravelDocument,
    /// Up.
    z: LinearTravelDocument,
    /// The turn.
    c: TurnTravelDocument,
}

/// The way of a linear axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = LinearTravel)]
pub(super) struct LinearTravelDocument {
    /// Where it starts.
    from_mm: f64,
    /// Where it ends.
    to_mm: f64,
    /// How far it goes.
    travel_mm: f64,
    /// How far it is from its nearest limit in the end.
    margin_mm: f64,
}

/// The way of the turning axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = TurnTravel)]
pub(super) struct TurnTravelDocument {
    /// Where it starts.
    from_deg: f64,
    /// Where it ends.
    to_deg: f64,
    /// How far it turns.
    travel_deg: f64,
    /// How far it is from its nearest limit in the end.
    margin_deg: f64,
}

impl From<&Plan> for TravelsDocument {
    fn from(plan: &Plan) -> Self {
        let Pair { m1, m2 } = plan.axes.map(|carrier, axes| ManipulatorTravelDocument {
            moves: *plan.path.moves.get(carrier),
            x: linear(axes.get(Axis::X)),
            y: linear(axes.get(Axis::Y)),
            z: linear(axes.get(Axis::Z)),
            c: turn(axes.get(Axis::C)),
        });
        Self { m1, m2 }
    }
}

const fn linear(way: &AxisTravel) -> LinearTravelDocument {
    let AxisTravel { from, to, travel, margin } = *way;
    LinearTravelDocument { from_mm: from, to_mm: to, travel_mm: travel, margin_mm: margin }
}

const fn turn(way: &AxisTravel) -> TurnTravelDocument {
    let AxisTravel { from, to, travel, margin } = *way;
    TurnTravelDocument {
        from_deg: from.to_degrees(),
        to_deg: to.to_degrees(),
        travel_deg: travel.to_degrees(),
        margin_deg: margin.to_degrees(),
    }
}

/// The manipulator of an id.
pub(super) fn carrier(id: &str) -> Option<Carrier> {
    Carrier::ALL.into_iter().find(|carrier| carrier.name() == id)
}

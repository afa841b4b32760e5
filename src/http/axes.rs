//! Axes on the wire: lengths in millimetres, turns in degrees, units in every name.

use super::numbers::{LENGTH_MAX_MM, TURN_MAX_DEG, degrees, rounded, within};
use super::problem::Problem;
use crate::motion::{Axes, Axis, AxisTravel, Carrier, Pair, Plan};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Targets of one manipulator; an axis that is not named stays.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = AxisTargets)]
pub(super) struct TargetsDocument {
    /// Along the rail.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    x_mm: Option<f64>,
    /// Across.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    y_mm: Option<f64>,
    /// Up.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    z_mm: Option<f64>,
    /// The turn, from +Y towards +Z.
    #[schema(minimum = -3600.0, maximum = 3600.0)]
    c_deg: Option<f64>,
}

impl TargetsDocument {
    /// The targets of this manipulator; `None` where none is named.
    ///
    /// # Errors
    /// `option_invalid` where one is beyond all bounds.
    pub(super) fn targets(self, carrier: Carrier) -> Result<Option<Axes<Option<f64>>>, Problem> {
        let Self { x_mm, y_mm, z_mm, c_deg } = self;
        let target = |name: &str, value: Option<f64>, most: f64| {
            value.map(|value| within(&format!("{}.{name}", carrier.name()), value, most)).transpose()
        };
        let axes = Axes {
            x: target("x_mm", x_mm, LENGTH_MAX_MM)?,
            y: target("y_mm", y_mm, LENGTH_MAX_MM)?,
            z: target("z_mm", z_mm, LENGTH_MAX_MM)?,
            c: target("c_deg", c_deg, TURN_MAX_DEG)?.map(f64::to_radians),
        };
        Ok((axes != Axes::default()).then_some(axes))
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
    LinearTravelDocument {
        from_mm: rounded(from),
        to_mm: rounded(to),
        travel_mm: rounded(travel),
        margin_mm: rounded(margin),
    }
}

const fn turn(way: &AxisTravel) -> TurnTravelDocument {
    let AxisTravel { from, to, travel, margin } = *way;
    TurnTravelDocument {
        from_deg: degrees(from),
        to_deg: degrees(to),
        travel_deg: degrees(travel),
        margin_deg: degrees(margin),
    }
}

/// The manipulator of an id.
pub(super) fn carrier(id: &str) -> Option<Carrier> {
    Carrier::ALL.into_iter().find(|carrier| carrier.name() == id)
}

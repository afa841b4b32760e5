//! The adaptor, taken apart and whole: its codec with hostile values, and its link with our own simulated PLC on loopback. The
//! PLC of another make is in tests/plc_opcua.rs.

mod hostile;
mod loopback;

use super::layout::Node;
use crate::motion::{Axes, AxisLimits};
use opcua::types::{DataValue, DateTime, StatusCode, Variant};

fn limits() -> Axes<AxisLimits> {
    let linear = AxisLimits { lower: -50.0, upper: 50.0, speed: 10.0, acceleration: 50.0, jerk: 500.0, step: 50.0 };
    let turn = AxisLimits { lower: -0.2, upper: 0.2, speed: 0.1, acceleration: 0.5, jerk: 5.0, step: 0.2 };
    Axes { x: linear, y: linear, z: linear, c: turn }
}

/// A good value as a server would send it.
fn good(value: impl Into<Variant>) -> DataValue {
    DataValue {
        value: Some(value.into()),
        status: Some(StatusCode::Good),
        source_timestamp: Some(DateTime::ymd_hms(2026, 5, 1, 12, 0, 0)),
        ..DataValue::null()
    }
}

/// Puts another value in the place of a node's.
fn swap(values: &mut [(Node, DataValue)], node: Node, value: &DataValue) {
    for (_, place) in values.iter_mut().filter(|(of, _)| *of == node) {
        *place = value.clone();
    }
}

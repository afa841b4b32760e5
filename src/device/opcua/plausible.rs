//! What is asked of a server once, when we connect: whether positions have the units that we think, and whether commands can be
//! written as we write them. A command of which one half is refused and the other taken is worse than none.
//! Takes the answers, gives the first thing that is wrong. Pure.

use super::layout::Node;
use super::nodes::{Answer, Odd, variant};
use crate::motion::Axis;
use opcua::types::{AttributeId, DataTypeId, DataValue, EUInformation, NodeId, Variant};

/// CEFACT's code of the millimetre, "MMT", as OPC UA counts it.
pub(super) const MILLIMETRE: i32 = 0x4D_4D54;
/// CEFACT's code of the degree, "DD", as OPC UA counts it.
pub(super) const DEGREE: i32 = 0x4444;

/// The unit that an axis must have.
pub(super) const fn unit(axis: Axis) -> i32 {
    match axis {
        Axis::X | Axis::Y | Axis::Z => MILLIMETRE,
        Axis::C => DEGREE,
    }
}

/// What [`units`] wants to know.
pub(super) fn asked_of_units() -> Vec<(Node, AttributeId)> {
    Axis::ALL.map(|axis| (Node::Unit(axis), AttributeId::Value)).into()
}

/// Whether every axis has its unit.
pub(super) fn units(values: &[(Node, DataValue)]) -> Result<(), Odd> {
    let answer = Answer::new(values);
    for axis in Axis::ALL {
        let node = Node::Unit(axis);
        let wrong = Odd::Type { node, wanted: "a unit" };
        let Variant::ExtensionObject(object) = variant(node, answer.raw(node)?)? else { return Err(wrong) };
        let found = object.inner_as::<EUInformation>().ok_or(wrong)?.unit_id;
        if found != unit(axis) {
            let why = if axis == Axis::C { "is not the degree (17476)" } else { "is not the millimetre (5066068)" };
            return Err(Odd::Value { node, value: format!("unit {found}"), why });
        }
    }
    Ok(())
}

/// Everything that we write.
fn written() -> impl Iterator<Item = Node> {
    Node::COMMAND.into_iter().chain([Node::Pulse])
}

/// What [`writable`] wants to know.
pub(super) fn asked_of_commands() -> Vec<(Node, AttributeId)> {
    let attributes = [AttributeId::DataType, AttributeId::ValueRank, AttributeId::UserAccessLevel];
    written().flat_map(|node| attributes.map(|attribute| (node, attribute))).collect()
}

/// The type that a node must have, and whether it holds four.
pub(super) const fn kind(node: Node) -> (DataTypeId, bool) {
    match node {
        Node::Fence => (DataTypeId::UInt64, false),
        Node::WatchdogMs => (DataTypeId::UInt32, false),
        Node::Targets | Node::Velocities => (DataTypeId::Double, true),
        _ => (DataTypeId::UInt16, false),
    }
}

/// Bit of the access level that lets a value be written.
const CURRENT_WRITE: u8 = 2;

/// Whether every node of a command takes what we would write to it.
pub(super) fn writable(values: &[(Node, DataValue)]) -> Result<(), Odd> {
    let mut answers = values.iter();
    for node in written() {
        let mut next = || match answers.next() {
            Some((of, value)) if *of == node => variant(node, value),
            _ => Err(Odd::Missing(node)),
        };
        let (data_type, rank, access) = (next()?, next()?, next()?);
        let (wanted, array) = kind(node);
        let wanted = NodeId::from(wanted);
        if !matches!(data_type, Variant::NodeId(found) if **found == wanted) {
            return Err(Odd::Value { node, value: format!("of type {data_type}"), why: "docs/opcua.md has otherwise" });
        }
        // -1 is one value, 1 a list; -3, -2 and 0 leave it open.
        if !matches!((rank, array), (Variant::Int32(-3..=-1), false) | (Variant::Int32(-3 | -2 | 0 | 1), true)) {
            let why = if array { "is no list" } else { "is a list" };
            return Err(Odd::Value { node, value: format!("of rank {rank}"), why });
        }
        if !matches!(access, Variant::Byte(bits) if bits & CURRENT_WRITE != 0) {
            return Err(Odd::Value { node, value: format!("of access {access}"), why: "does not let us write" });
        }
    }
    Ok(())
}

//! The address space of a simulated PLC: every node of the layout at the place where the settings have it, and its values from
//! the PLC.

use super::plc::Plc;
use crate::device::opcua::layout::{Node, Step, steps};
use crate::device::opcua::plausible::kind;
use crate::device::opcua::settings::Settings;
use crate::motion::Carrier;
use opcua::server::address_space::{AccessLevel, AddressSpace, ObjectBuilder, VariableBuilder};
use opcua::server::node_manager::memory::SimpleNodeManager;
use opcua::types::{DataTypeId, NamespaceMap, NodeId, NumericRange, ObjectId, QualifiedName, StatusCode, Variant};
use std::sync::Arc;

/// Builds the nodes of one manipulator, and ties them to the PLC.
pub(super) fn build(
    manager: &SimpleNodeManager,
    settings: &Settings,
    namespaces: &NamespaceMap,
    own: u16,
    plc: &Arc<Plc>,
    carrier: Carrier,
) {
    for node in Node::all() {
        let id = place(&mut manager.address_space().write(), settings, namespaces, own, node);
        tie(manager, &id, plc, carrier, node);
    }
}

/// Makes a node, and the objects on the way to it where there are none yet; its id.
fn place(space: &mut AddressSpace, settings: &Settings, namespaces: &NamespaceMap, own: u16, node: Node) -> NodeId {
    let path = settings.path(node);
    let mut parent: NodeId = ObjectId::ObjectsFolder.into();
    let mut walked = String::new();
    let steps = steps(&path).unwrap_or_default();
    let last = steps.len().saturating_sub(1);
    for (index, Step { alias, name }) in steps.into_iter().enumerate() {
        walked = format!("{walked}/{}:{name}", alias.unwrap_or_default());
        let id = NodeId::new(own, walked.as_str());
        let uri = alias.and_then(|alias| settings.namespaces.get(alias));
        let browse_name = QualifiedName::new(uri.and_then(|uri| namespaces.get_index(uri)).unwrap_or(0), name);
        if index == last {
            insert_variable(space, &id, browse_name, name, &parent, node);
        } else if !space.node_exists(&id) {
            ObjectBuilder::new(&id, browse_name, name).component_of(parent).insert(space);
        }
        parent = id;
    }
    parent
}

fn insert_variable(
    space: &mut AddressSpace,
    id: &NodeId,
    browse_name: QualifiedName,
    name: &str,
    parent: &NodeId,
    node: Node,
) {
    let (data_type, array) = type_of(node);
    let variable = VariableBuilder::new(id, browse_name, name)
        .data_type(data_type)
        .value_rank(if array { 1 } else { -1 })
        .value(Variant::Empty);
    let variable = if array { variable.array_dimensions(&[4]) } else { variable };
    let written = node == Node::Pulse || Node::COMMAND.contains(&node);
    let access =
        if written { AccessLevel::CURRENT_READ | AccessLevel::CURRENT_WRITE } else { AccessLevel::CURRENT_READ };
    let variable = variable.access_level(access).user_access_level(access);
    match node {
        Node::Range(_) | Node::Unit(_) => variable.property_of(parent.clone()),
        _ => variable.component_of(parent.clone()),
    }
    .insert(space);
}

const fn type_of(node: Node) -> (DataTypeId, bool) {
    match node {
        Node::Snapshot | Node::FaultCode => (DataTypeId::UInt32, false),
        Node::AxisStates => (DataTypeId::UInt16, true),
        Node::Homed | Node::InPosition | Node::AxisFaults | Node::LimitsHit => (DataTypeId::Boolean, true),
        Node::Commanded | Node::MaxVelocities => (DataTypeId::Double, true),
        Node::Actual(_) => (DataTypeId::Double, false),
        Node::Range(_) => (DataTypeId::Range, false),
        Node::Unit(_) => (DataTypeId::EUInformation, false),
        _ => kind(node),
    }
}

fn tie(manager: &SimpleNodeManager, id: &NodeId, plc: &Arc<Plc>, carrier: Carrier, node: Node) {
    let read = Arc::clone(plc);
    manager.inner().add_read_callback(id.clone(), move |range, _, _| match range {
        NumericRange::None => read.read(carrier, node),
        _ => Err(StatusCode::BadIndexRangeInvalid),
    });
    let written = Arc::clone(plc);
    manager.inner().add_write_callback(id.clone(), move |value, range| match (value.value, range) {
        (Some(value), NumericRange::None) => written.write(carrier, node, value),
        _ => StatusCode::BadWriteNotSupported,
    });
}

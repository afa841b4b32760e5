//! A simulated PLC as an OPC UA server: the other side of the adaptor, for trying coaxis without a machine, and for its tests. It
//! is anonymous and unencrypted, which a real PLC must not be. Input: controllers. Output: a server whose address space has every
//! node of the layout at the place that the settings give, with its values from the PLC.

pub(super) mod plc;

pub use plc::Plc;

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;

use opcua::server::address_space::{AccessLevel, AddressSpace, ObjectBuilder, VariableBuilder};
use opcua::server::diagnostics::NamespaceMetadata;
use opcua::server::node_manager::memory::{SimpleNodeManager, simple_node_manager};
use opcua::server::{ServerBuilder, ServerHandle};
use opcua::types::{DataTypeId, NamespaceMap, NodeId, NumericRange, ObjectId, QualifiedName, StatusCode, Variant};
use tokio::net::TcpListener;

use crate::motion::Carrier;

use super::layout::{Node, Step, steps};
use super::nodes::kind;
use super::session::make_private;
use super::settings::Settings;

/// Why the server could not start, or ended.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address is in use, or does not belong to this machine.
    #[error("cannot listen on {address}: {cause}")]
    Address {
        /// The requested address.
        address: SocketAddr,
        /// The error of the operating system.
        cause: std::io::Error,
    },
    /// The folder for keys cannot be created.
    #[error("the folder {folder} cannot be created: {cause}")]
    Folder {
        /// The folder.
        folder: String,
        /// The error of the operating system.
        cause: std::io::Error,
    },
    /// The library could not build the server, or has ended it.
    #[error("the OPC UA server ended: {0}")]
    Ended(String),
}

/// A server that is already listening, and answers once it runs.
pub struct PlcServer {
    address: SocketAddr,
    listener: TcpListener,
    server: opcua::server::Server,
    handle: ServerHandle,
}

/// Path of each manipulator in the simulated PLC.
#[must_use]
pub fn device_path(carrier: Carrier) -> String {
    format!("di:DeviceSet/own:Cell/robotics:MotionDevices/own:{}", carrier.name().to_uppercase())
}

impl PlcServer {
    /// Starts listening; port 0 selects a free one. `folder` is where the library stores keys, although none are used.
    ///
    /// # Errors
    /// [`ServeError`] with the reason.
    pub async fn listen(address: SocketAddr, plc: &Arc<Plc>, folder: &Path) -> Result<Self, ServeError> {
        make_private(folder).map_err(|cause| ServeError::Folder { folder: folder.display().to_string(), cause })?;
        let listener = TcpListener::bind(address).await.map_err(|cause| ServeError::Address { address, cause })?;
        let address = listener.local_addr().map_err(|cause| ServeError::Address { address, cause })?;
        let settings = Settings::default();
        let own = settings.namespaces.get("own").cloned().unwrap_or_default();
        let server = ServerBuilder::new_anonymous("coaxis simulated PLC")
            .application_uri("urn:coaxis:simulated-plc")
            .product_uri("urn:coaxis")
            .pki_dir(folder)
            .host(address.ip().to_string())
            .port(address.port());
        // The library lists only the namespaces of its node managers, so each namespace gets one, although all nodes are in `own`.
        let server = settings.namespaces.values().fold(server, |server, uri| {
            let metadata = NamespaceMetadata { namespace_uri: uri.clone(), ..NamespaceMetadata::default() };
            server.with_node_manager(simple_node_manager(metadata, uri))
        });
        let (server, handle) = server.build().map_err(ServeError::Ended)?;
        let built = Self { address, listener, server, handle };
        built.fill(plc, &settings, &own)?;
        Ok(built)
    }

    fn fill(&self, plc: &Arc<Plc>, settings: &Settings, own: &str) -> Result<(), ServeError> {
        let namespaces = self.handle.type_tree().read().namespaces().clone();
        let missing = || ServeError::Ended("its nodes have no place".to_owned());
        let manager = self.handle.node_managers().get_by_name::<SimpleNodeManager>(own).ok_or_else(missing)?;
        let own = namespaces.get_index(own).ok_or_else(missing)?;
        for carrier in Carrier::ALL {
            let settings = Settings { device: device_path(carrier), ..settings.clone() };
            build(&manager, &settings, &namespaces, own, plc, carrier);
        }
        Ok(())
    }

    /// The address on which it listens.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers requests until it is ended or dropped.
    ///
    /// # Errors
    /// [`ServeError::Ended`] if the library ends it.
    pub async fn run(self) -> Result<(), ServeError> {
        self.server.run_with(self.listener).await.map_err(ServeError::Ended)
    }
}

/// Serves a simulated PLC until it is ended.
///
/// # Errors
/// [`ServeError`] with the reason.
pub async fn serve(address: SocketAddr, plc: &Arc<Plc>, folder: &Path) -> Result<(), ServeError> {
    PlcServer::listen(address, plc, folder).await?.run().await
}

/// Builds the nodes of one manipulator, and connects them to the PLC.
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

/// Creates a node, with the missing objects on its path, and returns its id.
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

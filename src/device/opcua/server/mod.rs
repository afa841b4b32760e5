//! A simulated PLC as an OPC UA server: the other side of the adaptor, for trying coaxis without a machine, and for its tests.
//! Anonymous and unencrypted; a real PLC must not be. In: controllers. Out: a server.

pub(super) mod image;
mod plc;
mod space;

pub use plc::Plc;

use super::opening::make_private;
use super::settings::Settings;
use crate::motion::Carrier;
use opcua::server::diagnostics::NamespaceMetadata;
use opcua::server::node_manager::memory::{SimpleNodeManager, simple_node_manager};
use opcua::server::{ServerBuilder, ServerHandle};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use tokio::net::TcpListener;

/// Why there is no server, or none any more.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address is taken, or not this machine's.
    #[error("cannot listen on {address}: {cause}")]
    Address {
        /// As asked.
        address: SocketAddr,
        /// As the system says.
        cause: std::io::Error,
    },
    /// The folder for keys cannot be made.
    #[error("the folder {folder} cannot be made: {cause}")]
    Folder {
        /// Where.
        folder: String,
        /// As the system says.
        cause: std::io::Error,
    },
    /// The library does not build the server, or has ended it.
    #[error("the OPC UA server ended: {0}")]
    Ended(String),
}

/// A server that listens already and answers once it runs.
pub struct PlcServer {
    address: SocketAddr,
    listener: TcpListener,
    server: opcua::server::Server,
    handle: ServerHandle,
}

/// Where each manipulator lies in the simulated PLC.
#[must_use]
pub fn device_path(carrier: Carrier) -> String {
    format!("di:DeviceSet/own:Cell/robotics:MotionDevices/own:{}", carrier.name().to_uppercase())
}

impl PlcServer {
    /// Listens; port 0 takes a free one. `folder` is where the library wants to keep keys, although none are used.
    ///
    /// # Errors
    /// [`ServeError`] says what is in the way.
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
        // The library lists the namespaces of its node managers, and no others: one for each, though all nodes are in `own`.
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
            space::build(&manager, &settings, &namespaces, own, plc, carrier);
        }
        Ok(())
    }

    /// Where it listens.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers until it is ended, or dropped.
    ///
    /// # Errors
    /// [`ServeError::Ended`] where the library ends it.
    pub async fn run(self) -> Result<(), ServeError> {
        self.server.run_with(self.listener).await.map_err(ServeError::Ended)
    }
}

/// Serves a simulated PLC until the end.
///
/// # Errors
/// [`ServeError`] says why it cannot.
pub async fn serve(address: SocketAddr, plc: &Arc<Plc>, folder: &Path) -> Result<(), ServeError> {
    PlcServer::listen(address, plc, folder).await?.run().await
}

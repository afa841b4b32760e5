//! One session with the server. It is opened in one attempt (the client's key, the server's certificate, the endpoint), finds the
//! nodes by their browse paths, and reads or writes a list of them in one service call. After its first failure it is not used
//! again.
//!
//! The client library would reconnect and repeat its requests. Both are switched off: there are no retries and no reconnects, and
//! the event loop of the library is aborted with the session, so that no waiting request is sent later.

use std::collections::HashMap;
use std::fs::DirBuilder;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use opcua::client::services::Read;
use opcua::client::{Client, ClientBuilder, Session, UARequest};
use opcua::types::{
    AttributeId, BrowsePath, BrowsePathResult, DataValue, DateTime, Error, NamespaceMap, NodeId, ObjectId,
    QualifiedName, ReadValueId, ReferenceTypeId, RelativePath, RelativePathElement, StatusCode, TimestampsToReturn,
    VariableId, Variant, WriteValue,
};
use tokio::task::AbortHandle;

use super::layout::{Node, Step, steps};
use super::security::{Policy, SecurityError};
use super::settings::Settings;

/// Why there is no session, or no answer in it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum Failure {
    /// An error of the library or of the server.
    #[error("{cause}")]
    Said {
        /// Status code of OPC UA.
        status: StatusCode,
        /// Description of the error.
        cause: String,
    },
    /// The password or the certificate cannot be read.
    #[error(transparent)]
    Security(#[from] SecurityError),
    /// The folder of keys, or a key in it, cannot be created.
    #[error("the client's key and certificate cannot be read or created in {folder}: {cause}")]
    Keys {
        /// Folder.
        folder: String,
        /// The cause.
        cause: String,
    },
    /// The server presents another certificate than the trusted one.
    #[error("the server presents another certificate than the one in security.server_certificate")]
    Stranger,
    /// The server does not have a required namespace.
    #[error("the server has no namespace {0}")]
    Namespace(String),
    /// The server does not have a required node.
    #[error("the server has no node {path} ({key}): {status}")]
    NoNode {
        /// Path.
        path: String,
        /// Name.
        key: String,
        /// The status code of the server.
        status: StatusCode,
    },
    /// The answer has another number of values than requested.
    #[error("the answer has {found} values, but {wanted} were requested")]
    Length {
        /// Number of received values.
        found: usize,
        /// Number of requested values.
        wanted: usize,
    },
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Said { status: error.status(), cause: error.to_string() }
    }
}

/// The task that transfers the session's bytes. It ends with its owner, and closes the connection.
pub(super) struct Pump(AbortHandle);

impl Pump {
    pub(super) const fn new(task: AbortHandle) -> Self {
        Self(task)
    }
}

impl Drop for Pump {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// An open session.
pub(super) struct Open {
    session: Arc<Session>,
    nodes: HashMap<Node, NodeId>,
    _pump: Pump,
}

/// Values with the time at which the server provided them, by its own clock.
pub(super) struct Values {
    pub(super) values: Vec<(Node, DataValue)>,
    pub(super) answered: DateTime,
}

impl Open {
    /// Requests the node ids of all paths in one call.
    pub(super) async fn find(session: Arc<Session>, pump: Pump, settings: &Settings) -> Result<Self, Failure> {
        let namespaces = namespaces(&session).await?;
        let wanted: Vec<(Node, String)> = Node::all().map(|node| (node, settings.path(node))).collect();
        let paths: Result<Vec<_>, _> =
            wanted.iter().map(|(_, path)| browse_path(path, settings, &namespaces)).collect();
        let found = session.translate_browse_paths_to_node_ids(&paths?).await?;
        same_length(found.len(), wanted.len())?;
        let nodes: Result<HashMap<_, _>, _> = wanted
            .into_iter()
            .zip(&found)
            .map(|((node, path), result)| match only_target(result) {
                Ok(id) => Ok((node, id)),
                Err(status) => Err(Failure::NoNode { path, key: node.key(), status }),
            })
            .collect();
        Ok(Self { session, nodes: nodes?, _pump: pump })
    }

    fn id(&self, node: Node) -> NodeId {
        self.nodes.get(&node).cloned().unwrap_or_else(NodeId::null)
    }

    /// Reads attributes of nodes in one call and in this order.
    pub(super) async fn read(&self, wanted: &[(Node, AttributeId)]) -> Result<Values, Failure> {
        let nodes = wanted.iter().map(|(node, attribute)| ReadValueId::new(self.id(*node), *attribute)).collect();
        let question = Read::new(&self.session).nodes_to_read(nodes).timestamps_to_return(TimestampsToReturn::Both);
        let answer = question.send(self.session.channel()).await?;
        let values = answer.results.unwrap_or_default();
        same_length(values.len(), wanted.len())?;
        let values = wanted.iter().map(|(node, _)| *node).zip(values).collect();
        Ok(Values { values, answered: answer.response_header.timestamp })
    }

    /// Writes values, in one call and in this order. Returns the result of each.
    pub(super) async fn write(&self, values: &[(Node, Variant)]) -> Result<Vec<StatusCode>, Failure> {
        let list: Vec<_> = values
            .iter()
            .map(|(node, value)| WriteValue {
                node_id: self.id(*node),
                attribute_id: AttributeId::Value as u32,
                value: DataValue { value: Some(value.clone()), ..DataValue::null() },
                ..WriteValue::default()
            })
            .collect();
        let results = self.session.write(&list).await?;
        same_length(results.len(), values.len())?;
        Ok(results)
    }

    /// Closes the session properly, so that the server need not keep it until it expires.
    pub(super) async fn close(self) {
        // It makes no difference whether the server received this, because the connection is closed in any case.
        let _ = self.session.disconnect().await;
    }
}

const fn same_length(found: usize, wanted: usize) -> Result<(), Failure> {
    if found == wanted { Ok(()) } else { Err(Failure::Length { found, wanted }) }
}

/// The server's namespaces with their present indices.
async fn namespaces(session: &Session) -> Result<NamespaceMap, Failure> {
    let node = ReadValueId::from(NodeId::from(VariableId::Server_NamespaceArray));
    let values = session.read(&[node], TimestampsToReturn::Neither, 0.0).await?;
    let none = || Failure::Namespace("list".to_owned());
    let Some(Some(Variant::Array(array))) = values.into_iter().next().map(|value| value.value) else {
        return Err(none());
    };
    NamespaceMap::new_from_variant_array(&array.values).map_err(|_| none())
}

fn browse_path(path: &str, settings: &Settings, namespaces: &NamespaceMap) -> Result<BrowsePath, Failure> {
    let element = |step: Step<'_>| {
        let index = match step.alias.map(|alias| settings.namespaces.get(alias).map_or(alias, String::as_str)) {
            None => 0,
            Some(uri) => namespaces.get_index(uri).ok_or_else(|| Failure::Namespace(uri.to_owned()))?,
        };
        Ok(RelativePathElement {
            reference_type_id: ReferenceTypeId::HierarchicalReferences.into(),
            is_inverse: false,
            include_subtypes: true,
            target_name: QualifiedName::new(index, step.name),
        })
    };
    let elements: Result<Vec<_>, Failure> = steps(path).unwrap_or_default().into_iter().map(element).collect();
    Ok(BrowsePath {
        starting_node: ObjectId::ObjectsFolder.into(),
        relative_path: RelativePath { elements: Some(elements?) },
    })
}

/// The node at the end of a path. Two nodes are an error, because it would be unknown which one moves.
fn only_target(result: &BrowsePathResult) -> Result<NodeId, StatusCode> {
    if result.status_code.is_bad() {
        return Err(result.status_code);
    }
    match result.targets.as_deref().unwrap_or_default() {
        [target] if target.remaining_path_index == u32::MAX && target.target_id.server_index == 0 => {
            Ok(target.target_id.node_id.clone())
        }
        [] => Err(StatusCode::BadNoMatch),
        _ => Err(StatusCode::BadTooManyMatches),
    }
}

/// Lifetime of a secure channel. It is renewed after three quarters of this time, which takes part of the deadline of one reading.
const CHANNEL_MS: u32 = 3_600_000;

/// Two manipulators share a folder: one creates the key, and the other one finds it.
static MAKING: Mutex<()> = Mutex::new(());

/// Creates the client. It reads the client's key, or creates one if there is none, which takes seconds and blocks.
pub(super) fn client(settings: &Settings) -> Result<Client, Failure> {
    let folder = settings.security.pki();
    let keys = |cause: String| Failure::Keys { folder: folder.display().to_string(), cause };
    make_private(&folder).map_err(|error| keys(error.to_string()))?;
    let secured = settings.security.policy != Policy::None;
    let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
    let client = ClientBuilder::new()
        .application_name("coaxis")
        .application_uri("urn:coaxis:client")
        .product_uri("urn:coaxis")
        .session_name("coaxis")
        .pki_dir(&folder)
        .create_sample_keypair(secured)
        // `open` has compared the certificate with the one from the file before anything is sent; the library only copies it.
        .trust_server_certs(true)
        .verify_server_certs(false)
        .session_retry_limit(0)
        .recreate_subscriptions(false)
        .session_timeout(u32::try_from(settings.session_ms).unwrap_or(u32::MAX))
        .keep_alive_interval(Duration::from_millis(settings.session_ms / 3))
        .request_timeout(settings.connect_within())
        .channel_lifetime(CHANNEL_MS)
        .max_message_size(1 << 20)
        .max_array_length(10_000)
        .max_string_length(1 << 16)
        .max_byte_string_length(1 << 16)
        .client()
        .map_err(|errors| keys(errors.join("; ")))?;
    let made = folder.join("own/cert.der").is_file() && folder.join("private/private.pem").is_file();
    if secured && !made { Err(keys("it could not be made".to_owned())) } else { Ok(client) }
}

/// Creates a folder that only this user can read, for the key.
pub(super) fn make_private(folder: &Path) -> std::io::Result<()> {
    let mut maker = DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut maker, 0o700);
    maker.recursive(true).create(folder)
}

/// Opens a session and finds every node.
pub(super) async fn open(client: &mut Client, settings: &Settings) -> Result<Open, Failure> {
    let identity = settings.security.identity()?;
    let trusted = settings.security.trusted()?;
    let policy = settings.security.policy;
    let offered = client.get_server_endpoints_from_url(settings.endpoint.as_str()).await?;
    let wanted = Client::find_matching_endpoint(&offered, &settings.endpoint, policy.library(), policy.mode());
    let endpoint = wanted.ok_or_else(|| Failure::Said {
        status: StatusCode::BadSecurityPolicyRejected,
        cause: format!("the server offers no endpoint with the policy {}", policy.library()),
    })?;
    if trusted.is_some_and(|trusted| trusted.as_byte_string() != endpoint.server_certificate) {
        return Err(Failure::Stranger);
    }
    let (session, events) = client.connect_to_endpoint_directly(endpoint, identity)?;
    session.disable_reconnects();
    let mut running = events.spawn();
    let pump = Pump::new(running.abort_handle());
    tokio::select! {
        biased;
        ended = &mut running => {
            let status = ended.unwrap_or(StatusCode::BadUnexpectedError);
            return Err(Failure::Said { status, cause: "the server opened no session".to_owned() });
        }
        _ = session.wait_for_connection() => {}
    }
    Open::find(session, pump, settings).await
}

//! How a session comes to be: our key, the server's certificate, the endpoint, and no more attempts than one.
//!
//! The library below would like to reconnect, and to say again what it said. That is switched off: no retries, no
//! reconnects, and its pump is ended with the session, so that nothing that waits in it is sent by anybody later.

use super::session::{Failure, Open, Pump};
use super::settings::{Policy, Settings};
use opcua::client::{Client, ClientBuilder};
use opcua::types::StatusCode;
use std::fs::DirBuilder;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// A secure channel is renewed after three quarters of this: work for a key, inside some reading's deadline.
const CHANNEL_MS: u32 = 3_600_000;

/// Two manipulators share a folder: one makes the key, the other finds it.
static MAKING: Mutex<()> = Mutex::new(());

/// Makes the client: reads our key, and makes one where there is none, which takes seconds and blocks.
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
        // `open` has compared the certificate with the one from the file before anything is said; the library copies it.
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

/// Nobody else reads our key.
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

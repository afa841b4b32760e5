//! The control channel of a simulated sensor: a request in, a reply out, one at a time, as long as the client stays. What it
//! does not know it refuses by name, the first frame of the maker's client among it: that is in the form of an older protocol,
//! and such a client takes the refusal for what it is.

use super::super::codec::{
    Command, Reply, Request, SensorState, Splitter, Status, VERSION_MAJOR, VERSION_MINOR, Version,
};
use super::Shared;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;

const REQUEST_BYTES_MAX: usize = 64 * 1024;
/// The mode "profile".
const MODE_PROFILE: i32 = 2;

/// Serves whoever comes.
pub(super) async fn serve_control(shared: Arc<Shared>, listener: TcpListener) {
    let mut clients = JoinSet::new();
    loop {
        tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => { clients.spawn(converse(Arc::clone(&shared), stream)); }
                Err(error) => return tracing::warn!(%error, "the control channel is closed"),
            },
            Some(_) = clients.join_next() => {}
        }
    }
}

/// A client that says what is no frame, or nothing more, is let go.
async fn converse(shared: Arc<Shared>, mut stream: TcpStream) {
    let mut splitter = Splitter::new(REQUEST_BYTES_MAX);
    let mut replies = Vec::new();
    loop {
        match stream.read_buf(splitter.room()).await {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        loop {
            match splitter.next_frame() {
                Ok(Some(frame)) => answer(&shared, frame, &mut replies),
                Ok(None) => break,
                Err(_) => return,
            }
        }
        if stream.write_all(&replies).await.is_err() {
            return;
        }
        replies.clear();
    }
}

fn answer(shared: &Shared, frame: &[u8], out: &mut Vec<u8>) {
    let Ok(request) = Request::decode(frame) else { return };
    let (status, payload) = match Command::from_id(request.id) {
        Some(command) => act(shared, command),
        None => (Status::INVALID_COMMAND, Vec::new()),
    };
    Reply { id: request.id, status, payload: &payload }.encode(out);
}

/// Does what is asked: status and payload of the reply.
fn act(shared: &Shared, command: Command) -> (Status, Vec<u8>) {
    let running = *shared.running.borrow();
    let payload = match command {
        Command::ProtocolVersion => Version { major: VERSION_MAJOR, minor: VERSION_MINOR }.encode(),
        Command::SystemInfo => shared.settings.identity.encode_v1(running),
        Command::SystemInfoV2 => shared.settings.identity.encode_v2(running),
        Command::States => if running { SensorState::Running } else { SensorState::Ready }.encode(),
        Command::Mode => MODE_PROFILE.to_le_bytes().to_vec(),
        Command::Timestamp => shared.timestamp.load(Ordering::Relaxed).to_le_bytes().to_vec(),
        Command::Encoder => shared.encoder.load(Ordering::Relaxed).to_le_bytes().to_vec(),
        Command::Start if running || shared.faults.borrow().refuse_start => return (Status::INVALID_STATE, Vec::new()),
        Command::Start => {
            shared.running.send_replace(true);
            Vec::new()
        }
        Command::Stop => {
            shared.running.send_replace(false);
            Vec::new()
        }
        Command::Ping => Vec::new(),
    };
    (Status::OK, payload)
}

//! The health channel of a simulated sensor: how it is, at once, again when that changes, and every period.

use super::super::codec::{Health, Indicator, indicator};
use super::Shared;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::sleep;

/// Hundredths of °C.
const TEMPERATURE: i64 = 4_100;

/// Tells whoever comes.
pub(super) async fn serve_health(shared: Arc<Shared>, listener: TcpListener) {
    let mut clients = JoinSet::new();
    loop {
        tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => { clients.spawn(tell(Arc::clone(&shared), stream)); }
                Err(error) => return tracing::warn!(%error, "the health channel is closed"),
            },
            Some(_) = clients.join_next() => {}
        }
    }
}

async fn tell(shared: Arc<Shared>, mut stream: TcpStream) {
    let (mut faults, mut running) = (shared.faults.subscribe(), shared.running.subscribe());
    loop {
        let message = message(&shared);
        if !shared.faults.borrow().health_silent && stream.write_all(&message).await.is_err() {
            return;
        }
        tokio::select! {
            () = sleep(shared.settings.health_period) => {}
            changed = faults.changed() => if changed.is_err() { return },
            changed = running.changed() => if changed.is_err() { return },
        }
    }
}

fn message(shared: &Shared) -> Vec<u8> {
    let usual = [
        (indicator::ENCODER, shared.encoder.load(Ordering::Relaxed)),
        (indicator::TEMPERATURE, TEMPERATURE),
        (indicator::STATE, i64::from(*shared.running.borrow())),
    ];
    let injected = shared.faults.borrow().indicators.clone();
    let indicators: Vec<Indicator> =
        usual.into_iter().chain(injected).map(|(id, value)| Indicator { id, instance: 0, value }).collect();
    let mut out = Vec::new();
    Health::encode(0, &indicators, &mut out);
    out
}

//! The data channel of a simulated sensor: what its source sees, to everyone who listens, from start to stop. A client hears
//! whole messages or none; one that does not read for long is let go.

use super::form::Form;
use super::source::{Source, Taken};
use super::{Faults, Shared};
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::time::timeout;

/// How long a client may keep the others waiting.
const WRITE_WITHIN: Duration = Duration::from_secs(2);

pub(super) struct Feed {
    shared: Arc<Shared>,
    /// Not blocking, and asked when a scan starts: who has connected by then hears it from its first frame.
    listener: TcpListener,
    source: Box<dyn Source>,
    clients: Vec<TcpStream>,
}

impl Feed {
    pub(super) fn new(shared: Arc<Shared>, listener: TcpListener, source: Box<dyn Source>) -> Self {
        Self { shared, listener, source, clients: Vec::new() }
    }

    /// Scan after scan.
    pub(super) async fn run(mut self) {
        let mut running = self.shared.running.subscribe();
        while running.wait_for(|running| *running).await.is_ok() {
            self.source.begin();
            self.welcome();
            match self.shared.settings.view.form {
                Form::PointCloud | Form::Uniform => self.send_profiles(&mut running).await,
                Form::Surface => self.send_surface(&mut running).await,
            }
            // A sensor that has nothing more to show still runs until it is told to stop.
            if running.wait_for(|running| !*running).await.is_err() {
                return;
            }
        }
    }

    /// Takes in who has connected.
    fn welcome(&mut self) {
        while let Ok((stream, _)) = self.listener.accept() {
            let usable = stream.set_nonblocking(true).and_then(|()| TcpStream::from_std(stream));
            self.clients.extend(usable.and_then(|stream| stream.set_nodelay(true).map(|()| stream)));
        }
    }

    async fn send_profiles(&mut self, running: &mut watch::Receiver<bool>) {
        let (mut frame, mut message) = (0, Vec::new());
        while let Some(taken) = self.next(running, frame).await {
            if self.shared.faults.borrow().skip_frame != Some(frame) {
                message.clear();
                self.shared.settings.view.profile(&taken, frame + 1, &mut message);
                self.send(&message).await;
            }
            frame += 1;
        }
    }

    async fn send_surface(&mut self, running: &mut watch::Receiver<bool>) {
        let (mut rows, mut first) = (Vec::new(), None);
        while let Some(taken) = self.next(running, rows.len() as u64).await {
            rows.push(self.shared.settings.view.row(&taken));
            first.get_or_insert(taken);
        }
        if let Some(first) = first.filter(|_| *running.borrow()) {
            let mut message = Vec::new();
            self.shared.settings.view.surface(&first, &rows, &mut message);
            self.send(&message).await;
        }
    }

    /// The next profile, unless the sensor is stopped or has a fault there.
    async fn next(&mut self, running: &mut watch::Receiver<bool>, frame: u64) -> Option<Arc<Taken>> {
        // A source that is never waited for, and nobody to write to: the stop must get its turn all the same.
        tokio::task::coop::consume_budget().await;
        let Faults { stall_at, end_at, .. } = *self.shared.faults.borrow();
        if end_at == Some(frame) {
            self.shared.running.send_replace(false);
        }
        let seen = async {
            if stall_at == Some(frame) {
                std::future::pending::<()>().await;
            }
            self.source.next().await
        };
        let taken = tokio::select! {
            biased;
            _ = running.wait_for(|running| !*running) => None,
            taken = seen => taken,
        }?;
        self.shared.encoder.store(taken.encoder, Ordering::Relaxed);
        self.shared.timestamp.store(taken.timestamp, Ordering::Relaxed);
        Some(taken)
    }

    async fn send(&mut self, message: &[u8]) {
        let mut kept = Vec::with_capacity(self.clients.len());
        for mut client in self.clients.drain(..) {
            if matches!(timeout(WRITE_WITHIN, client.write_all(message)).await, Ok(Ok(()))) {
                kept.push(client);
            }
        }
        self.clients = kept;
    }
}

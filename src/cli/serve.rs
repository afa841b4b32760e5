//! `coaxis serve`: runs the service until a signal stops it.

use super::config::Sources;
use super::log;
use super::output::Outcome;
use crate::config::Config;
use crate::device::simulated::World;
use crate::http::{Server, Stopper};
use crate::service::Capacity;
use crate::service::{Equipment, Service, ServiceError};
use crate::store::StoreError;
use jiff::Timestamp;
use std::error::Error;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};

/// Longest time that threads waiting for a client may delay the end of the process.
const THREADS_END: Duration = Duration::from_millis(500);

/// Serve measurements over HTTP until interrupted
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    sources: Sources,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let (config, ignored) = arguments.sources.config_and_ignored()?;
    let _last_lines = log::start(&config.log)?;
    if !ignored.is_empty() {
        let variables = ignored.join(", ");
        tracing::warn!(variables, "environment variables that name no setting are ignored: {variables}");
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let outcome = runtime.block_on(serve(&config));
    runtime.shutdown_timeout(THREADS_END);
    outcome.map(|()| ExitCode::SUCCESS)
}

async fn serve(config: &Config) -> Result<(), Box<dyn Error>> {
    let (service, _) = open_service(config).await?;
    if service.now() < Timestamp::UNIX_EPOCH {
        return Err(format!(
            "the clock of this machine shows {}, which no HTTP date can represent; set it, e.g. with timedatectl set-ntp true",
            service.now()
        )
        .into());
    }
    let stopped = Arc::clone(&service);
    let server = Server::bind(config, service)
        .map_err(|error| format!("cannot listen on {}: {error}; is another service running there?", config.listen))?;
    let address = server.address();
    tracing::info!(%address, data = %config.data.display(), version = env!("CARGO_PKG_VERSION"), "listening on http://{address}");
    tokio::spawn(stop_on_signal(server.stopper(), stopped));
    server.serve().await?;
    tracing::info!("stopped");
    Ok(())
}

/// Opens the service on the configured folder with the configured devices; also returns the simulation, if any device is simulated.
pub(super) async fn open_service(config: &Config) -> Result<(Arc<Service>, Option<World>), Box<dyn Error>> {
    let equipment = Equipment::of(&config.cell)?;
    let world = equipment.as_ref().and_then(|equipment| equipment.world.clone());
    let opened = Service::open_with(&config.data, Capacity::from_config(config), config.estimation, equipment).await;
    let service = opened.map_err(|error| match error {
        ServiceError::Store(StoreError::FileUnavailable { path, source }) => format!(
            "the data folder {} cannot be used: {}: {source}; give this user the right to write there, or another folder \
             with --data FOLDER",
            config.data.display(),
            path.display()
        )
        .into(),
        error => Box::<dyn Error>::from(error),
    })?;
    Ok((service, world))
}

/// SIGTERM and SIGINT end the service; motions are stopped before anything else. A second signal changes nothing, because the time
/// for the shutdown is limited anyway.
pub(super) async fn stop_on_signal(stopper: Stopper, service: Arc<Service>) {
    let (terminate, interrupt) = (signal(SignalKind::terminate()), signal(SignalKind::interrupt()));
    let (Ok(mut terminate), Ok(mut interrupt)) = (terminate, interrupt) else {
        tracing::error!("signals cannot be received; the service can only be ended by SIGKILL");
        return;
    };
    tokio::select! {
        _ = terminate.recv() => tracing::info!("SIGTERM: motion is stopped, requests under way are finished"),
        _ = interrupt.recv() => tracing::info!("SIGINT: motion is stopped, requests under way are finished"),
    }
    service.stop_motion().await;
    stopper.stop();
}

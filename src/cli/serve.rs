//! `coaxis serve`: the service until it is told to stop.

use super::Outcome;
use super::config::Sources;
use crate::config::{Config, Log, LogFormat};
use crate::http::{Server, Stopper};
use crate::service::{Capacity, Service, ServiceError};
use crate::store::StoreError;
use std::error::Error;
use std::io::IsTerminal;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

/// Serve measurements over HTTP until interrupted
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    sources: Sources,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let config = arguments.sources.config()?;
    start_log(&config.log)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let outcome = runtime.block_on(serve(&config));
    // A thread that waits for a client must not keep the process from ending.
    runtime.shutdown_timeout(Duration::from_millis(500));
    outcome.map(|()| ExitCode::SUCCESS)
}

async fn serve(config: &Config) -> Result<(), Box<dyn Error>> {
    let service = open_service(config).await?;
    let server = Server::bind(config, service)
        .map_err(|error| format!("cannot listen on {}: {error}; is another service running there?", config.listen))?;
    let address = server.address();
    tracing::info!(%address, data = %config.data.display(), version = env!("CARGO_PKG_VERSION"), "listening on http://{address}");
    tokio::spawn(stop_on_signal(server.stopper()));
    server.serve().await?;
    tracing::info!("stopped");
    Ok(())
}

/// The service on the folder that the configuration names.
pub(super) async fn open_service(config: &Config) -> Result<Arc<Service>, Box<dyn Error>> {
    Service::open(&config.data, Capacity::from_config(config), config.estimation).await.map_err(|error| match error {
        ServiceError::Store(StoreError::FileUnavailable { path, source }) => format!(
            "the data folder {} cannot be used: {}: {source}; give this user the right to write there, or another folder \
             with --data FOLDER",
            config.data.display(),
            path.display()
        )
        .into(),
        error => error.into(),
    })
}

/// SIGTERM and SIGINT end the service; a second one changes nothing, the time for it is bounded anyway.
pub(super) async fn stop_on_signal(stopper: Stopper) {
    let (terminate, interrupt) = (signal(SignalKind::terminate()), signal(SignalKind::interrupt()));
    let (Ok(mut terminate), Ok(mut interrupt)) = (terminate, interrupt) else {
        tracing::error!("signals cannot be received; the service has to be killed to end");
        return;
    };
    tokio::select! {
        _ = terminate.recv() => tracing::info!("SIGTERM: requests under way are finished"),
        _ = interrupt.recv() => tracing::info!("SIGINT: requests under way are finished"),
    }
    stopper.stop();
}

pub(super) fn start_log(log: &Log) -> Result<(), Box<dyn Error>> {
    let filter = EnvFilter::try_new(&log.filter).map_err(|error| format!("log.filter = {:?}: {error}", log.filter))?;
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    match log.format {
        LogFormat::Text => lines.init(),
        LogFormat::Json => lines.json().flatten_event(true).init(),
    }
    Ok(())
}

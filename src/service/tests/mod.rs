//! Waiting and refusals when the pool is busy: replays, measurements, pictures and uploads.

mod cell;
mod unreadable;

use super::*;
use crate::config::Config;
use crate::plot::Picture;
use crate::scan::decode::Format;
use crate::scan::encode::encode;
use crate::scan::synthetic::{Part, make};
use crate::store::{Filter, Page};
use std::path::PathBuf;
use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering;
use std::sync::mpsc;
use tokio::task::JoinHandle;

/// Temporary folder of a test, deleted at its end.
struct TempFolder(PathBuf);

impl TempFolder {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("coaxis-service-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }
}

impl Drop for TempFolder {
    fn drop(&mut self) {
        // The store may be deleting its log at this moment.
        let _ = (0..100).find(|_| std::fs::remove_dir_all(&self.0).is_ok());
    }
}

/// A service with one measurement and one picture at a time, and no queue.
async fn open(folder: &TempFolder) -> Arc<Service> {
    open_with(folder, |_| {}).await
}

async fn open_with(folder: &TempFolder, change: impl FnOnce(&mut crate::config::Limits)) -> Arc<Service> {
    let mut config = Config::default();
    let limits = &mut config.limits;
    (limits.threads, limits.measurements_running_max, limits.queue_max) = (2, 1, 0);
    (limits.pictures_running_max, limits.pictures_queue_max, limits.uploads_max) = (1, 0, 1);
    change(limits);
    Service::open(&folder.0, Capacity::from_config(&config), Settings::default()).await.expect("a store")
}

fn ply(profiles_count: usize) -> Vec<u8> {
    let part = Part { profiles_count, points_count: 50, length_mm: 40.0, ..Part::smooth(2) };
    let mut bytes = Vec::new();
    encode(&make(&part).expect("a scan").0, Format::Ply, &mut bytes).expect("written");
    bytes
}

/// Large enough to be decoded during the upload.
fn large_ply() -> Vec<u8> {
    let bytes = ply(500);
    assert!(bytes.len() > crate::service::measuring::copying_reader::READ_BLOCK_BYTES, "{}", bytes.len());
    bytes
}

async fn begin(service: &Service, bytes: &[u8], order: MeasurementOrder) -> Result<Upload, ServiceError> {
    let accepted = service.accept(order).await.expect("a free place");
    let mut upload = service.measuring.begin_upload(None, None, Origin::default(), accepted).await?;
    upload.write(bytes).await.expect("space");
    Ok(upload)
}

fn order(request_id: &str) -> MeasurementOrder {
    MeasurementOrder { request_id: Some(request_id.to_owned()), ..MeasurementOrder::default() }
}

async fn measure_once(service: &Arc<Service>, order: MeasurementOrder) -> Answer {
    let upload = begin(service, &ply(5), order).await.expect("space");
    let arrived = service.measuring.complete_upload(upload).await.expect("complete");
    service.measuring.measure_upload(arrived).await.expect("measured")
}

/// Occupies the only place of a queue until the sender is dropped.
async fn occupy(queue: &Compute) -> (mpsc::Sender<()>, JoinHandle<()>) {
    let (end, ended) = mpsc::channel::<()>();
    let held = queue.clone();
    let held = tokio::spawn(async move {
        let _ = held.run(move |_| ended.recv()).await;
    });
    while queue.load().running_count == 0 {
        tokio::task::yield_now().await;
    }
    (end, held)
}

#[tokio::test]
async fn a_replay_needs_no_free_place() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let first = measure_once(&service, order("first")).await;
    let (end, held) = occupy(&service.measuring.compute).await;
    let refused = service.accept(order("second")).await.expect_err("no place");
    assert!(matches!(refused, ServiceError::Compute(ComputeError::Busy { .. })), "{refused}");
    let again = measure_once(&service, order("first")).await;
    assert_eq!((again.measurement, again.replayed), (first.measurement, true));
    drop(end);
    held.await.expect("joined");
}

#[tokio::test]
async fn pictures_and_measurements_have_separate_places() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let id = measure_once(&service, order("first")).await.measurement.id;
    let (end, held) = occupy(&service.measuring.compute).await;
    picture(&service, &id).await.expect("drawn beside a measurement");
    drop(end);
    held.await.expect("joined");
    let (end, held) = occupy(&service.measuring.drawing).await;
    let refused = picture(&service, &id).await.expect_err("none may wait");
    assert!(matches!(refused, ServiceError::Compute(ComputeError::Busy { .. })), "{refused}");
    assert!(!measure_once(&service, order("second")).await.replayed);
    drop(end);
    held.await.expect("joined");
}

#[tokio::test]
async fn an_upload_has_its_place_until_it_is_stored_or_dropped() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let upload = async || begin(&service, &ply(5), MeasurementOrder::default()).await;
    let begun = upload().await.expect("a place");
    let refused = upload().await.expect_err("taken");
    assert!(matches!(refused, ServiceError::UploadsBusy { uploads_max: 1 }), "{refused}");
    drop(begun);
    let arrived = service.measuring.complete_upload(upload().await.expect("free")).await.expect("complete");
    upload().await.expect_err("the arrived scan still occupies the place");
    service.measuring.store_scan(arrived).await.expect("kept");
    upload().await.expect("free again");
}

#[tokio::test]
async fn a_large_upload_is_read_on_arrival_and_one_without_a_place_afterwards() {
    let folder = TempFolder::new();
    let service = open_with(&folder, |limits| limits.uploads_max = 3).await;
    let bytes = large_ply();
    let first = begin(&service, &bytes, MeasurementOrder::default()).await.expect("space");
    let second = begin(&service, &bytes, MeasurementOrder::default()).await.expect("space");
    let small = begin(&service, &ply(5), MeasurementOrder::default()).await.expect("space");
    let first = service.measuring.complete_upload(first).await.expect("complete");
    let second = service.measuring.complete_upload(second).await.expect("complete");
    let small = service.measuring.complete_upload(small).await.expect("complete");
    assert_eq!([&first, &second, &small].map(|arrived| arrived.read.is_some()), [true, false, false]);
    let [first, second] =
        [service.measuring.measure_upload(first).await, service.measuring.measure_upload(second).await]
            .map(|answer| answer.expect("measured").measurement);
    assert_eq!((&first.result, &first.scan_sha256), (&second.result, &second.scan_sha256));
    let third = begin(&service, &bytes, MeasurementOrder::default()).await.expect("space");
    let third = service.measuring.complete_upload(third).await.expect("complete");
    assert!(third.read.is_some(), "the place is free again");
}

#[tokio::test]
async fn a_scan_is_read_before_its_end_arrives() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let bytes = [b"Dear Sir or Madam,\n".repeat(10), large_ply()].concat();
    let upload = begin(&service, &bytes, MeasurementOrder::default()).await.expect("space");
    // No more bytes arrive, and the reader still detects that these are not a scan.
    while !upload.is_read() {
        tokio::task::yield_now().await;
    }
    let arrived = service.measuring.complete_upload(upload).await.expect("complete");
    let refused = service.measuring.measure_upload(arrived).await.expect_err("no scan");
    assert!(matches!(refused, ServiceError::Content(ContentError::Scan(_))), "{refused}");
}

#[tokio::test]
async fn a_replay_is_not_read() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let mut replayed = Vec::new();
    for _ in 0..2 {
        let upload = begin(&service, &large_ply(), order("large")).await.expect("space");
        let arrived = service.measuring.complete_upload(upload).await.expect("complete");
        let read = arrived.read.is_some();
        replayed.push((read, service.measuring.measure_upload(arrived).await.expect("answered").replayed));
    }
    assert_eq!(replayed, [(true, false), (false, true)]);
}

#[tokio::test]
async fn a_store_that_fails_during_an_upload_is_reported_as_that() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let upload = begin(&service, &large_ply(), MeasurementOrder::default()).await.expect("space");
    std::fs::remove_dir_all(folder.0.join("scans")).expect("removed");
    let told = match service.measuring.complete_upload(upload).await {
        Ok(arrived) => service.measuring.measure_upload(arrived).await.expect_err("its file is gone"),
        Err(error) => error,
    };
    assert!(matches!(told, ServiceError::Store(_)), "{told}");
}

#[tokio::test]
async fn a_command_is_recorded_with_the_lease_that_authorised_it_and_a_stop_with_none() {
    let folder = TempFolder::new();
    let config = Config::default();
    let equipment = Equipment::of(&config.cell).expect("devices");
    let capacity = Capacity::from_config(&config);
    let service = Service::open_with(&folder.0, capacity, Settings::default(), equipment).await.expect("a store");
    let first = service.operating.take_lease("first".to_owned(), None).await.expect("a lease");
    let by = service.operating.authorise(&first.id, None).await.expect("the lease is valid");
    // The lease changes hands before the command is recorded.
    service.operating.release_lease(&first.id).await.expect("released");
    assert!(!service.operating.holds_lease(&first.id));
    let second = service.operating.take_lease("second".to_owned(), None).await.expect("a lease");
    assert_eq!(by, Commander { holder: Some("first".to_owned()), fence: Some(first.fence) });
    assert!(service.operating.authorise(&first.id, None).await.is_err());
    assert!(service.operating.holds_lease(&second.id) && !service.operating.holds_lease(&first.id));
    service.operating.stop().await.expect("a cell");
    service.shared.background.finish(std::time::Duration::from_secs(10)).await;
    let page = crate::store::Page { limit: 10, before: None };
    let rows = service.shared.store.jobs("act", None, &page).await.expect("readable").rows;
    let document: serde_json::Value = serde_json::from_str(&rows[0].document).expect("JSON");
    let stop = &document["content"];
    assert_eq!((&stop["verb"], &stop["holder"], &stop["fence"]), (&"stop".into(), &().into(), &().into()), "{stop}");
    service.close().await;
}

async fn picture(service: &Service, id: &str) -> Result<String, ServiceError> {
    let measurement = service.operating.measurement(id).await?;
    service.measuring.picture(measurement, Picture::Centres, None, None).await
}

//! Who has to wait for whom: replays, measurements, pictures and uploads when the pool is taken.

use super::*;
use crate::plot::Picture;
use crate::scan::decode::Format;
use crate::scan::encode::encode;
use crate::scan::synthetic::{Part, make};
use std::path::PathBuf;
use std::sync::atomic::AtomicU32;
use std::sync::mpsc;
use tokio::task::JoinHandle;

/// A folder of one test, removed at its end.
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
        // The store may just be taking its log away.
        let _ = (0..100).find(|_| std::fs::remove_dir_all(&self.0).is_ok());
    }
}

/// One measurement and one picture at a time, none that waits.
async fn open(folder: &TempFolder) -> Arc<Service> {
    let mut config = Config::default();
    let limits = &mut config.limits;
    (limits.threads, limits.measurements_running_max, limits.queue_max) = (2, 1, 0);
    (limits.pictures_running_max, limits.pictures_queue_max, limits.uploads_max) = (1, 0, 1);
    Service::open(&folder.0, Capacity::from_config(&config), Settings::default()).await.expect("a store")
}

async fn upload(service: &Service) -> Arrived {
    let part = Part { profiles_count: 5, points_count: 50, length_mm: 40.0, ..Part::smooth(2) };
    let mut bytes = Vec::new();
    encode(&make(&part).expect("a scan").0, Format::Ply, &mut bytes).expect("written");
    let mut upload = service.begin_upload(None).await.expect("room");
    upload.write(&bytes).await.expect("room");
    service.complete_upload(upload).await.expect("complete")
}

fn order(request_id: &str) -> Order {
    Order { request_id: Some(request_id.to_owned()), ..Order::default() }
}

async fn measure_once(service: &Service, order: Order) -> Answer {
    let accepted = service.accept(order).await.expect("a free place");
    service.measure_upload(upload(service).await, Origin::default(), accepted).await.expect("measured")
}

/// Takes a door's only place until the sender is dropped.
async fn occupy(door: &Compute) -> (mpsc::Sender<()>, JoinHandle<()>) {
    let (end, ended) = mpsc::channel::<()>();
    let held = door.clone();
    let held = tokio::spawn(async move {
        let _ = held.run(move || ended.recv()).await;
    });
    while door.load().running_count == 0 {
        tokio::task::yield_now().await;
    }
    (end, held)
}

#[tokio::test]
async fn a_replay_needs_no_free_place() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let first = measure_once(&service, order("first")).await;
    let (end, held) = occupy(&service.compute).await;
    let refused = service.accept(order("second")).await.expect_err("no place");
    assert!(matches!(refused, ServiceError::Compute(ComputeError::Busy { .. })), "{refused}");
    let again = measure_once(&service, order("first")).await;
    assert_eq!((again.measurement, again.replayed), (first.measurement, true));
    drop(end);
    held.await.expect("joined");
}

#[tokio::test]
async fn pictures_and_measurements_take_no_place_from_each_other() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let id = measure_once(&service, order("first")).await.measurement.id;
    let (end, held) = occupy(&service.compute).await;
    service.picture(&id, Picture::Centres, None, None).await.expect("drawn beside a measurement");
    drop(end);
    held.await.expect("joined");
    let (end, held) = occupy(&service.drawing).await;
    let refused = service.picture(&id, Picture::Centres, None, None).await.expect_err("none may wait");
    assert!(matches!(refused, ServiceError::Compute(ComputeError::Busy { .. })), "{refused}");
    assert!(!measure_once(&service, order("second")).await.replayed);
    drop(end);
    held.await.expect("joined");
}

#[tokio::test]
async fn an_upload_has_its_place_until_it_is_kept_or_let_go() {
    let folder = TempFolder::new();
    let service = open(&folder).await;
    let begun = service.begin_upload(None).await.expect("a place");
    let refused = service.begin_upload(None).await.expect_err("taken");
    assert!(matches!(refused, ServiceError::UploadsBusy { uploads_max: 1 }), "{refused}");
    drop(begun);
    let arrived = upload(&service).await;
    service.begin_upload(None).await.expect_err("what has arrived lies there still");
    service.store_scan(arrived, Origin::default()).await.expect("kept");
    service.begin_upload(None).await.expect("free again");
}

//! The guarantees of the store, tested from outside, one file for each. The tests create their rows in folders of their own.

mod durability;
mod records;
mod scan_files;
mod schema;

use std::{
    env, fs,
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use jiff::Timestamp;

use super::repository::Store;
use super::{CompleteScan, MeasurementRow, NewMeasurement, RequestKey, ScanRow};

/// The folder of a test, removed at its end.
struct TempFolder(PathBuf);

impl TempFolder {
    fn new() -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = env::temp_dir().join(format!("coaxis-store-{}-{number}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    async fn open(&self) -> Store {
        Store::open(self.path()).await.unwrap()
    }

    fn path(&self) -> &Path {
        &self.0
    }

    /// Ids of the scans in their final place.
    fn scan_ids(&self) -> Vec<String> {
        let names = |folder: PathBuf| {
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap())
        };
        let shelves = names(self.0.join("scans")).filter(|shelf| shelf != "tmp");
        shelves.flat_map(|shelf| names(self.0.join("scans").join(shelf))).map(|name| format!("s-{name}")).collect()
    }

    /// File names of the scans that are still being received.
    fn incoming(&self) -> Vec<String> {
        let entries = fs::read_dir(self.0.join("scans/tmp")).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }
}

impl Drop for TempFolder {
    fn drop(&mut self) {
        // A store that was not closed removes its log by itself, perhaps between listing and removing the files here.
        let _ = (0..100).find(|_| fs::remove_dir_all(&self.0).is_ok());
    }
}

fn at(second: i64) -> Timestamp {
    Timestamp::from_second(1_800_000_000 + second).unwrap()
}

/// The id of a scan that is not stored.
fn scan_id(digit: char) -> String {
    format!("s-{}", digit.to_string().repeat(64))
}

fn scan_row(digit: char) -> ScanRow {
    ScanRow {
        id: scan_id(digit),
        created_at: at(0),
        bytes_count: 77_000_000,
        format: "ply".into(),
        points_count: Some(2_000_000),
        description: None,
        arrival: None,
    }
}

/// The row of a received scan.
fn row_of(scan: &CompleteScan) -> ScanRow {
    ScanRow { id: scan.id(), bytes_count: scan.bytes_count(), ..scan_row('a') }
}

fn measurement_row(id: &str, second: i64) -> MeasurementRow {
    MeasurementRow {
        id: id.into(),
        created_at: at(second),
        verdict: "accepted".into(),
        method: "cylinder".into(),
        scan_id: scan_id('a'),
        recipe: None,
        document: format!(r#"{{"id":"{id}"}}"#),
    }
}

/// A measurement of scan `a`, which is inserted with it.
fn new_measurement(id: &str, second: i64) -> NewMeasurement {
    NewMeasurement {
        row: measurement_row(id, second),
        scan: Some(scan_row('a')),
        profiles: id.as_bytes().to_vec(),
        request: None,
    }
}

fn request(id: &str, fingerprint: &str) -> Option<RequestKey> {
    Some(RequestKey { id: id.into(), fingerprint: fingerprint.into() })
}

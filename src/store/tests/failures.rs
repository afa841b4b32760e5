//! Full, broken and contested: the named reason, reads that go on, recovery without a restart, nothing half done.

use std::io;

use sqlx::SqliteConnection;

use super::*;
use crate::store::{Inserted, Precondition, StoreError, StoreLimits, writer::Write};

/// A statement of the test's own, on the connection that writes.
pub(super) struct Statement(pub(super) &'static str);

impl Write for Statement {
    type Outcome = ();

    async fn apply(&self, database: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::raw_sql(self.0).execute(database).await?;
        Ok(())
    }
}

/// 100 kB.
fn large(number: i64) -> NewMeasurement {
    NewMeasurement { profiles: vec![0; 100_000], ..new_measurement(&format!("m-{number}"), number) }
}

/// Has room for its tables and one large measurement.
async fn small_store(folder: &TempFolder) -> Store {
    let limits = StoreLimits { database_bytes_max: Some(250_000) };
    let store = Store::open_within(folder.path(), limits).await.unwrap();
    store.insert_measurement(large(0)).await.unwrap();
    store
}

#[tokio::test]
async fn a_full_database_refuses_writes_reads_on_and_recovers() {
    let folder = TempFolder::new();
    let store = small_store(&folder).await;
    for number in 1..5 {
        let error = store.insert_measurement(large(number)).await.unwrap_err();
        assert!(matches!(error, StoreError::Full), "{error:?}");
        assert_eq!((error.code(), error.is_transient()), ("store_full", true));
        assert!(store.measurement("m-0").await.unwrap().is_some());
        assert_eq!(store.measurement(&format!("m-{number}")).await.unwrap(), None);
    }
    store.writer.write(Statement("DELETE FROM profiles")).await.unwrap();
    assert_eq!(store.insert_measurement(large(1)).await.unwrap(), Inserted::New);
}

#[tokio::test]
async fn a_small_write_is_done_though_a_large_one_beside_it_finds_no_room() {
    let folder = TempFolder::new();
    let store = small_store(&folder).await;
    let (large, small) =
        tokio::join!(store.insert_measurement(large(1)), store.put_recipe("flange", "{}", at(1), Precondition::None),);
    assert!(matches!(large, Err(StoreError::Full)));
    small.unwrap();
}

#[tokio::test]
async fn after_a_failure_the_database_is_opened_again() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    // Its own commit is counted, which is a write already.
    let error = store.writer.write(Statement("PRAGMA query_only = ON")).await.unwrap_err();
    assert!(matches!(error, StoreError::Unavailable(_)), "{error:?}");
    assert_eq!(store.insert_measurement(new_measurement("m-1", 1)).await.unwrap(), Inserted::New);
}

#[tokio::test]
async fn a_refused_write_does_not_harm_those_that_share_its_commit() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let orphan = || NewMeasurement { scan: None, ..new_measurement("m-1", 1) };
    let (first, refused, last) = tokio::join!(
        store.put_recipe("a", "{}", at(1), Precondition::None),
        store.insert_measurement(orphan()),
        store.insert_measurement(new_measurement("m-2", 2)),
    );
    first.unwrap();
    assert!(matches!(refused, Err(StoreError::ScanUnknown { .. })));
    assert_eq!(last.unwrap(), Inserted::New);
    assert_eq!(store.measurement("m-1").await.unwrap(), None);
    assert!(store.profiles("m-2").await.unwrap().is_some());
}

#[tokio::test]
async fn a_caller_that_goes_away_does_not_halve_its_write() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    tokio::select! {
        biased;
        _ = store.insert_measurement(new_measurement("m-1", 1)) => panic!("the writer has not run yet"),
        () = std::future::ready(()) => {}
    }
    store.insert_measurement(new_measurement("m-2", 2)).await.unwrap();
    assert!(store.measurement("m-1").await.unwrap().is_some());
    assert!(store.profiles("m-1").await.unwrap().is_some());
}

#[tokio::test]
async fn writes_that_wait_are_finished_before_closing_and_later_ones_refused() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let (waiting, ()) = tokio::join!(store.insert_measurement(new_measurement("m-1", 1)), store.close());
    assert_eq!(waiting.unwrap(), Inserted::New);
    let refused = store.insert_measurement(new_measurement("m-2", 2)).await;
    assert!(matches!(refused, Err(StoreError::Closed)));
    assert!(matches!(store.measurement("m-1").await, Err(StoreError::Closed)));
    store.close().await;
}

#[tokio::test]
async fn a_folder_that_vanished_is_told_by_probe_and_by_scans_until_it_is_back() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    store.probe().await.unwrap();
    let incoming = folder.path().join("scans/tmp");
    fs::remove_dir(&incoming).unwrap();
    assert!(matches!(store.probe().await, Err(StoreError::FileUnavailable { .. })));
    assert!(matches!(store.begin_scan(10).await, Err(StoreError::FileUnavailable { .. })));
    fs::create_dir(&incoming).unwrap();
    store.probe().await.unwrap();
    assert!(folder.incoming().is_empty());
}

#[tokio::test]
async fn a_scan_that_finds_no_place_leaves_nothing_and_can_be_sent_again() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    // SHA-256 of no bytes begins with e3.
    let shelf = folder.path().join("scans/e3");
    fs::write(&shelf, b"in the way").unwrap();
    let scan = store.begin_scan(10).await.unwrap().complete().await.unwrap();
    let failed = store.keep_scan(row_of(&scan), scan).await;
    assert!(matches!(failed, Err(StoreError::FileUnavailable { .. })));
    assert!(folder.incoming().is_empty());
    fs::remove_file(&shelf).unwrap();
    let scan = store.begin_scan(10).await.unwrap().complete().await.unwrap();
    store.keep_scan(row_of(&scan), scan).await.unwrap();
}

#[test]
fn a_full_disk_and_a_full_quota_have_one_name() {
    for kind in [io::ErrorKind::StorageFull, io::ErrorKind::QuotaExceeded] {
        assert!(matches!(StoreError::of_file("scans")(kind.into()), StoreError::Full));
    }
    let read_only = StoreError::of_file("scans")(io::ErrorKind::ReadOnlyFilesystem.into());
    assert_eq!(read_only.code(), "store_unavailable");
}

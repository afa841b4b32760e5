//! A scan's file and its row: both or neither, whatever fails in between.

use super::*;
use crate::store::{Inserted, StoreError, hex};
use sha2::{Digest, Sha256};

async fn arrived(store: &Store, bytes: &[u8]) -> CompleteScan {
    let mut writer = store.begin_scan(u64::MAX).await.unwrap();
    writer.write(bytes).await.unwrap();
    writer.complete().await.unwrap()
}

/// A measurement of what has come in.
fn measurement_of(scan: &CompleteScan, id: &str) -> NewMeasurement {
    let mut new = new_measurement(id, 1);
    new.row.scan_id = scan.id();
    new.scan = Some(row_of(scan));
    new
}

#[tokio::test]
async fn a_measurement_that_is_not_inserted_leaves_no_file() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    store.insert_measurement(new_measurement("m-1", 1)).await.unwrap();
    let scan = arrived(&store, b"first").await;
    let taken = store.insert_measurement_of(measurement_of(&scan, "m-1"), scan).await;
    assert!(matches!(taken, Err(StoreError::IdTaken { .. })));
    assert_eq!((folder.scan_ids(), folder.incoming()), (Vec::new(), Vec::new()));
}

#[tokio::test]
async fn a_request_id_used_for_something_else_leaves_no_file() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let earlier = NewMeasurement { request: request("r", "asked"), ..new_measurement("m-1", 1) };
    store.insert_measurement(earlier).await.unwrap();
    let scan = arrived(&store, b"first").await;
    let new = NewMeasurement { request: request("r", "asked for more"), ..measurement_of(&scan, "m-2") };
    assert_eq!(store.insert_measurement_of(new, scan).await.unwrap(), Inserted::RequestMismatch);
    assert_eq!((folder.scan_ids(), folder.incoming()), (Vec::new(), Vec::new()));
}

#[tokio::test]
async fn a_failure_takes_no_file_that_another_row_refers_to() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    store.insert_measurement(new_measurement("m-1", 1)).await.unwrap();
    let (kept, refused) = (arrived(&store, b"both").await, arrived(&store, b"both").await);
    let id = kept.id();
    // They share a commit, or come one after the other.
    let (kept, refused) = tokio::join!(
        store.insert_measurement_of(measurement_of(&kept, "m-2"), kept),
        store.insert_measurement_of(measurement_of(&refused, "m-1"), refused),
    );
    assert_eq!(kept.unwrap(), Inserted::New);
    refused.unwrap_err();
    assert_eq!((folder.scan_ids(), folder.incoming()), (vec![id], Vec::new()));
}

#[tokio::test]
async fn a_caller_that_goes_away_leaves_file_and_row_or_neither() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let scan = arrived(&store, b"abandoned").await;
    let id = scan.id();
    let mut keep = Box::pin(store.keep_scan(row_of(&scan), scan));
    // As far as it comes by itself, and no further.
    std::future::poll_fn(|context| std::task::Poll::Ready(keep.as_mut().poll(context).is_pending())).await;
    drop(keep);
    store.probe().await.unwrap();
    assert_eq!(store.scan(&id).await.unwrap().is_some(), folder.scan_ids() == [id]);
}

#[tokio::test]
async fn a_file_whose_row_a_crash_prevented_is_removed_at_the_next_start_and_no_other() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let scan = arrived(&store, b"kept").await;
    let kept = scan.id();
    store.keep_scan(row_of(&scan), scan).await.unwrap();
    store.close().await;
    drop(store);
    let place = |bytes: &[u8], marked: bool| {
        let digest = hex(&Sha256::digest(bytes));
        let shelf = folder.path().join("scans").join(&digest[..2]);
        fs::create_dir_all(&shelf).unwrap();
        fs::write(shelf.join(&digest), bytes).unwrap();
        if marked {
            fs::write(folder.path().join("scans/tmp").join(&digest), b"").unwrap();
        }
        format!("s-{digest}")
    };
    place(b"orphan", true);
    assert_eq!(place(b"kept", true), kept);
    // Its row was lost with a database, which is no reason to lose the scan, too.
    let unmarked = place(b"rescued", false);
    let _store = folder.open().await;
    let mut expected = vec![kept, unmarked];
    let mut found = folder.scan_ids();
    expected.sort();
    found.sort();
    assert_eq!((found, folder.incoming()), (expected, Vec::new()));
}

//! Files of scans: complete or absent, readable while they are written, and stored together with their row or not at all, at
//! whatever step a failure occurs.

use super::*;
use crate::store::rows::hex;
use crate::store::{Inserted, StoreError};
use sha2::{Digest, Sha256};
use std::io::{ErrorKind, Read as _};

/// Bytes whose pattern does not repeat with the length of a block.
fn content(length: usize) -> Vec<u8> {
    (0..length).map(|index| (index % 251) as u8).collect()
}

async fn store_scan(store: &Store, bytes: &[u8], piece: usize) -> ScanRow {
    let mut writer = store.begin_scan(u64::MAX).await.unwrap();
    for piece in bytes.chunks(piece) {
        writer.write(piece).await.unwrap();
    }
    let scan = writer.complete().await.unwrap();
    let row = row_of(&scan);
    store.keep_scan(row.clone(), scan).await.unwrap();
    row
}

#[tokio::test]
async fn a_scan_is_stored_unchanged_for_any_size_of_pieces() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let block = 256 * 1024;
    for length in [0, 1, block - 1, block, block + 1, 3 * block + 17] {
        let bytes = content(length);
        for piece in [4_093, block, 10 * block] {
            let stored = store_scan(&store, &bytes, piece).await;
            assert_eq!(stored.id, format!("s-{}", hex(&Sha256::digest(&bytes))));
            assert_eq!(stored.bytes_count, length as u64);
            let mut read = Vec::new();
            store.open_scan(&stored.id).await.unwrap().unwrap().read_to_end(&mut read).unwrap();
            assert_eq!(read, bytes);
        }
    }
    assert!(folder.incoming().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_bytes_sent_simultaneously_are_one_file() {
    let folder = TempFolder::new();
    let store = std::sync::Arc::new(folder.open().await);
    let mut clients = tokio::task::JoinSet::new();
    for client in 0..8 {
        let store = std::sync::Arc::clone(&store);
        clients.spawn(async move { store_scan(&store, &content(600_000), 10_000 + client).await });
    }
    let stored = clients.join_all().await;
    assert!(stored.iter().all(|scan| scan.id == stored[0].id));
    let shelf = store.scan_path(&stored[0].id).unwrap().parent().unwrap().to_owned();
    assert_eq!(fs::read_dir(shelf).unwrap().count(), 1);
}

#[tokio::test]
async fn a_truncated_file_is_repaired_by_the_same_bytes() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let stored = store_scan(&store, &content(1000), 1000).await;
    let path = store.scan_path(&stored.id).unwrap();
    fs::write(&path, b"cut").unwrap();
    store_scan(&store, &content(1000), 1000).await;
    assert_eq!(fs::read(&path).unwrap(), content(1000));
}

#[tokio::test]
async fn a_damaged_file_is_not_opened_and_the_same_bytes_repair_it() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let stored = store_scan(&store, &content(1000), 1000).await;
    let path = store.scan_path(&stored.id).unwrap();
    let mut bytes = content(1000);
    bytes[500] ^= 1;
    fs::write(&path, &bytes).unwrap();
    let refused = store.open_scan(&stored.id).await.unwrap_err();
    let found = hex(&Sha256::digest(&bytes));
    assert!(
        matches!(&refused, StoreError::ScanDamaged { id, found_sha256 } if *id == stored.id && *found_sha256 == found)
    );
    store_scan(&store, &content(1000), 1000).await;
    let mut read = Vec::new();
    store.open_scan(&stored.id).await.unwrap().unwrap().read_to_end(&mut read).unwrap();
    assert_eq!(read, content(1000));
    fs::remove_file(&path).unwrap();
    assert!(store.open_scan(&stored.id).await.unwrap().is_none());
    store_scan(&store, &content(1000), 1000).await;
    assert!(store.open_scan(&stored.id).await.unwrap().is_some());
    assert!(folder.incoming().is_empty());
}

#[tokio::test]
async fn only_a_few_files_are_compared_at_the_same_time() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let stored = store_scan(&store, &content(1000), 1000).await;
    let turns_count = u32::try_from(store.comparing.available_permits()).unwrap();
    let turns = store.comparing.acquire_many(turns_count).await.unwrap();
    let opened = store.open_scan(&stored.id);
    tokio::pin!(opened);
    let soon = std::time::Duration::from_millis(50);
    assert!(tokio::time::timeout(soon, &mut opened).await.is_err(), "all permits are in use");
    drop(turns);
    assert!(opened.await.unwrap().is_some());
    assert_eq!(store.comparing.available_permits(), turns_count as usize);
}

#[tokio::test]
async fn a_scan_whose_commit_failed_can_be_kept_with_the_same_file_later() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let mut writer = store.begin_scan(100).await.unwrap();
    writer.write(b"points").await.unwrap();
    let scan = std::sync::Arc::new(writer.complete().await.unwrap());
    // The file is already in its final place when the count of the transaction fails.
    let refuse =
        "CREATE TRIGGER refuse BEFORE UPDATE ON commits WHEN NEW.count > 1 BEGIN SELECT RAISE(ABORT, 'no'); END";
    store.writer.write(super::durability::Statement(refuse)).await.unwrap();
    store.keep_scan(row_of(&scan), std::sync::Arc::clone(&scan)).await.unwrap_err();
    assert_eq!(folder.scan_ids(), Vec::<String>::new());
    let mut database = crate::store::database::writer(&folder.path().join("coaxis.db"), None).await.unwrap();
    sqlx::raw_sql("DROP TRIGGER refuse").execute(&mut database).await.unwrap();
    store.keep_scan(row_of(&scan), std::sync::Arc::clone(&scan)).await.unwrap();
    assert!(store.open_scan(&scan.id()).await.unwrap().is_some());
    drop(scan);
    assert!(folder.incoming().is_empty());
}

#[tokio::test]
async fn a_text_that_is_not_a_scan_id_has_no_path() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let upper = scan_id('A');
    let foreign = ["", "s-", "s-ab", "../../etc/passwd", "s-../../../../etc/passwd", &scan_id('g'), &upper, "s-é"];
    let dots = format!("s-{}", "../".repeat(21) + "a");
    let bare = "a".repeat(64);
    for id in foreign.into_iter().chain([dots.as_str(), bare.as_str()]) {
        assert_eq!(store.scan_path(id), None, "{id}");
        assert!(store.open_scan(id).await.unwrap().is_none(), "{id}");
    }
    assert!(store.scan_path(&scan_id('a')).unwrap().starts_with(folder.path().join("scans/aa")));
    assert!(store.open_scan(&scan_id('a')).await.unwrap().is_none());
}

#[test]
fn an_abandoned_scan_leaves_no_file() {
    let folder = TempFolder::new();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let store = folder.open().await;
        let mut writer = store.begin_scan(u64::MAX).await.unwrap();
        assert_eq!(folder.incoming().len(), 1);
        // Blocks are still being written when the writer is dropped.
        writer.write(&content(3_000_000)).await.unwrap();
    });
    // Waits for the blocking threads.
    drop(runtime);
    assert!(folder.incoming().is_empty());
}

#[tokio::test]
async fn a_scan_beyond_its_limit_is_refused_and_leaves_no_file() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let mut writer = store.begin_scan(1000).await.unwrap();
    writer.write(&content(1000)).await.unwrap();
    assert!(matches!(writer.write(b"x").await, Err(StoreError::ScanTooLarge { bytes_max: 1000 })));
    assert!(matches!(writer.complete().await, Err(StoreError::Closed)));
    assert!(folder.incoming().is_empty());
}

#[tokio::test]
async fn unfinished_files_of_an_earlier_process_are_removed() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let stored = store_scan(&store, b"whole", 5).await;
    store.close().await;
    drop(store);
    fs::write(folder.path().join("scans/tmp/0"), b"half").unwrap();
    let store = folder.open().await;
    assert!(folder.incoming().is_empty());
    assert!(store.open_scan(&stored.id).await.unwrap().is_some());
}

const BLOCK: usize = 256 * 1024;

/// Bytes that do not repeat with the length of a block.
#[tokio::test]
async fn available_bytes_are_read_before_the_file_is_complete() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let bytes = content(3 * BLOCK + 17);
    let mut writer = store.begin_scan(u64::MAX).await.unwrap();
    let mut follower = writer.trail().follow().unwrap();
    let (start, end) = bytes.split_at(2 * BLOCK + 5);
    writer.write(start).await.unwrap();
    let (read, mut follower) = tokio::task::spawn_blocking(move || {
        let mut read = vec![0; 2 * BLOCK];
        follower.read_exact(&mut read).unwrap();
        (read, follower)
    })
    .await
    .unwrap();
    assert_eq!(read, bytes[..2 * BLOCK]);
    let rest = tokio::task::spawn_blocking(move || {
        let mut rest = Vec::new();
        follower.read_to_end(&mut rest).unwrap();
        rest
    });
    writer.write(end).await.unwrap();
    let trail = writer.trail();
    let scan = writer.complete().await.unwrap();
    assert_eq!(rest.await.unwrap(), bytes[2 * BLOCK..]);
    let mut late = Vec::new();
    trail.follow().unwrap().read_to_end(&mut late).unwrap();
    assert_eq!(late, bytes, "a complete file must be followed in the same way");
    drop(scan);
    assert!(matches!(trail.follow(), Err(StoreError::FileUnavailable { .. })));
}

#[tokio::test]
async fn dropping_a_writer_ends_its_reader() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let mut writer = store.begin_scan(u64::MAX).await.unwrap();
    let mut follower = writer.trail().follow().unwrap();
    writer.write(&content(BLOCK + 1)).await.unwrap();
    let reader = tokio::task::spawn_blocking(move || follower.read_to_end(&mut Vec::new()));
    drop(writer);
    assert_eq!(reader.await.unwrap().unwrap_err().kind(), ErrorKind::ConnectionAborted);
}

async fn arrived(store: &Store, bytes: &[u8]) -> CompleteScan {
    let mut writer = store.begin_scan(u64::MAX).await.unwrap();
    writer.write(bytes).await.unwrap();
    writer.complete().await.unwrap()
}

/// A measurement of a received scan.
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
async fn a_request_id_used_for_another_request_leaves_no_file() {
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
async fn a_failure_removes_no_file_that_another_row_refers_to() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    store.insert_measurement(new_measurement("m-1", 1)).await.unwrap();
    let (kept, refused) = (arrived(&store, b"both").await, arrived(&store, b"both").await);
    let id = kept.id();
    // They share a commit, or are committed one after the other.
    let (kept, refused) = tokio::join!(
        store.insert_measurement_of(measurement_of(&kept, "m-2"), kept),
        store.insert_measurement_of(measurement_of(&refused, "m-1"), refused),
    );
    assert_eq!(kept.unwrap(), Inserted::New);
    refused.unwrap_err();
    assert_eq!((folder.scan_ids(), folder.incoming()), (vec![id], Vec::new()));
}

#[tokio::test]
async fn a_dropped_caller_leaves_both_file_and_row_or_neither() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let scan = arrived(&store, b"abandoned").await;
    let id = scan.id();
    let mut keep = Box::pin(store.keep_scan(row_of(&scan), scan));
    // Polled once and then dropped.
    std::future::poll_fn(|context| std::task::Poll::Ready(keep.as_mut().poll(context).is_pending())).await;
    drop(keep);
    store.probe().await.unwrap();
    assert_eq!(store.scan(&id).await.unwrap().is_some(), folder.scan_ids() == [id]);
}

#[tokio::test]
async fn only_files_without_a_row_after_a_crash_are_removed_at_the_next_start() {
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
    // Its row was lost with a database, but the scan must be kept.
    let unmarked = place(b"rescued", false);
    let _store = folder.open().await;
    let mut expected = vec![kept, unmarked];
    let mut found = folder.scan_ids();
    expected.sort();
    found.sort();
    assert_eq!((found, folder.incoming()), (expected, Vec::new()));
}

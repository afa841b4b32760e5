//! Raw scans: whole and named by their content, or not there.

use std::io::Read as _;

use sha2::{Digest, Sha256};

use super::*;
use crate::store::{StoreError, hex};

/// Bytes that do not repeat with the length of a block.
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
async fn a_scan_comes_out_as_it_went_in_whatever_the_pieces() {
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
async fn the_same_bytes_are_one_file_even_when_sent_at_once() {
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
async fn a_file_cut_short_is_mended_by_the_same_bytes() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let stored = store_scan(&store, &content(1000), 1000).await;
    let path = store.scan_path(&stored.id).unwrap();
    fs::write(&path, b"cut").unwrap();
    store_scan(&store, &content(1000), 1000).await;
    assert_eq!(fs::read(&path).unwrap(), content(1000));
}

#[tokio::test]
async fn a_damaged_file_is_not_handed_out_and_the_same_bytes_repair_it() {
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
async fn a_few_files_are_compared_at_a_time_however_many_are_asked_for() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let stored = store_scan(&store, &content(1000), 1000).await;
    let turns_count = u32::try_from(store.comparing.available_permits()).unwrap();
    let turns = store.comparing.acquire_many(turns_count).await.unwrap();
    let opened = store.open_scan(&stored.id);
    tokio::pin!(opened);
    let soon = std::time::Duration::from_millis(50);
    assert!(tokio::time::timeout(soon, &mut opened).await.is_err(), "all turns are taken");
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
    // The file has its place already when the count of the transaction fails.
    let refuse =
        "CREATE TRIGGER refuse BEFORE UPDATE ON commits WHEN NEW.count > 1 BEGIN SELECT RAISE(ABORT, 'no'); END";
    store.writer.write(super::failures::Statement(refuse)).await.unwrap();
    store.keep_scan(row_of(&scan), std::sync::Arc::clone(&scan)).await.unwrap_err();
    assert_eq!(folder.scan_ids(), Vec::<String>::new());
    let mut database = crate::store::connection::writer(&folder.path().join("coaxis.db"), None).await.unwrap();
    sqlx::raw_sql("DROP TRIGGER refuse").execute(&mut database).await.unwrap();
    store.keep_scan(row_of(&scan), std::sync::Arc::clone(&scan)).await.unwrap();
    assert!(store.open_scan(&scan.id()).await.unwrap().is_some());
    drop(scan);
    assert!(folder.incoming().is_empty());
}

#[tokio::test]
async fn what_is_not_a_scans_id_never_becomes_a_path() {
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
fn an_abandoned_scan_leaves_nothing() {
    let folder = TempFolder::new();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let store = folder.open().await;
        let mut writer = store.begin_scan(u64::MAX).await.unwrap();
        assert_eq!(folder.incoming().len(), 1);
        // Blocks are still on their way to the disk when it is let go.
        writer.write(&content(3_000_000)).await.unwrap();
    });
    // Ends when the blocking threads have.
    drop(runtime);
    assert!(folder.incoming().is_empty());
}

#[tokio::test]
async fn a_scan_beyond_its_limit_is_refused_and_leaves_nothing() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let mut writer = store.begin_scan(1000).await.unwrap();
    writer.write(&content(1000)).await.unwrap();
    assert!(matches!(writer.write(b"x").await, Err(StoreError::ScanTooLarge { bytes_max: 1000 })));
    assert!(matches!(writer.complete().await, Err(StoreError::Closed)));
    assert!(folder.incoming().is_empty());
}

#[tokio::test]
async fn what_an_earlier_process_left_unfinished_is_swept_away() {
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

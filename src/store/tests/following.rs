//! Reading a scan behind its writer: every byte, none too early, and an end in any case.

use std::io::{ErrorKind, Read as _};

use super::*;
use crate::store::StoreError;

const BLOCK: usize = 256 * 1024;

/// Bytes that do not repeat with the length of a block.
fn content(length: usize) -> Vec<u8> {
    (0..length).map(|index| (index % 251) as u8).collect()
}

#[tokio::test]
async fn what_is_there_is_read_before_the_end_and_the_rest_after_it() {
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
    assert_eq!(late, bytes, "a file that is whole is followed just so");
    drop(scan);
    assert!(matches!(trail.follow(), Err(StoreError::FileUnavailable { .. })));
}

#[tokio::test]
async fn a_writer_that_gives_up_ends_its_reader() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let mut writer = store.begin_scan(u64::MAX).await.unwrap();
    let mut follower = writer.trail().follow().unwrap();
    writer.write(&content(BLOCK + 1)).await.unwrap();
    let reader = tokio::task::spawn_blocking(move || follower.read_to_end(&mut Vec::new()));
    drop(writer);
    assert_eq!(reader.await.unwrap().unwrap_err().kind(), ErrorKind::ConnectionAborted);
}

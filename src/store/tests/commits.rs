//! A database that lost acknowledged records is noticed, at the start and while it is used, and one that did not is not.

use super::*;
use crate::store::{Loss, Precondition, StoreError};

/// The database as it was, to be put back later.
fn copy_of(folder: &TempFolder) -> Vec<u8> {
    fs::read(folder.path().join("coaxis.db")).unwrap()
}

fn put_back(folder: &TempFolder, database: &[u8]) {
    fs::write(folder.path().join("coaxis.db"), database).unwrap();
    for log in ["coaxis.db-wal", "coaxis.db-shm"] {
        let _ = fs::remove_file(folder.path().join(log));
    }
}

async fn put(store: &Store, name: &str) -> Result<(), StoreError> {
    store.put_recipe(name, "{}", at(1), Precondition::None).await.map(drop)
}

async fn write_and_close(folder: &TempFolder, names: &[&str]) {
    let store = folder.open().await;
    for name in names {
        put(&store, name).await.unwrap();
    }
    store.close().await;
}

async fn loss(store: &Store) -> Loss {
    match put(store, "refused").await {
        Err(StoreError::RecordsLost(loss)) => loss,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn a_database_that_lost_commits_is_noticed_at_the_start_and_can_be_accepted() {
    let folder = TempFolder::new();
    write_and_close(&folder, &["a"]).await;
    let earlier = copy_of(&folder);
    write_and_close(&folder, &["b", "c"]).await;
    put_back(&folder, &earlier);
    for _ in 0..2 {
        let store = folder.open().await;
        assert_eq!(loss(&store).await, Loss::Behind { found: 1, acknowledged: 3 });
        assert!(store.check_loss().is_err() && store.probe().await.is_err());
        assert!(store.recipe("a").await.unwrap().is_some(), "what is left can be read");
        store.close().await;
    }
    Store::accept_loss(folder.path()).await.unwrap();
    let store = folder.open().await;
    put(&store, "d").await.unwrap();
    assert_eq!(store.recipe("b").await.unwrap(), None);
}

#[tokio::test]
async fn another_database_with_as_many_commits_is_noticed() {
    let (folder, other) = (TempFolder::new(), TempFolder::new());
    write_and_close(&folder, &["a", "b"]).await;
    write_and_close(&other, &["a", "c"]).await;
    put_back(&folder, &copy_of(&other));
    assert_eq!(loss(&folder.open().await).await, Loss::Foreign { found: 2, acknowledged: 2 });
}

#[tokio::test]
async fn an_empty_or_missing_database_beside_scans_is_noticed_and_no_scan_is_lost() {
    for remove_count in [false, true] {
        let folder = TempFolder::new();
        let store = folder.open().await;
        let scan = store.begin_scan(10).await.unwrap().complete().await.unwrap();
        let id = scan.id();
        store.keep_scan(row_of(&scan), scan).await.unwrap();
        store.close().await;
        drop(store);
        fs::remove_file(folder.path().join("coaxis.db")).unwrap();
        if remove_count {
            fs::remove_file(folder.path().join("coaxis.commits")).unwrap();
        }
        for _ in 0..2 {
            let store = folder.open().await;
            assert_eq!(loss(&store).await, Loss::Empty { scans_count: 1 });
            store.close().await;
        }
        assert_eq!(folder.scan_ids(), [id]);
    }
}

#[tokio::test]
async fn a_database_that_is_removed_while_it_is_used_is_noticed_before_anything_is_acknowledged() {
    for name in ["coaxis.db", "coaxis.db-wal"] {
        let folder = TempFolder::new();
        let store = folder.open().await;
        put(&store, "a").await.unwrap();
        fs::remove_file(folder.path().join(name)).unwrap();
        assert!(matches!(loss(&store).await, Loss::Replaced { .. }), "{name}");
        assert!(store.probe().await.is_err());
    }
}

#[tokio::test]
async fn a_damaged_log_is_noticed() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    put(&store, "a").await.unwrap();
    let length = fs::metadata(folder.path().join("coaxis.db-wal")).unwrap().len();
    put(&store, "b").await.unwrap();
    // As a process leaves them that is killed.
    let copies = ["coaxis.db", "coaxis.db-wal", "coaxis.commits"]
        .map(|name| (name, fs::read(folder.path().join(name)).unwrap()));
    drop(store);
    let killed = TempFolder::new();
    for (name, mut bytes) in copies {
        if name == "coaxis.db-wal" {
            let tail = usize::try_from(length).unwrap() + 100;
            bytes[tail] ^= 1;
        }
        fs::write(killed.path().join(name), bytes).unwrap();
    }
    assert_eq!(loss(&killed.open().await).await, Loss::Behind { found: 1, acknowledged: 2 });
}

#[tokio::test]
async fn a_count_that_was_not_written_completely_or_not_any_more_is_no_loss() {
    let folder = TempFolder::new();
    write_and_close(&folder, &["a", "b"]).await;
    let count = folder.path().join("coaxis.commits");
    let before = fs::read(&count).unwrap();
    write_and_close(&folder, &["c"]).await;
    let mut torn = fs::read(&count).unwrap();
    // The slot of the third commit is the second one.
    torn[520..540].fill(b'0');
    for bytes in [before, torn] {
        fs::write(&count, bytes).unwrap();
        let store = folder.open().await;
        store.check_loss().unwrap();
        store.close().await;
    }
    write_and_close(&folder, &["d"]).await;
}

//! Opening: who may, and which databases.

use sqlx::{Connection, SqliteConnection};

use super::*;
use crate::store::{
    StoreError, connection,
    migration::{MIGRATIONS, Migration, migrate},
};

async fn database(folder: &TempFolder) -> SqliteConnection {
    connection::writer(&folder.path().join("coaxis.db"), None).await.unwrap()
}

#[tokio::test]
async fn a_folder_has_one_owner_at_a_time() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    let second = Store::open(folder.path()).await;
    assert!(matches!(second, Err(StoreError::FolderInUse { folder: named }) if named == folder.path()));
    store.close().await;
    drop(store);
    folder.open().await;
}

#[tokio::test]
async fn a_folder_below_folders_that_are_not_there_is_created() {
    let folder = TempFolder::new();
    let store = Store::open(&folder.path().join("line 3/data")).await.unwrap();
    store.probe().await.unwrap();
}

#[tokio::test]
async fn acknowledged_means_synced() {
    let folder = TempFolder::new();
    folder.open().await.close().await;
    let mut database = database(&folder).await;
    let synchronous: i64 = sqlx::query_scalar("PRAGMA synchronous").fetch_one(&mut database).await.unwrap();
    let journal: String = sqlx::query_scalar("PRAGMA journal_mode").fetch_one(&mut database).await.unwrap();
    assert_eq!((synchronous, journal.as_str()), (2, "wal"));
}

#[tokio::test]
async fn a_newer_schema_is_refused_and_left_alone() {
    let folder = TempFolder::new();
    folder.open().await.close().await;
    let mut database = database(&folder).await;
    sqlx::raw_sql("PRAGMA user_version = 99").execute(&mut database).await.unwrap();
    database.close().await.unwrap();
    let known = MIGRATIONS.last().unwrap().version;
    for _ in 0..2 {
        let refused = Store::open(folder.path()).await.unwrap_err();
        assert!(matches!(refused, StoreError::NewerSchema { found: 99, known: k } if k == known), "{refused:?}");
    }
}

#[tokio::test]
async fn a_migration_with_another_text_is_refused() {
    const OTHER: &[Migration] = &[Migration { version: 1, sql: "CREATE TABLE other (id TEXT)" }];
    let folder = TempFolder::new();
    migrate(&mut database(&folder).await, OTHER).await.unwrap();
    assert!(matches!(Store::open(folder.path()).await, Err(StoreError::MigrationDiffers { version: 1 })));
}

#[tokio::test]
async fn a_migration_that_fails_leaves_the_database_as_it_was() {
    const BROKEN: &[Migration] = &[
        MIGRATIONS[0],
        MIGRATIONS[1],
        Migration { version: 3, sql: "CREATE TABLE extra (id TEXT); INSERT INTO missing (id) VALUES (1)" },
    ];
    const MENDED: &[Migration] =
        &[MIGRATIONS[0], MIGRATIONS[1], Migration { version: 3, sql: "CREATE TABLE extra (id TEXT)" }];
    let folder = TempFolder::new();
    let store = folder.open().await;
    store.insert_measurement(new_measurement("m-1", 1)).await.unwrap();
    store.close().await;
    drop(store);
    assert!(migrate(&mut database(&folder).await, BROKEN).await.is_err());
    let store = folder.open().await;
    assert!(store.measurement("m-1").await.unwrap().is_some());
    store.close().await;
    drop(store);
    migrate(&mut database(&folder).await, MENDED).await.unwrap();
}

#[tokio::test]
async fn a_file_that_is_no_database_is_called_damaged() {
    let folder = TempFolder::new();
    fs::write(folder.path().join("coaxis.db"), "no database, but long enough to have a header ".repeat(100)).unwrap();
    assert!(matches!(Store::open(folder.path()).await, Err(StoreError::Damaged(_))));
}

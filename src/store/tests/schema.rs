//! Opening a store: by one process only, and only databases of a known schema.

use sqlx::{Connection, SqliteConnection};

use super::*;
use crate::store::database::{MIGRATIONS, Migration, migrate};
use crate::store::{StoreError, database};

async fn database(folder: &TempFolder) -> SqliteConnection {
    database::writer(&folder.path().join("coaxis.db"), None).await.unwrap()
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
async fn a_folder_is_created_with_its_missing_parents() {
    let folder = TempFolder::new();
    let store = Store::open(&folder.path().join("line 3/data")).await.unwrap();
    store.probe().await.unwrap();
}

#[tokio::test]
async fn a_commit_is_acknowledged_after_it_is_synced() {
    let folder = TempFolder::new();
    folder.open().await.close().await;
    let mut database = database(&folder).await;
    let synchronous: i64 = sqlx::query_scalar("PRAGMA synchronous").fetch_one(&mut database).await.unwrap();
    let journal: String = sqlx::query_scalar("PRAGMA journal_mode").fetch_one(&mut database).await.unwrap();
    assert_eq!((synchronous, journal.as_str()), (2, "wal"));
}

#[tokio::test]
async fn a_newer_schema_is_refused_and_left_unchanged() {
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
async fn a_failed_migration_leaves_the_database_unchanged() {
    const BROKEN: &[Migration] = &[
        MIGRATIONS[0],
        MIGRATIONS[1],
        MIGRATIONS[2],
        Migration { version: 4, sql: "CREATE TABLE extra (id TEXT); INSERT INTO missing (id) VALUES (1)" },
    ];
    const MENDED: &[Migration] =
        &[MIGRATIONS[0], MIGRATIONS[1], MIGRATIONS[2], Migration { version: 4, sql: "CREATE TABLE extra (id TEXT)" }];
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
async fn a_file_that_is_not_a_database_is_reported_as_damaged() {
    let folder = TempFolder::new();
    fs::write(folder.path().join("coaxis.db"), "no database, but long enough to have a header ".repeat(100)).unwrap();
    assert!(matches!(Store::open(folder.path()).await, Err(StoreError::Damaged(_))));
}

#[tokio::test]
async fn an_old_database_without_commit_order_lists_its_rows_by_their_times() {
    let folder = TempFolder::new();
    let mut old = database(&folder).await;
    migrate(&mut old, MIGRATIONS.get(..2).unwrap()).await.unwrap();
    let rows = "INSERT INTO recipes (name, revision, document, created_at, updated_at) VALUES \
        ('second', 1, '{}', 20, 20), ('first', 1, '{}', 10, 10), ('third', 1, '{}', 30, 30)";
    sqlx::raw_sql(rows).execute(&mut old).await.unwrap();
    old.close().await.unwrap();
    let store = folder.open().await;
    store.put_recipe("fourth", "{}", at(0), crate::store::Precondition::None).await.unwrap();
    let listed = store.recipes(&crate::store::Page { limit: 10, before: None }).await.unwrap().rows;
    let names: Vec<_> = listed.iter().map(|row| row.name.as_str()).collect();
    assert_eq!(names, ["fourth", "third", "second", "first"]);
}

#[tokio::test]
async fn files_are_accessible_only_to_owner_and_group() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = TempFolder::new();
    let store = folder.open().await;
    let scan = store.begin_scan(10).await.unwrap().complete().await.unwrap();
    let scan_file = store.scan_path(&scan.id()).unwrap();
    store.keep_scan(row_of(&scan), scan).await.unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let names = ["coaxis.db", "coaxis.db-wal", "coaxis.db-shm", "coaxis.lock", "coaxis.commits"];
    for path in names.map(|name| folder.path().join(name)).iter().chain([&scan_file]) {
        assert_eq!(mode(path) & !0o640, 0, "{}: {:o}", path.display(), mode(path));
    }
    assert_eq!(mode(&folder.path().join("scans")) & !0o750, 0);
    store.close().await;
    drop(store);
    // The next start removes the access of others to files of an earlier version.
    let database = folder.path().join("coaxis.db");
    fs::set_permissions(&database, fs::Permissions::from_mode(0o644)).unwrap();
    folder.open().await;
    assert_eq!(mode(&database), 0o640);
}

//! Everything that was acknowledged still exists after the process was killed (the test starts itself as the process to be killed),
//! lost records are detected, and a store that cannot be written refuses writes and recovers.

use super::*;
use crate::store::database::StoreLimits;
use crate::store::writer::Write;
use crate::store::{Inserted, Loss, Precondition, StoreError};
use sqlx::SqliteConnection;
use std::collections::BTreeSet;
use std::env;
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::process::{Command, Stdio};
use std::sync::Arc;
use tokio::task::JoinSet;

/// A copy of the database, to be restored later.
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
async fn a_database_that_lost_commits_is_detected_at_the_start_and_can_be_accepted() {
    let folder = TempFolder::new();
    write_and_close(&folder, &["a"]).await;
    let earlier = copy_of(&folder);
    write_and_close(&folder, &["b", "c"]).await;
    put_back(&folder, &earlier);
    for _ in 0..2 {
        let store = folder.open().await;
        assert_eq!(loss(&store).await, Loss::Behind { found: 1, acknowledged: 3 });
        assert!(store.check_loss().is_err() && store.probe().await.is_err());
        assert!(store.recipe("a").await.unwrap().is_some(), "the remaining records must be readable");
        store.close().await;
    }
    Store::accept_loss(folder.path()).await.unwrap();
    let store = folder.open().await;
    put(&store, "d").await.unwrap();
    assert_eq!(store.recipe("b").await.unwrap(), None);
}

#[tokio::test]
async fn another_database_with_the_same_number_of_commits_is_detected() {
    let (folder, other) = (TempFolder::new(), TempFolder::new());
    write_and_close(&folder, &["a", "b"]).await;
    write_and_close(&other, &["a", "c"]).await;
    put_back(&folder, &copy_of(&other));
    assert_eq!(loss(&folder.open().await).await, Loss::Foreign { found: 2, acknowledged: 2 });
}

#[tokio::test]
async fn an_empty_or_missing_database_beside_scans_is_detected_and_no_scan_is_lost() {
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
async fn a_database_removed_during_use_is_detected_before_a_write_is_acknowledged() {
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
async fn a_damaged_log_is_detected() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    put(&store, "a").await.unwrap();
    let length = fs::metadata(folder.path().join("coaxis.db-wal")).unwrap().len();
    put(&store, "b").await.unwrap();
    // The files as a killed process leaves them.
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
async fn an_incomplete_or_outdated_commit_count_is_not_a_loss() {
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

/// Set in the process that will be killed: its folder and the number of its round.
const VICTIM: [&str; 2] = ["COAXIS_TEST_CRASH_FOLDER", "COAXIS_TEST_CRASH_ROUND"];
const ACKNOWLEDGED: &str = "acknowledged ";

#[test]
fn acknowledged_records_and_scans_survive_being_killed() {
    let folder = TempFolder::new();
    let mut acknowledged = BTreeSet::new();
    // Killed after this number of answers, while eight clients are writing.
    for (round, answers) in [1, 2, 3, 5, 8, 13, 21, 34, 55, 89].into_iter().enumerate() {
        acknowledged.extend(kill_after(answers, round, &folder));
        let runtime = tokio::runtime::Runtime::new().unwrap();
        runtime.block_on(expect_all(&acknowledged, &folder));
    }
    assert!(acknowledged.len() >= 231);
}

/// Kills the process and returns what it had acknowledged.
fn kill_after(answers: usize, round: usize, folder: &TempFolder) -> Vec<String> {
    let (_crate, module) = module_path!().split_once("::").unwrap();
    let mut victim = Command::new(env::current_exe().unwrap())
        .args(["--exact", &format!("{module}::victim"), "--nocapture", "--test-threads=1"])
        .env(VICTIM[0], folder.path())
        .env(VICTIM[1], round.to_string())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut output = BufReader::new(victim.stdout.take().unwrap());
    let mut acknowledged = Vec::new();
    let mut line = String::new();
    while output.read_line(&mut line).unwrap() > 0 {
        // The last line may be incomplete.
        if let Some(id) = line.strip_prefix(ACKNOWLEDGED).and_then(|rest| rest.strip_suffix('\n')) {
            acknowledged.push(id.to_owned());
        }
        if acknowledged.len() == answers {
            victim.kill().unwrap();
        }
        line.clear();
    }
    victim.wait().unwrap();
    assert!(acknowledged.len() >= answers, "the process ended by itself");
    acknowledged
}

async fn expect_all(acknowledged: &BTreeSet<String>, folder: &TempFolder) {
    let store = folder.open().await;
    assert!(folder.incoming().is_empty());
    for id in folder.scan_ids() {
        assert!(store.scan(&id).await.unwrap().is_some(), "{id} is a file without a row");
    }
    for id in acknowledged {
        let row = store.measurement(id).await.unwrap().unwrap_or_else(|| panic!("{id} is lost"));
        assert_eq!(store.profiles(id).await.unwrap().as_deref(), Some(id.as_bytes()));
        let content = io::read_to_string(store.open_scan(&row.scan_id).await.unwrap().unwrap()).unwrap();
        assert_eq!(content, *id);
    }
    store.close().await;
}

/// Does nothing unless it is started as the process to be killed.
#[test]
fn victim() {
    let [Ok(folder), Ok(round)] = VICTIM.map(env::var) else { return };
    // The test harness has already begun a line.
    writeln!(io::stdout()).unwrap();
    tokio::runtime::Runtime::new().unwrap().block_on(async {
        let store = Arc::new(Store::open(Path::new(&folder)).await.unwrap());
        let mut clients = JoinSet::new();
        for client in 0..8 {
            clients.spawn(measure_forever(Arc::clone(&store), format!("m-{round}-{client}")));
        }
        clients.join_all().await;
    });
}

/// Inserts a new scan for each measurement; its content is the measurement's id. Ends when the reader of the answers is gone.
async fn measure_forever(store: Arc<Store>, name: String) {
    for number in 0.. {
        let id = format!("{name}-{number}");
        let mut writer = store.begin_scan(100).await.unwrap();
        writer.write(id.as_bytes()).await.unwrap();
        let scan = writer.complete().await.unwrap();
        let mut new = new_measurement(&id, number);
        new.row.scan_id = scan.id();
        new.scan = Some(row_of(&scan));
        store.insert_measurement_of(new, scan).await.unwrap();
        writeln!(io::stdout(), "{ACKNOWLEDGED}{id}").unwrap();
    }
}

/// A statement of the test, executed on the connection that writes.
pub(super) struct Statement(pub(super) &'static str);

impl Write for Statement {
    type Outcome = ();

    async fn apply(&self, database: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::raw_sql(self.0).execute(database).await?;
        Ok(())
    }
}

/// A measurement of 100 kB.
fn large(number: i64) -> NewMeasurement {
    NewMeasurement { profiles: vec![0; 100_000], ..new_measurement(&format!("m-{number}"), number) }
}

/// A store with space for its tables and one large measurement.
async fn small_store(folder: &TempFolder) -> Store {
    let limits = StoreLimits { database_bytes_max: Some(250_000) };
    let store = Store::open_within(folder.path(), limits).await.unwrap();
    store.insert_measurement(large(0)).await.unwrap();
    store
}

#[tokio::test]
async fn a_full_database_refuses_writes_stays_readable_and_recovers() {
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
async fn a_small_write_succeeds_although_a_large_one_in_its_commit_does_not_fit() {
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
    // The commit of this statement is counted, which is already a write.
    let error = store.writer.write(Statement("PRAGMA query_only = ON")).await.unwrap_err();
    assert!(matches!(error, StoreError::Unavailable(_)), "{error:?}");
    assert_eq!(store.insert_measurement(new_measurement("m-1", 1)).await.unwrap(), Inserted::New);
}

#[tokio::test]
async fn a_refused_write_does_not_affect_others_in_its_commit() {
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
async fn a_write_completes_when_its_caller_is_dropped() {
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
async fn waiting_writes_finish_before_closing_and_later_ones_are_refused() {
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
async fn a_missing_folder_is_reported_until_it_exists_again() {
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
async fn a_scan_that_cannot_be_stored_leaves_no_file_and_can_be_sent_again() {
    let folder = TempFolder::new();
    let store = folder.open().await;
    // The SHA-256 of an empty file begins with e3.
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
fn a_full_disk_and_a_full_quota_have_the_same_code() {
    for kind in [io::ErrorKind::StorageFull, io::ErrorKind::QuotaExceeded] {
        assert!(matches!(StoreError::of_file("scans")(kind.into()), StoreError::Full));
    }
    let read_only = StoreError::of_file("scans")(io::ErrorKind::ReadOnlyFilesystem.into());
    assert_eq!(read_only.code(), "store_unavailable");
}

//! Whatever was acknowledged is there after the process was killed. The test runs itself as the process to be killed.

use std::{
    collections::BTreeSet,
    env,
    io::{self, BufRead as _, BufReader, Write as _},
    process::{Command, Stdio},
    sync::Arc,
};

use tokio::task::JoinSet;

use super::*;

/// Set in the process to be killed: its folder and the number of its round.
const VICTIM: [&str; 2] = ["COAXIS_TEST_CRASH_FOLDER", "COAXIS_TEST_CRASH_ROUND"];
const ACKNOWLEDGED: &str = "acknowledged ";

#[test]
fn acknowledged_records_and_scans_survive_being_killed() {
    let folder = TempFolder::new();
    let mut acknowledged = BTreeSet::new();
    // Killed after so many answers, in the middle of whatever eight clients are then doing.
    for (round, answers) in [1, 2, 3, 5, 8, 13, 21, 34, 55, 89].into_iter().enumerate() {
        acknowledged.extend(kill_after(answers, round, &folder));
        let runtime = tokio::runtime::Runtime::new().unwrap();
        runtime.block_on(expect_all(&acknowledged, &folder));
    }
    assert!(acknowledged.len() >= 231);
}

/// What the process had acknowledged when it was gone.
fn kill_after(answers: usize, round: usize, folder: &TempFolder) -> Vec<String> {
    let mut victim = Command::new(env::current_exe().unwrap())
        .args(["--exact", "store::tests::crash::victim", "--nocapture", "--test-threads=1"])
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
        // The last line may be cut.
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

/// Does nothing unless it is started to be killed.
#[test]
fn victim() {
    let [Ok(folder), Ok(round)] = VICTIM.map(env::var) else { return };
    // The test harness has begun a line.
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

/// A new scan for each measurement; its content is the measurement's id. Ends with the reader of its answers.
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

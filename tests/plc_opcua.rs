//! The OPC UA adaptor against an independent PLC: tests/plc_opcua.py, based on asyncua, without code of this project. The
//! assertions use the commands that the PLC reports as executed. Runs on the real clock, on loopback.

#![cfg(feature = "opcua")]
#![expect(clippy::expect_used, clippy::panic, reason = "a test may fail")]

use coaxis::device::contract::{check_manipulator, motion::check_manipulator_motion};
use coaxis::device::opcua::{OpcuaManipulator, Policy, Security, Settings};
use coaxis::device::{Action, AxisState, Command as Order, CommandResult, DeviceError, Manipulator, Mode, Reading};
use coaxis::motion::{Axes, Axis};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Maximum duration of any step, on a busy machine.
const PATIENCE: Duration = Duration::from_secs(20);
/// Maximum duration of a call with the default settings, plus an allowance for a busy machine.
const DEADLINE: Duration = Duration::from_millis(300 + 200);
const NOTHING: [u16; 0] = [];
const WATCHDOG: Duration = Duration::from_millis(400);

/// The third-party PLC; it is stopped when the value is dropped.
struct Plc {
    process: Child,
    lines: Receiver<String>,
    port: u16,
}

impl Plc {
    fn start(port: u16, arguments: &[&str]) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
        let python = std::env::var_os("COAXIS_PYTHON").map_or_else(|| root.join(".venv/bin/python"), PathBuf::from);
        let mut process = Command::new(&python)
            .arg(root.join("plc_opcua.py"))
            .args(["--port", &port.to_string()])
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{}: {error}; run tests/run first, which installs it", python.display()));
        let out = process.stdout.take().expect("piped");
        let (send, lines) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                let _ = send.send(line);
            }
        });
        let first = lines.recv_timeout(PATIENCE);
        assert_eq!(
            first.as_deref(),
            Ok(format!("ready {port}").as_str()),
            "the PLC did not start; run tests/run first, which installs asyncua for {}",
            python.display()
        );
        Self { process, lines, port }
    }

    fn open() -> Self {
        Self::start(free_port(), &[])
    }

    /// The numbers of the commands executed since the last call.
    fn executed(&mut self) -> Vec<u16> {
        let stdin = self.process.stdin.as_mut().expect("piped");
        writeln!(stdin, "so far").and_then(|()| stdin.flush()).expect("it lives");
        let mut executed = Vec::new();
        loop {
            let line = self.lines.recv_timeout(PATIENCE).expect("it answers");
            match line.strip_prefix("executed m1 ").and_then(|line| line.split(' ').next()) {
                Some(number) => executed.push(number.parse().expect("a number")),
                None if line == "so far" => return executed,
                None => {}
            }
        }
    }

    /// Waits for this line. Blocks the thread, so that no reading reaches the PLC.
    fn says(&self, wanted: &str) {
        while self.lines.recv_timeout(PATIENCE).expect(wanted) != wanted {}
    }

    fn signal(&self, signal: &str) {
        let done = Command::new("kill").args([signal, &self.process.id().to_string()]).status();
        assert!(done.expect("kill").success());
    }
}

impl Drop for Plc {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("bound").port()
}

/// A temporary folder, deleted when the value is dropped.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("coaxis-opcua-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn settings(plc: &Plc, folder: &Folder) -> Settings {
    Settings {
        endpoint: format!("opc.tcp://127.0.0.1:{}", plc.port),
        security: Security { pki: Some(folder.0.join("pki")), ..Security::default() },
        // For connecting only, because a busy machine is slow.
        connect_ms: 20_000,
        ..Settings::default()
    }
}

/// A manipulator and the numbers of its commands.
struct Bench {
    link: OpcuaManipulator,
    sequence: u16,
}

impl Bench {
    fn new(settings: &Settings) -> Self {
        Self { link: OpcuaManipulator::new("m1", settings).expect("settings"), sequence: 0 }
    }

    async fn connected(settings: &Settings) -> Self {
        let mut bench = Self::new(settings);
        bench.link.connect().await.expect("connected");
        bench
    }

    async fn tell(&mut self, action: Action) -> Result<u16, DeviceError> {
        self.sequence += 1;
        let order = Order { sequence: self.sequence, fence: 7, watchdog: WATCHDOG, action };
        self.link.send(&order).await.map(|()| self.sequence)
    }

    /// Reads until the condition is true. Each reading waits for the PLC, which answers at most once per
    /// cycle, so this does not spin.
    async fn until(&mut self, holds: impl Fn(&Reading) -> bool) -> Reading {
        let until = async {
            loop {
                let reading = self.link.read().await.expect("a reading");
                if holds(&reading) {
                    return reading;
                }
            }
        };
        tokio::time::timeout(PATIENCE, until).await.expect("in time")
    }

    /// Sends a command and waits for its end.
    async fn done(&mut self, action: Action) -> Reading {
        let sequence = self.tell(action).await.expect("handed over");
        let ended = |reading: &Reading| {
            let told = reading.acknowledged;
            told.sequence == sequence && !matches!(told.result, CommandResult::Accepted | CommandResult::Running)
        };
        self.until(ended).await
    }

    async fn ready(settings: &Settings) -> Self {
        let mut bench = Self::connected(settings).await;
        assert_eq!(bench.done(Action::Enable).await.acknowledged.result, CommandResult::Done);
        let homed = bench.done(Action::Home { axes: Axes::from_fn(|_| true) }).await;
        assert!(homed.axes.iter().all(|(_, axis)| axis.homed), "{homed:?}");
        bench
    }
}

fn to(axis: Axis, target: f64, speed: f64) -> Action {
    let only = |value| Axes::from_fn(|of| if of == axis { value } else { 0.0 });
    Action::MoveTo { axes: Axes::from_fn(|of| of == axis), targets: only(target), speeds: only(speed) }
}

/// Enable, home, move, halt on the way, refuse, watchdog, reset: the required functions of every device.
async fn whole_life(plc: &mut Plc, settings: &Settings) {
    let mut bench = Bench::new(settings);
    let first = bench.link.connect().await.expect("connected");
    assert_eq!((first.state, first.mode, first.acknowledged.sequence), (AxisState::Disabled, Mode::Automatic, 0));
    // The PLC was started at 0, 1, -2 mm and 3 degrees, with limits of 50 mm and 20 degrees.
    assert_eq!((first.axes.y.actual, first.axes.z.actual), (1.0, -2.0));
    assert!((first.axes.c.actual - 3_f64.to_radians()).abs() < 1e-15);
    assert!((first.axes.c.upper - 20_f64.to_radians()).abs() < 1e-15 && first.axes.x.lower == -50.0);
    assert_eq!(plc.executed(), NOTHING, "connecting executes no command");

    assert_eq!(bench.done(Action::Enable).await.state, AxisState::Standstill);
    let refused = bench.done(to(Axis::X, 1.0, 10.0)).await;
    assert_eq!((refused.acknowledged.result, refused.fault_code), (CommandResult::Rejected, 104), "no reference yet");
    bench.done(Action::Home { axes: Axes::from_fn(|_| true) }).await;
    let there = bench.done(to(Axis::C, (-5_f64).to_radians(), 10_f64.to_radians())).await;
    assert_eq!((there.acknowledged.result, there.state), (CommandResult::Done, AxisState::Standstill));
    assert!((there.axes.c.actual - (-5_f64).to_radians()).abs() < 1e-12 && there.axes.c.in_position);
    assert_eq!(there.axes.y.actual, 1.0, "the others keep their position");

    let outside = bench.done(to(Axis::X, 50.1, 10.0)).await;
    assert_eq!((outside.acknowledged.result, outside.fault_code), (CommandResult::Rejected, 101));

    bench.tell(to(Axis::X, 40.0, 20.0)).await.expect("handed over");
    bench.until(|reading| reading.state.moves() && reading.axes.x.actual > 1.0).await;
    let halted = bench.done(Action::Halt).await;
    assert!(!halted.state.moves() && halted.axes.x.actual < 39.0, "{halted:?}");
    let later = bench.link.read().await.expect("a reading");
    assert_eq!(later.axes.x.actual, halted.axes.x.actual, "it keeps its position");
    assert_eq!(plc.executed(), [1, 3, 4, 6, 7]);
}

#[tokio::test]
async fn a_foreign_plc_is_commanded_from_enable_to_halt() {
    let (mut plc, folder) = (Plc::open(), Folder::new("open"));
    let settings = settings(&plc, &folder);
    whole_life(&mut plc, &settings).await;
}

#[tokio::test]
async fn with_a_foreign_plc_the_adaptor_meets_the_contract_of_all_adaptors() {
    let (mut plc, folder) = (Plc::open(), Folder::new("contract"));
    let mut bench = Bench::ready(&settings(&plc, &folder)).await;
    let report = check_manipulator(&mut bench.link).await;
    assert!(report.passed(), "{report:#?}");
    let report = check_manipulator_motion(&mut bench.link, 8).await;
    assert!(report.passed(), "{report:#?}");
    let executed = plc.executed();
    assert!(executed.windows(2).all(|pair| matches!(pair, [a, b] if a < b)), "each once: {executed:?}");
}

#[tokio::test]
async fn a_foreign_plc_works_with_signature_encryption_and_password() {
    let folder = Folder::new("secure");
    std::fs::write(folder.0.join("password"), "kept aside\n").expect("written");
    let mut plc = Plc::start(free_port(), &["--secure", folder.0.to_str().expect("a path")]);
    let mut settings = settings(&plc, &folder);
    settings.security.policy = Policy::Basic256Sha256;
    settings.security.server_certificate = Some(folder.0.join("plc.der"));
    settings.security.user = Some("coaxis".to_owned());
    settings.security.password_file = Some(folder.0.join("password"));
    whole_life(&mut plc, &settings).await;
    settings.security.policy = Policy::Aes256Sha256RsaPss;
    let mut bench = Bench::connected(&settings).await;
    bench.sequence = 7;
    assert_eq!(bench.done(Action::Halt).await.acknowledged.result, CommandResult::Done);

    std::fs::write(folder.0.join("wrong"), "guessed\n").expect("written");
    settings.security.password_file = Some(folder.0.join("wrong"));
    let refused = Bench::new(&settings).link.connect().await.expect_err("a wrong password");
    assert!(matches!(&refused, DeviceError::LinkLost { .. }), "{refused}");
    assert!(!refused.to_string().contains("guessed"), "{refused}");

    // The client's own certificate is a valid certificate, but not the server's.
    settings.security.password_file = Some(folder.0.join("password"));
    settings.security.server_certificate = Some(folder.0.join("pki/own/cert.der"));
    let stranger = Bench::new(&settings).link.connect().await.expect_err("another certificate");
    assert!(stranger.to_string().contains("another certificate"), "{stranger}");
}

#[tokio::test]
async fn a_plc_with_a_wrong_node_is_refused_with_the_name_of_the_node() {
    let folder = Folder::new("wrong");
    for (fault, said) in [
        ("radians", "axes.c.unit is unit 4405297, which is not the degree (17476)"),
        ("missing", "own:Status/own:Homed (status.homed)"),
        ("readonly", "command.targets is of access"),
        ("uncertain", "axes.y.actual_position has the quality UncertainLastUsableValue"),
        ("nan", "axes.z.actual_position is NaN, which is not finite"),
        ("torn", "status.snapshot"),
    ] {
        let mut plc = Plc::start(free_port(), &["--fault", fault]);
        let refused = Bench::new(&settings(&plc, &folder)).link.connect().await.expect_err(fault);
        assert!(matches!(refused, DeviceError::Implausible { .. }) && refused.to_string().contains(said), "{refused}");
        assert_eq!(plc.executed(), NOTHING);
    }
}

#[tokio::test]
async fn a_heartbeat_that_stops_is_reported_as_silence() {
    let folder = Folder::new("frozen");
    let plc = Plc::start(free_port(), &["--fault", "frozen"]);
    let mut bench = Bench::new(&settings(&plc, &folder));
    let connected = bench.link.connect().await;
    let silent = async {
        let mut last = connected;
        while last.is_ok() {
            last = bench.link.read().await;
        }
        last
    };
    let last = tokio::time::timeout(PATIENCE, silent).await.expect("noticed");
    let stale = Duration::from_millis(500);
    assert_eq!(last, Err(DeviceError::Silent { device: "m1".to_owned(), within: stale }));
}

#[tokio::test]
async fn a_plc_without_communication_stops_by_itself() {
    let (plc, folder) = (Plc::open(), Folder::new("watchdog"));
    let settings = settings(&plc, &folder);
    let mut bench = Bench::ready(&settings).await;
    bench.tell(to(Axis::X, 45.0, 20.0)).await.expect("handed over");
    bench.until(|reading| reading.axes.x.actual > 0.5).await;
    // No reading is sent until the watchdog of the PLC reports the lost communication.
    plc.says("watchdog m1");
    let stopped = bench.link.read().await.expect("a reading");
    assert_eq!((stopped.state, stopped.fault_code), (AxisState::ErrorStop, 1));
    assert_eq!(stopped.acknowledged.result, CommandResult::Aborted);
    assert!(stopped.axes.x.actual < 45.0);
    assert_eq!(bench.done(to(Axis::X, 0.0, 20.0)).await.acknowledged.result, CommandResult::Rejected);
    assert_eq!(bench.done(Action::Reset).await.state, AxisState::Standstill);
}

#[tokio::test]
async fn a_command_that_was_lost_with_the_link_is_never_sent_again() {
    let folder = Folder::new("vanish");
    let mut plc = Plc::open();
    let settings = settings(&plc, &folder);
    let mut bench = Bench::ready(&settings).await;
    bench.tell(to(Axis::X, 45.0, 20.0)).await.expect("handed over");
    bench.until(|reading| reading.acknowledged.sequence == 3).await;
    assert_eq!(plc.executed(), [1, 2, 3]);
    let port = plc.port;
    drop(plc);
    let lost = tokio::time::timeout(DEADLINE, bench.link.read()).await.expect("within the deadline");
    assert!(matches!(lost, Err(DeviceError::LinkLost { .. } | DeviceError::Silent { .. })), "{lost:?}");
    let lost = tokio::time::timeout(DEADLINE, bench.tell(Action::Halt)).await.expect("within the deadline");
    assert!(matches!(lost, Err(DeviceError::LinkLost { .. })), "{lost:?}");
    // A new PLC at the same address. Only `connect` reaches it, and that executes no command.
    let mut plc = Plc::start(port, &[]);
    let none = bench.link.read().await;
    assert!(matches!(none, Err(DeviceError::LinkLost { .. })), "{none:?}");
    let found = bench.link.connect().await.expect("connected anew");
    assert_eq!((found.acknowledged.sequence, found.axes.x.actual), (0, 0.0));
    bench.done(Action::Enable).await;
    assert_eq!(plc.executed(), [5], "only the command after the reconnection");
}

#[tokio::test]
async fn a_command_to_a_plc_that_does_not_answer_is_executed_once_at_most() {
    let (mut plc, folder) = (Plc::open(), Folder::new("stalled"));
    let settings = settings(&plc, &folder);
    let mut bench = Bench::ready(&settings).await;
    plc.executed();
    plc.signal("-STOP");
    let sent = tokio::time::timeout(DEADLINE, bench.tell(to(Axis::X, 5.0, 20.0))).await.expect("within the deadline");
    assert_eq!(sent, Err(DeviceError::Silent { device: "m1".to_owned(), within: Duration::from_millis(300) }));
    assert!(sent.expect_err("silent").leaves_unknown());
    plc.signal("-CONT");
    let found = bench.link.connect().await.expect("connected anew");
    // Whether the command arrived is read from the PLC.
    let arrived = found.acknowledged.sequence == bench.sequence;
    let next = bench.done(to(Axis::X, 2.0, 20.0)).await;
    assert_eq!((next.acknowledged.result, next.axes.x.actual), (CommandResult::Done, 2.0));
    let executed = plc.executed();
    assert!(executed == [3, 4] || (!arrived && executed == [4]), "{executed:?}");
}

#[tokio::test]
async fn an_older_fence_is_refused_before_a_byte_is_sent() {
    let (mut plc, folder) = (Plc::open(), Folder::new("fence"));
    let mut bench = Bench::connected(&settings(&plc, &folder)).await;
    bench.done(Action::Enable).await;
    let old = Order { sequence: 2, fence: 6, watchdog: WATCHDOG, action: Action::Disable };
    let refused = bench.link.send(&old).await;
    assert_eq!(refused, Err(DeviceError::Fenced { device: "m1".to_owned(), fence: 6, newest: 7 }));
    bench.sequence = 2;
    bench.done(Action::Halt).await;
    assert_eq!(plc.executed(), [1, 3]);
}

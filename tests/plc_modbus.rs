//! Modbus TCP with third-party programs: the adaptors against a PLC based on pymodbus (tests/plc_modbus.py), and a
//! pymodbus client (tests/modbus_client.py) against the simulated PLC. On loopback, on the real clock.

#![expect(clippy::expect_used, clippy::panic, reason = "a test may fail")]

use coaxis::device::contract::motion::{check_manipulator_motion, check_stage_motion};
use coaxis::device::contract::{Report, check_manipulator, check_stage};
use coaxis::device::modbus::{Layout, Settings, WordOrder, open, open_stage};
use coaxis::device::{Action, AxisState, Command as Order, CommandResult, DeviceError, Manipulator, Mode, Reading};
use coaxis::motion::{Axes, Position};
use std::io::{BufRead, BufReader, Lines};
use std::path::PathBuf;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;
use tokio::time::sleep;

/// A program that is stopped when its handle is dropped, and its output.
struct Program {
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Program {
    fn start(command: &mut Command) -> Self {
        let program = command.get_program().to_owned();
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{}: {error}; run tests/run first", program.display()));
        let lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        Self { child, lines }
    }

    fn line(&mut self) -> String {
        self.lines.next().and_then(Result::ok).expect(
            "the program has ended without output; if its packages are missing, run tests/run first, which installs them",
        )
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The Python interpreter with the packages of tests/requirements.txt, with one of the scripts here.
fn python(script: &str) -> Command {
    let tests = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests");
    let python = std::env::var_os("COAXIS_PYTHON").map_or_else(|| tests.join(".venv/bin/python"), PathBuf::from);
    assert!(python.exists(), "{} is missing; run tests/run first, which creates it", python.display());
    let mut command = Command::new(python);
    command.arg(tests.join(script));
    command
}

/// The third-party PLC, and the settings to connect to it.
fn foreign_plc() -> (Program, Settings) {
    let mut plc = Program::start(&mut python("plc_modbus.py"));
    let ready = plc.line();
    let port = ready.strip_prefix("READY ").unwrap_or_else(|| panic!("the PLC says {ready:?}"));
    let settings = Settings { address: format!("127.0.0.1:{port}"), ..Settings::default() };
    (plc, settings)
}

fn order(sequence: u16, action: Action) -> Order {
    Order { sequence, fence: 1, watchdog: Duration::from_millis(400), action }
}

fn x_to(x: f64, speed: f64) -> Action {
    let only_x = |x| Position { x, ..Position::default() };
    Action::MoveTo { axes: Axes { x: true, ..Axes::default() }, targets: only_x(x), speeds: only_x(speed) }
}

/// Reads until the device reports the end of this command.
async fn until_over(device: &mut dyn Manipulator, sequence: u16) -> Reading {
    for _ in 0..400 {
        let reading = device.read().await.expect("a reading");
        let open = matches!(reading.acknowledged.result, CommandResult::Accepted | CommandResult::Running);
        if reading.acknowledged.sequence == sequence && !open && reading.state != AxisState::Stopping {
            return reading;
        }
        sleep(Duration::from_millis(25)).await;
    }
    panic!("command {sequence} never ends");
}

/// Enables and homes a device, with the numbers 1 and 2.
async fn make_ready(settings: &Settings) -> Box<dyn Manipulator> {
    let mut device = open("made ready", settings).expect("settings that can be");
    device.connect().await.expect("connects");
    device.send(&order(1, Action::Enable)).await.expect("sends");
    until_over(device.as_mut(), 1).await;
    let axes = Axes { x: true, y: true, z: true, c: true };
    device.send(&order(2, Action::Home { axes })).await.expect("sends");
    until_over(device.as_mut(), 2).await;
    device
}

fn must_pass(report: &Report) {
    let failed: Vec<_> = report.checks.iter().filter(|check| !check.passed).collect();
    assert!(report.passed() && failed.is_empty(), "{failed:#?}");
}

#[tokio::test]
async fn a_foreign_plc_is_enabled_homed_moved_and_halted() {
    let (mut plc, settings) = foreign_plc();
    let mut m1 = open("m1", &settings).expect("settings that can be");
    let reading = m1.connect().await.expect("connects");
    assert_eq!((reading.state, reading.mode, reading.fault_code), (AxisState::Disabled, Mode::Automatic, 0));
    assert!(reading.safety.allows_motion() && !reading.axes.x.homed);
    // The limits in the source of the PLC: 200 mm, and 180 degrees at 30 degrees/s.
    let Axes { x, c, .. } = reading.axes;
    assert_eq!((x.lower, x.upper, x.speed), (-200.0, 200.0, 50.0));
    assert!((c.upper - std::f64::consts::PI).abs() < 1e-12 && (c.speed.to_degrees() - 30.0).abs() < 1e-12);
    drop(m1);

    let mut m1 = make_ready(&settings).await;
    let reading = m1.read().await.expect("a reading");
    assert!(reading.state == AxisState::Standstill && reading.axes.iter().all(|(_, axis)| axis.homed));
    m1.send(&order(3, x_to(12.5, 50.0))).await.expect("sends");
    let reading = until_over(m1.as_mut(), 3).await;
    assert!(reading.acknowledged.result == CommandResult::Done && (reading.axes.x.actual - 12.5).abs() < 1e-5);
    m1.send(&order(4, x_to(200.5, 50.0))).await.expect("is handed over");
    let reading = until_over(m1.as_mut(), 4).await;
    assert_eq!((reading.acknowledged.result, reading.fault_code), (CommandResult::Rejected, 51));

    m1.send(&order(5, x_to(-150.0, 40.0))).await.expect("sends");
    sleep(Duration::from_millis(300)).await;
    m1.send(&order(6, Action::Halt)).await.expect("sends");
    let held = until_over(m1.as_mut(), 6).await;
    assert!(held.state == AxisState::Standstill && held.axes.x.actual > -100.0, "{:?}", held.axes.x);
    let executed: Vec<_> = (0..5).map(|_| plc.line()).collect();
    assert_eq!(
        executed,
        ["executed m1 1 1", "executed m1 2 4", "executed m1 3 5", "executed m1 5 5", "executed m1 6 6"]
    );
}

#[tokio::test]
async fn a_foreign_plc_meets_the_contract_of_manipulators() {
    let (_plc, settings) = foreign_plc();
    let settings = Settings { base: 256, ..settings };
    let mut m2 = make_ready(&settings).await;
    must_pass(&check_manipulator(m2.as_mut()).await);
    must_pass(&check_manipulator_motion(m2.as_mut(), 10).await);
}

#[tokio::test]
async fn a_foreign_plc_meets_the_contract_of_stages() {
    let (_plc, settings) = foreign_plc();
    let settings = Settings { base: 512, ..settings };
    drop(make_ready(&settings).await);
    let mut stage = open_stage("stage", &settings).expect("settings that can be");
    must_pass(&check_stage(stage.as_mut()).await);
    must_pass(&check_stage_motion(stage.as_mut(), 10).await);
}

#[tokio::test]
async fn a_foreign_plc_with_another_word_order_is_detected() {
    let (_plc, settings) = foreign_plc();
    for word_order in [WordOrder::Cdab, WordOrder::Badc, WordOrder::Dcba] {
        let layout = Layout { word_order, ..Layout::default() };
        let mut m1 = open("m1", &Settings { layout, ..settings.clone() }).expect("settings that can be");
        assert!(matches!(m1.connect().await, Err(DeviceError::Implausible { .. })), "{word_order:?}");
    }
}

#[tokio::test]
async fn a_foreign_plc_that_exits_is_a_lost_link() {
    let (plc, settings) = foreign_plc();
    let mut m1 = open("m1", &settings).expect("settings that can be");
    m1.connect().await.expect("connects");
    drop(plc);
    let lost = m1.read().await.expect_err("it is gone");
    assert!(matches!(lost, DeviceError::LinkLost { .. }), "{lost}");
    assert!(matches!(m1.connect().await, Err(DeviceError::LinkLost { .. })));
}

#[test]
fn a_foreign_client_finds_the_simulated_plc_as_documented() {
    let mut served =
        Program::start(Command::new(env!("CARGO_BIN_EXE_coaxis")).args(["simulate", "plc", "--modbus", "127.0.0.1:0"]));
    let line = served.line();
    let port = line.rsplit_once(':').map(|(_, port)| port).unwrap_or_else(|| panic!("it says {line:?}"));
    let output = python("modbus_client.py").arg(port).output().expect("runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}; if pymodbus is missing, run tests/run first, which installs it");
}

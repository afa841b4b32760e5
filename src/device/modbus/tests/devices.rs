//! The contract of all adaptors over map v1 and over the other map of docs/modbus.md; and the stage over the same map.
//!
//! Exactly-once test: thousands of runs, each with one command and at least one fault of the connection. The reports of the adaptor
//! are compared with the commands that the controller has executed. A command is identified by its unique target, because its
//! sequence number may have been corrupted.

use super::{Settings, Wire, WireFault, command, controller, manipulator, plc, x_to};
use crate::device::contract::motion::{check_manipulator_motion, check_stage_motion};
use crate::device::contract::{Report, check_manipulator, check_stage};
use crate::device::modbus::{Layout, ModbusManipulator, Numbers, Plc, StatusFunction, WordOrder};
use crate::device::sequence::{is_newer, next};
use crate::device::simulated::code;
use crate::device::{Acknowledged, Action, CommandResult, DeviceError, Manipulator, Reading, Stage};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::sleep;

const PAGE: &str = include_str!("../../../../docs/modbus.md");

fn must_pass(report: &Report) {
    let failed: Vec<_> = report.checks.iter().filter(|check| !check.passed).collect();
    assert!(report.passed(), "{failed:#?}");
}

/// The settings of the example in docs/modbus.md.
fn documented() -> Settings {
    let text = PAGE.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let page: toml::Table = toml::from_str(text).expect("TOML");
    let path = ["cell", "manipulators", "m1", "modbus"];
    let found = path.iter().fold(toml::Value::Table(page), |value, key| value[key].clone());
    found.try_into().expect("settings")
}

#[tokio::test(start_paused = true)]
async fn map_v1_fulfils_the_contract() {
    let wire = Wire::to(&plc());
    let mut m1 = super::manipulator(&wire);
    must_pass(&check_manipulator(&mut m1).await);
    must_pass(&check_manipulator_motion(&mut m1, 5).await);
}

#[tokio::test(start_paused = true)]
async fn the_other_map_of_the_documentation_fulfils_the_contract() {
    let settings = documented();
    assert_eq!(settings.check(), Ok(()));
    let wire = Wire::to(&Arc::new(Plc::new(settings.layout, vec![controller()])));
    let mut m1 = settings.manipulator("m1", wire.dial()).expect("valid settings");
    must_pass(&check_manipulator(&mut m1).await);
    must_pass(&check_manipulator_motion(&mut m1, 5).await);
}

#[test]
fn the_other_map_of_the_documentation_differs_from_map_v1() {
    let Layout { status, numbers, word_order, .. } = documented().layout;
    assert_eq!((status.function, word_order), (StatusFunction::Holding, WordOrder::Cdab));
    assert!(matches!(numbers, Numbers::I32(_)) && status.magic.is_none());
}

#[test]
fn the_documentation_lists_every_register_of_map_v1() {
    let Layout { status, command, .. } = Layout::default();
    let rows = [
        (status.heartbeat, "device heartbeat"),
        (status.state, "state of the device"),
        (status.sequence, "newest sequence number seen"),
        (status.result, "result of that command"),
        (status.actual.x, "actual position"),
        (status.speed.x, "greatest speed"),
        (command.watchdog_ms.expect("map v1 has this register"), "watchdog, ms"),
        (command.crc.expect("map v1 has this register"), "CRC-16"),
        (command.fence.expect("map v1 has this register"), "fence"),
        (command.sequence, "sequence number"),
    ];
    for (at, what) in rows {
        let named = PAGE.lines().any(|line| line.starts_with(&format!("| {at} |")) && line.contains(what));
        assert!(named, "no row {at} for {what}");
    }
}

#[tokio::test(start_paused = true)]
async fn the_stage_fulfils_the_contract() {
    let plc = plc();
    let command = super::command(100, Action::Enable);
    plc.with(2, |stage, now| stage.take(&command, now)).expect("a stage");
    let wire = Wire::to(&plc);
    let settings = Settings { base: 512, ..Settings::default() };
    let mut stage = settings.stage("stage", wire.dial()).expect("valid settings");
    must_pass(&check_stage(&mut stage).await);
    must_pass(&check_stage_motion(&mut stage, 5).await);
}

#[tokio::test(start_paused = true)]
async fn a_new_adaptor_continues_from_the_devices_number() {
    let plc = plc();
    let wire = Wire::to(&plc);
    let mut before = super::manipulator(&wire);
    before.connect().await.expect("connects");
    before.send(&super::command(41, Action::Enable)).await.expect("sends");
    drop(before);
    assert_eq!(super::manipulator(&wire).connect().await.expect("connects").acknowledged.sequence, 41);
}

const STAGE: usize = 2;

fn stage(wire: &Wire) -> impl Stage + use<> {
    let settings = Settings { base: 512, ..Settings::default() };
    settings.stage("stage", wire.dial()).expect("valid settings")
}

/// Enables the stage as an operator does at its panel, because the trait has no command for it.
fn enable(plc: &Plc) {
    let command = super::command(100, crate::device::Action::Enable);
    plc.with(STAGE, |controller, now| controller.take(&command, now)).expect("a stage");
}

fn executed(plc: &Plc) -> Vec<u16> {
    plc.with(STAGE, |stage, _| stage.record().all_executed().map(|entry| entry.sequence).collect()).expect("a stage")
}

#[tokio::test(start_paused = true)]
async fn a_stage_moves_to_its_target_and_halts() {
    let plc = plc();
    enable(&plc);
    let mut stage = stage(&Wire::to(&plc));
    let reading = stage.connect().await.expect("connects");
    assert_eq!((reading.lower_mm, reading.upper_mm, reading.speed_mm_s), (-200.0, 200.0, 50.0));
    stage.move_to(1, 20.0, 40.0).await.expect("accepted");
    while stage.read().await.expect("a reading").moves {
        sleep(Duration::from_millis(50)).await;
    }
    let reading = stage.read().await.expect("a reading");
    assert!(reading.in_position && (reading.actual_mm - 20.0).abs() < 1e-5, "{reading:?}");
    stage.move_to(1, 120.0, 40.0).await.expect("accepted");
    sleep(Duration::from_millis(300)).await;
    stage.halt().await.expect("accepted");
    sleep(Duration::from_millis(300)).await;
    let reading = stage.read().await.expect("a reading");
    assert!(!reading.moves && reading.actual_mm < 50.0, "{reading:?}");
    assert_eq!(executed(&plc), [100, 101, 102, 103], "the numbers continue from the device's number");
}

#[tokio::test(start_paused = true)]
async fn a_disabled_stage_is_enabled_before_a_move() {
    let plc = plc();
    let mut stage = stage(&Wire::to(&plc));
    stage.connect().await.expect("connects");
    assert_eq!(executed(&plc), [0_u16; 0], "connecting must send no command");
    stage.move_to(1, 20.0, 40.0).await.expect("accepted");
    while stage.read().await.expect("a reading").moves {
        sleep(Duration::from_millis(50)).await;
    }
    let reading = stage.read().await.expect("a reading");
    assert!((reading.actual_mm - 20.0).abs() < 1e-5, "{reading:?}");
    assert_eq!(executed(&plc).len(), 2, "enable and move");
}

#[tokio::test(start_paused = true)]
async fn a_stage_reports_a_refusal_of_the_device() {
    let plc = plc();
    enable(&plc);
    let mut stage = stage(&Wire::to(&plc));
    stage.connect().await.expect("connects");
    let refused = stage.move_to(1, 500.0, 40.0).await;
    assert_eq!(refused, Err(DeviceError::Rejected { device: "stage".to_owned(), code: code::OUT_OF_LIMITS }));
}

#[tokio::test(start_paused = true)]
async fn a_number_that_may_still_arrive_is_not_used_again() {
    let plc = plc();
    enable(&plc);
    let wire = Wire::to(&plc);
    let mut stage = stage(&wire);
    stage.connect().await.expect("connects");
    wire.plan([Some(WireFault::LateRequest(2000))]);
    assert!(stage.move_to(1, 100.0, 40.0).await.expect_err("the connection is closed").leaves_unknown());
    stage.connect().await.expect("connects again");
    stage.move_to(1, 10.0, 40.0).await.expect("accepted");
    sleep(Duration::from_secs(3)).await;
    assert_eq!(executed(&plc), [100, 102], "101 arrived late, and is older than 102");
}

#[tokio::test(start_paused = true)]
async fn an_older_fencing_token_does_not_move_the_stage() {
    let mut stage = stage(&Wire::to(&plc()));
    stage.connect().await.expect("connects");
    let _ = stage.move_to(7, 10.0, 40.0).await;
    let refused = stage.move_to(6, 10.0, 40.0).await;
    assert_eq!(refused, Err(DeviceError::Fenced { device: "stage".to_owned(), fence: 6, newest: 7 }));
    assert!(stage.halt().await.is_ok(), "a halt has the newest fencing token");
}

/// Number of runs, unless [`RUNS_VARIABLE`] sets it.
const RUNS: usize = 10_000;
const RUNS_VARIABLE: &str = "COAXIS_FAULTY_RUNS";
/// Number of runs with one controller, which keeps a record of 4096 commands.
const CHUNK: usize = 1000;
/// Distance between the targets of two runs, so that all targets of a chunk are within the limits.
const STEP_MM: f64 = 0.125;
/// Fraction of the requests after the planned fault that have another fault.
const FURTHER_FAULTS: f64 = 0.15;

/// The adaptor's final report about a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Executed,
    NotExecuted,
    Unknown,
}

#[derive(Debug, Default)]
struct Tally {
    executed: usize,
    not_executed: usize,
    unknown: usize,
    unknown_but_executed: usize,
    faults: usize,
    ignored: usize,
}

struct Campaign {
    plc: Arc<Plc>,
    wire: Wire,
    m1: ModbusManipulator,
    chance: ChaCha8Rng,
    sequence: u16,
}

#[tokio::test(start_paused = true)]
#[expect(clippy::print_stdout, reason = "its figures are what a campaign is run for")]
async fn every_command_is_executed_once_or_reported_unknown_and_none_twice() {
    let runs = std::env::var(RUNS_VARIABLE).map_or(RUNS, |text| text.parse().expect("a number of runs"));
    let mut tally = Tally::default();
    for first in (0..runs).step_by(CHUNK) {
        let mut campaign = Campaign::start(first as u64).await;
        campaign.chunk(CHUNK.min(runs - first), &mut tally).await;
    }
    println!("{runs} runs: {tally:?}");
    assert!(tally.faults >= runs, "every run must have a fault");
    assert!(
        tally.executed > runs / 4 && tally.unknown > 0 && tally.not_executed > 0,
        "every kind of result must occur: {tally:?}"
    );
    assert!(tally.ignored > 0, "some commands must arrive again and be ignored");
}

impl Campaign {
    async fn start(seed: u64) -> Self {
        let plc = plc();
        let wire = Wire::to(&plc);
        let m1 = manipulator(&wire);
        let mut campaign = Self { plc, wire, m1, chance: ChaCha8Rng::seed_from_u64(seed), sequence: 65_000 };
        campaign.make_ready().await;
        campaign
    }

    async fn chunk(&mut self, runs: usize, tally: &mut Tally) {
        let mut verdicts = Vec::new();
        for run in 0..runs {
            self.plan();
            verdicts.push(self.run(run).await);
            self.make_ready().await;
        }
        // Delayed requests arrive during this time.
        sleep(Duration::from_secs(60)).await;
        tally.faults += self.wire.faults_count();
        tally.ignored += self.plc.with(0, |m1, _| m1.record().all_ignored().len()).expect("m1");
        let counts = self.executions(runs);
        for (run, (verdict, count)) in verdicts.into_iter().zip(counts).enumerate() {
            assert!(count <= 1, "run {run}: executed {count} times, {verdict:?}");
            match verdict {
                Verdict::Executed => assert_eq!(count, 1, "run {run}: reported as executed"),
                Verdict::NotExecuted => assert_eq!(count, 0, "run {run}: reported as not executed"),
                Verdict::Unknown => tally.unknown_but_executed += count,
            }
            let counted = match verdict {
                Verdict::Executed => &mut tally.executed,
                Verdict::NotExecuted => &mut tally.not_executed,
                Verdict::Unknown => &mut tally.unknown,
            };
            *counted += 1;
        }
    }

    /// The number of executions of each run's move; fails on a move that was not sent.
    fn executions(&self, runs: usize) -> Vec<usize> {
        let moves: Vec<f64> = self
            .plc
            .with(0, |m1, _| {
                assert_eq!(m1.record().all_out_of_limits().len(), 0, "no target beyond the limits arrives");
                let moves = m1.record().all_executed().filter_map(|entry| match entry.action {
                    Action::MoveTo { targets, .. } => Some(targets.x),
                    _ => None,
                });
                moves.collect()
            })
            .expect("m1");
        let mut counts = vec![0; runs];
        for target in moves {
            let run = (0..runs).find(|run| (target_mm(*run) - target).abs() < 1e-9);
            counts[run.unwrap_or_else(|| panic!("no run has the target {target} mm"))] += 1;
        }
        counts
    }

    /// Plans a fault at one of the requests of a run, and sometimes another one.
    fn plan(&mut self) {
        let at = *[0, 1, 2, 2, 2, 3, 4].get(self.chance.random_range(0..7)).expect("a place");
        let mut faults = vec![None; at];
        faults.push(Some(any_fault(&mut self.chance)));
        for _ in 0..12 {
            let more = self.chance.random_range(0.0..1.0) < FURTHER_FAULTS;
            faults.push(more.then(|| any_fault(&mut self.chance)));
        }
        self.wire.plan(faults);
    }

    /// Reads, sends one command, and determines its result.
    async fn run(&mut self, run: usize) -> Verdict {
        let before = self.reading().await;
        self.follow(before.acknowledged);
        let commands_before = self.commands_count();
        let outcome = self.m1.send(&command(self.sequence, x_to(target_mm(run)))).await;
        let verdict = match outcome {
            Err(error) if !error.leaves_unknown() => Verdict::NotExecuted,
            _ => self.resolve().await,
        };
        let sent = self.commands_count() - commands_before;
        assert!(sent <= 1, "run {run}: the command was sent {sent} times");
        verdict
    }

    /// Determines the result by reading only: an acknowledged number gives the result; with any other number it is unknown, because
    /// the command may still arrive.
    async fn resolve(&mut self) -> Verdict {
        let seen = self.acknowledged_twice().await;
        match seen.result {
            _ if seen.sequence != self.sequence => Verdict::Unknown,
            CommandResult::Rejected => Verdict::NotExecuted,
            _ => Verdict::Executed,
        }
    }

    /// The status block has no CRC, and this connection corrupts bytes that the checksum of TCP would protect; so two readings must
    /// agree.
    async fn acknowledged_twice(&mut self) -> Acknowledged {
        loop {
            let (first, second) = (self.reading().await.acknowledged, self.reading().await.acknowledged);
            let refused = |seen: Acknowledged| seen.result == CommandResult::Rejected;
            if first.sequence == second.sequence && refused(first) == refused(second) {
                return second;
            }
        }
    }

    /// The next valid reading; reconnects as often as needed.
    async fn reading(&mut self) -> Reading {
        for _ in 0..100 {
            if let Ok(reading) = self.m1.read().await {
                return reading;
            }
            // The reading of connecting is discarded and followed by another reading, as in the cell.
            let _ = self.m1.connect().await;
        }
        panic!("no valid reading in a hundred attempts");
    }

    /// Chooses the next number, newer than all that were used and than the device's number.
    fn follow(&mut self, seen: Acknowledged) {
        if is_newer(seen.sequence, self.sequence) {
            self.sequence = seen.sequence;
        }
        self.sequence = next(self.sequence);
    }

    /// On a connection without faults: enables the device at rest and acknowledges the watchdog's fault.
    async fn make_ready(&mut self) {
        self.wire.plan([]);
        for action in [Action::Reset, Action::Enable] {
            let seen = self.reading().await.acknowledged;
            self.follow(seen);
            self.m1.send(&command(self.sequence, action)).await.expect("sends");
            let _ = self.reading().await;
        }
    }

    fn commands_count(&self) -> usize {
        self.wire.functions().iter().filter(|function| **function == 16).count()
    }
}

/// The target of a run, which is unique and exact in single precision.
fn target_mm(run: usize) -> f64 {
    -60.0 + STEP_MM * run as f64
}

fn any_fault(chance: &mut ChaCha8Rng) -> WireFault {
    let (at, change) = (chance.random_range(0..=255_u8), chance.random_range(1..=255_u8));
    let ms = chance.random_range(1..=3000_u16);
    match chance.random_range(0..13) {
        0 => WireFault::CutBefore,
        1 => WireFault::StallBefore,
        2 => WireFault::CorruptRequest(at, change),
        3 => WireFault::DoubleRequest,
        4 => WireFault::LateAgain(ms),
        5 => WireFault::LateRequest(ms),
        6 => WireFault::CutAfter,
        7 => WireFault::StallAfter,
        8 => WireFault::CorruptAnswer(at, change),
        9 => WireFault::DoubleAnswer,
        10 => WireFault::LateAnswer(ms),
        11 => WireFault::HalfAnswer,
        _ => WireFault::ChangeRegister(63, change.into()),
    }
}

//! Exactly once: thousands of runs, each with one command and at least one fault of the wire on its way. What the adaptor
//! reports is held against what the controller has executed. A command is known by its target, which no other has: its
//! sequence number may be what was corrupted.

use super::{Wire, WireFault, command, manipulator, plc, x_to};
use crate::device::modbus::{ModbusManipulator, Plc};
use crate::device::sequence::{is_newer, next};
use crate::device::{Acknowledged, Action, CommandResult, Manipulator, Reading};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::sleep;

/// Runs where [`RUNS_VARIABLE`] says nothing.
const RUNS: usize = 10_000;
const RUNS_VARIABLE: &str = "COAXIS_FAULTY_RUNS";
/// Runs with one controller, which keeps a record of 4096.
const CHUNK: usize = 1000;
/// Between the targets of two runs. All of a chunk lie within the limits.
const STEP_MM: f64 = 0.125;
/// Share of the requests after the planned fault that meet another one.
const FURTHER_FAULTS: f64 = 0.15;

/// What is known of a command in the end.
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
    assert!(tally.faults >= runs, "every run meets a fault");
    assert!(tally.executed > runs / 4 && tally.unknown > 0 && tally.not_executed > 0, "every end is met: {tally:?}");
    assert!(tally.ignored > 0, "some commands came again, and were ignored");
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
        // What is still under way arrives now.
        sleep(Duration::from_secs(60)).await;
        tally.faults += self.wire.faults_count();
        tally.ignored += self.plc.with(0, |m1, _| m1.record().all_ignored().len()).expect("m1");
        let counts = self.executions(runs);
        for (run, (verdict, count)) in verdicts.into_iter().zip(counts).enumerate() {
            assert!(count <= 1, "run {run}: executed {count} times, {verdict:?}");
            match verdict {
                Verdict::Executed => assert_eq!(count, 1, "run {run}: said to be executed"),
                Verdict::NotExecuted => assert_eq!(count, 0, "run {run}: said not to be executed"),
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

    /// How often each run's move was executed; a move that nobody has sent fails.
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
            counts[run.unwrap_or_else(|| panic!("nobody has sent it to {target} mm"))] += 1;
        }
        counts
    }

    /// A fault at one of the requests of a run, and now and then another one.
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

    /// Reads, sends one command, and finds out what became of it.
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

    /// By reading only: an acknowledged number says what became of it, any other leaves it open, because it may come yet.
    async fn resolve(&mut self) -> Verdict {
        let seen = self.acknowledged_twice().await;
        match seen.result {
            _ if seen.sequence != self.sequence => Verdict::Unknown,
            CommandResult::Rejected => Verdict::NotExecuted,
            _ => Verdict::Executed,
        }
    }

    /// The map's status has no CRC (TCP has one), and this wire corrupts what TCP would not: two readings must agree.
    async fn acknowledged_twice(&mut self) -> Acknowledged {
        loop {
            let (first, second) = (self.reading().await.acknowledged, self.reading().await.acknowledged);
            let refused = |seen: Acknowledged| seen.result == CommandResult::Rejected;
            if first.sequence == second.sequence && refused(first) == refused(second) {
                return second;
            }
        }
    }

    /// The next good reading; connects anew as often as it takes.
    async fn reading(&mut self) -> Reading {
        for _ in 0..100 {
            if let Ok(reading) = self.m1.read().await {
                return reading;
            }
            // What connecting reads is not taken: as the cell does, it is followed by a reading.
            let _ = self.m1.connect().await;
        }
        panic!("no reading in a hundred");
    }

    /// The next number, newer than all that were used and than the device's.
    fn follow(&mut self, seen: Acknowledged) {
        if is_newer(seen.sequence, self.sequence) {
            self.sequence = seen.sequence;
        }
        self.sequence = next(self.sequence);
    }

    /// On a good wire: the device is enabled and at rest, and the watchdog's fault is acknowledged.
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

/// Exact in single precision, and the next run's is another.
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

//! The part of the contract that moves devices: for tests against simulated devices and servers, never against a machine with a
//! part. Input: an adaptor, connected or not. Output: a [`Report`].

use super::{Report, STANDS, moved, say_state};
use crate::device::error::DeviceError;
use crate::device::manipulator::{Acknowledged, Action, AxisState, Command, CommandResult, Manipulator, Reading};
use crate::device::sensor::ProfileSensor;
use crate::device::sensor::{Stage, StageReading};
use crate::device::sequence::next;
use crate::motion::{Axes, Position};
use std::time::Duration;
use tokio::time::{sleep, timeout};

/// Distance and greatest speed of the motions of axis y, mm and mm/s.
const WAY_MM: f64 = 2.0;
const SPEED_MM_S: f64 = 4.0;
/// Interval between two readings during a motion.
const POLL: Duration = Duration::from_millis(50);
/// Number of readings after which a requested state must be reached.
const POLLS_MAX: usize = 200;
const WATCHDOG: Duration = Duration::from_millis(400);
/// After this time without a heartbeat every watchdog has expired and the axis is at rest.
const UNHEARD: Duration = Duration::from_millis(1_500);

/// Sends commands, with the next sequence number, to one device.
struct Commander<'a> {
    device: &'a mut dyn Manipulator,
    sequence: u16,
    fence: u64,
}

impl Commander<'_> {
    fn command(&self, action: Action) -> Command {
        Command { sequence: self.sequence, fence: self.fence, watchdog: WATCHDOG, action }
    }

    /// Sends an action once, with a new number.
    async fn send(&mut self, action: Action) -> Result<(), DeviceError> {
        self.sequence = next(self.sequence);
        self.device.send(&self.command(action)).await
    }

    /// Reads until `done` is true, or the number of readings is used up, and returns the last reading.
    async fn read_until(&mut self, done: impl Fn(&Reading) -> bool) -> Result<Reading, DeviceError> {
        let mut reading = self.device.read().await?;
        for _ in 0..POLLS_MAX {
            if done(&reading) {
                break;
            }
            sleep(POLL).await;
            reading = self.device.read().await?;
        }
        Ok(reading)
    }

    /// Sends, and reads until the device reports the result.
    async fn settle(&mut self, action: Action) -> Result<Reading, DeviceError> {
        self.send(action).await?;
        let sequence = self.sequence;
        self.read_until(move |reading| {
            let Acknowledged { sequence: seen, result } = reading.acknowledged;
            let over = matches!(result, CommandResult::Done | CommandResult::Rejected | CommandResult::Aborted);
            seen == sequence && over && reading.state != AxisState::Stopping
        })
        .await
    }
}

/// Moves axis y to `target`.
fn y_to(target: f64, speed: f64) -> Action {
    let axes = Axes { y: true, ..Axes::default() };
    Action::MoveTo {
        axes,
        targets: Position { y: target, ..Axes::default() },
        speeds: Position { y: speed, ..Axes::default() },
    }
}

/// Moves axis y of a manipulator by 2 mm and back, halts it, lets its watchdog expire and loses its link, with fencing tokens from
/// `fence` on. The manipulator must be ready to be enabled, and at least 25 mm within its limits.
pub async fn check_manipulator_motion(device: &mut dyn Manipulator, fence: u64) -> Report {
    let mut report = Report::new(device.name());
    if let Err(error) = manipulator_motion(device, fence, &mut report).await {
        report.note("every request is answered", false, error);
    }
    report
}

async fn manipulator_motion(device: &mut dyn Manipulator, fence: u64, report: &mut Report) -> Result<(), DeviceError> {
    let start = device.connect().await?;
    let mut commander = Commander { device, sequence: start.acknowledged.sequence, fence };
    let commander = &mut commander;
    let enabled = commander.settle(Action::Enable).await?;
    let ready = enabled.state == AxisState::Standstill && enabled.acknowledged.sequence == commander.sequence;
    report.note("it can be enabled, and acknowledges the number", ready, say_state(&enabled));
    if !ready {
        return Ok(());
    }
    let from = enabled.axes.y.actual;
    reach(commander, report, from).await?;
    again(commander, report, from).await?;
    fenced(commander, report).await?;
    limits(commander, report).await?;
    halts(commander, report, from).await?;
    watchdog(commander, report, from).await?;
    reconnects(commander, report, from).await?;
    dropped(commander, report).await?;
    let disabled = commander.settle(Action::Disable).await?;
    report.note("it can be disabled", disabled.state == AxisState::Disabled, say_state(&disabled));
    Ok(())
}

async fn reach(commander: &mut Commander<'_>, report: &mut Report, from: f64) -> Result<(), DeviceError> {
    let before = commander.device.read().await?;
    let there = commander.settle(y_to(from + WAY_MM, SPEED_MM_S)).await?;
    let Axes { y, .. } = there.axes;
    let exact = (y.actual - from - WAY_MM).abs() <= 0.01 && y.in_position;
    let others = moved(&Reading { axes: Axes { y, ..before.axes }, ..before.clone() }, &there);
    let passed = exact && there.acknowledged.result == CommandResult::Done && others.is_none();
    report.note("it moves to its target, and no other axis moves", passed, others.unwrap_or_else(|| say_state(&there)));
    Ok(())
}

/// Sends the same number again, and an older one, with another target: nothing may move.
async fn again(commander: &mut Commander<'_>, report: &mut Report, from: f64) -> Result<(), DeviceError> {
    let before = commander.device.read().await?;
    let same = commander.command(y_to(from, SPEED_MM_S));
    let older = Command { sequence: commander.sequence.saturating_sub(1).max(1), ..same.clone() };
    for command in [same, older] {
        // Whether the answer comes at once or never depends on the protocol, but nothing may move.
        match commander.device.send(&command).await {
            Ok(()) | Err(DeviceError::Rejected { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    sleep(4 * POLL).await;
    let after = commander.read_until(|_| true).await?;
    let moved = moved(&before, &after);
    let kept = before.acknowledged.sequence == after.acknowledged.sequence;
    let words = moved.clone().unwrap_or_else(|| format!("newest command {}", after.acknowledged.sequence));
    report.note("a sequence number that is not newer is not executed", moved.is_none() && kept, words);
    Ok(())
}

async fn fenced(commander: &mut Commander<'_>, report: &mut Report) -> Result<(), DeviceError> {
    commander.fence += 1;
    commander.settle(Action::Enable).await?;
    let before = commander.device.read().await?;
    let sequence = next(commander.sequence);
    let older = Command { sequence, fence: commander.fence - 1, ..commander.command(Action::Halt) };
    let answer = commander.device.send(&older).await;
    let after = commander.device.read().await?;
    let refused = matches!(answer, Err(DeviceError::Fenced { .. }));
    let unseen = before.acknowledged.sequence == after.acknowledged.sequence;
    let words = answer.err().map_or_else(|| "it was sent".to_owned(), |error| error.to_string());
    report.note("an older fence is refused before anything is sent", refused && unseen, words);
    // If the command was sent after all, its number is used.
    commander.sequence = after.acknowledged.sequence;
    Ok(())
}

async fn limits(commander: &mut Commander<'_>, report: &mut Report) -> Result<(), DeviceError> {
    let before = commander.device.read().await?;
    let answer = commander.settle(y_to(before.axes.y.upper + 1.0, SPEED_MM_S)).await;
    let (passed, words) = match answer {
        Err(DeviceError::Rejected { code, .. }) => (true, format!("refused, code {code}")),
        Err(error) => return Err(error),
        Ok(after) => {
            let rejected = after.acknowledged.result == CommandResult::Rejected;
            (rejected && moved(&before, &after).is_none(), format!("{:?}", after.acknowledged.result))
        }
    };
    report.note("a target beyond its limits is rejected by the device itself", passed, words);
    Ok(())
}

async fn halts(commander: &mut Commander<'_>, report: &mut Report, from: f64) -> Result<(), DeviceError> {
    let far = from + 10.0 * WAY_MM;
    commander.send(y_to(far, SPEED_MM_S)).await?;
    let under_way = commander.read_until(|reading| (reading.axes.y.actual - from - WAY_MM).abs() > 0.2).await?;
    let held = commander.settle(Action::Halt).await?;
    sleep(4 * POLL).await;
    let later = commander.device.read().await?;
    let stands = held.state == AxisState::Standstill && moved(&held, &later).is_none();
    let early = (later.axes.y.actual - far).abs() > 1.0;
    let passed = under_way.state == AxisState::DiscreteMotion && stands && early;
    report.note("a halt stops it before its target, and it stays at rest", passed, say_state(&later));
    Ok(())
}

/// Starts a long move and sends nothing more.
async fn watchdog(commander: &mut Commander<'_>, report: &mut Report, from: f64) -> Result<(), DeviceError> {
    let (before, far) = (commander.device.read().await?, from + 10.0 * WAY_MM);
    commander.send(y_to(far, SPEED_MM_S)).await?;
    sleep(UNHEARD).await;
    let unheard = commander.device.read().await?;
    sleep(4 * POLL).await;
    let later = commander.device.read().await?;
    let went = (later.axes.y.actual - before.axes.y.actual).abs();
    // The axis moves until the watchdog expires, and then brakes.
    let bound = SPEED_MM_S * (UNHEARD.as_secs_f64() - 0.25);
    let stopped = moved(&unheard, &later).is_none() && !later.state.moves() && went > STANDS && went < bound;
    let aborted = later.acknowledged.result == CommandResult::Aborted;
    let words = format!("went {went:.3} mm, then {:?}, {:?}", later.state, later.acknowledged.result);
    report.note("it stops by itself without a heartbeat", stopped && aborted, words);
    if later.state == AxisState::ErrorStop {
        commander.settle(Action::Reset).await?;
    }
    let ready = commander.settle(Action::Enable).await?;
    let passed = ready.state == AxisState::Standstill && moved(&later, &ready).is_none();
    report.note("after that it can be enabled again, and does not continue its motion", passed, say_state(&ready));
    Ok(())
}

/// A new connection in the middle of a motion sends nothing.
async fn reconnects(commander: &mut Commander<'_>, report: &mut Report, from: f64) -> Result<(), DeviceError> {
    commander.settle(y_to(from, SPEED_MM_S)).await?;
    let before = commander.sequence;
    commander.send(y_to(from + 10.0 * WAY_MM, SPEED_MM_S)).await?;
    let again = commander.device.connect().await?;
    let sequence = commander.sequence;
    let halted = commander.settle(Action::Halt).await?;
    let seen = again.acknowledged.sequence;
    // Its acknowledgement may be delayed in the device; a newer number could only come from the adaptor itself.
    let kept = [before, sequence].contains(&seen) && halted.acknowledged.sequence == commander.sequence;
    let words = format!("newest command {seen} after {sequence} was sent");
    report.note("a new connection sends no command, and it can be halted over it", kept, words);
    Ok(())
}

/// Dropping an unanswered request must close the connection, so that a late answer is not attributed to another request.
async fn dropped(commander: &mut Commander<'_>, report: &mut Report) -> Result<(), DeviceError> {
    let finished = timeout(Duration::ZERO, commander.device.read()).await.is_ok();
    let answer = commander.device.read().await;
    let lost = matches!(answer, Err(DeviceError::LinkLost { .. }));
    let words = answer.map_or_else(|error| error.to_string(), |_| "it was answered".to_owned());
    report.note("a request dropped half-way costs the connection", lost || finished, words);
    commander.device.connect().await?;
    let read = commander.device.read().await?;
    report.note("it can be connected to after that", true, say_state(&read));
    Ok(())
}

/// Moves a stage by 10 mm, halts it and lets its watchdog expire, with fencing tokens from `fence` on. The stage must be at least
/// 30 mm below its upper limit.
pub async fn check_stage_motion(device: &mut dyn Stage, fence: u64) -> Report {
    let mut report = Report::new(device.name());
    if let Err(error) = stage_motion(device, fence, &mut report).await {
        report.note("every request is answered", false, error);
    }
    report
}

async fn stage_motion(device: &mut dyn Stage, fence: u64, report: &mut Report) -> Result<(), DeviceError> {
    let start = device.connect().await?;
    let speed = start.speed_mm_s.min(20.0);
    device.move_to(fence + 1, start.actual_mm + 10.0, speed).await?;
    let there = stage_rests(device).await?;
    let exact = (there.actual_mm - start.actual_mm - 10.0).abs() <= 0.05 && there.in_position;
    report.note("it moves to its target", exact, format!("at {:.3} mm", there.actual_mm));
    let answer = device.move_to(fence, start.actual_mm, speed).await;
    let refused = matches!(answer, Err(DeviceError::Fenced { .. }));
    let words = answer.err().map_or_else(|| "it was sent".to_owned(), |error| error.to_string());
    report.note("an older fence is refused before anything is sent", refused, words);
    let answer = device.move_to(fence + 1, start.upper_mm + 1.0, speed).await;
    let refused = matches!(answer, Err(DeviceError::Rejected { .. }));
    let words = answer.err().map_or_else(|| "it was accepted".to_owned(), |error| error.to_string());
    report.note("a target beyond its limits is rejected by the device itself", refused, words);
    device.move_to(fence + 1, there.actual_mm + 20.0, speed / 4.0).await?;
    sleep(4 * POLL).await;
    device.halt().await?;
    let held = stage_rests(device).await?;
    let early = held.actual_mm < there.actual_mm + 19.0;
    report.note("a halt stops it before its target", early, format!("at {:.3} mm", held.actual_mm));
    Ok(())
}

async fn stage_rests(device: &mut dyn Stage) -> Result<StageReading, DeviceError> {
    let mut reading = device.read().await?;
    for _ in 0..POLLS_MAX {
        if !reading.moves {
            break;
        }
        sleep(POLL).await;
        reading = device.read().await?;
    }
    Ok(reading)
}

/// Takes `profiles_count` profiles while `stage` moves by `way_mm`, twice. The sensor must trigger that often over that distance.
pub async fn check_sensor_scan(
    device: &mut dyn ProfileSensor,
    stage: &mut dyn Stage,
    profiles_count: u64,
    way_mm: f64,
    fence: u64,
) -> Report {
    let mut report = Report::new(device.name());
    for name in ["a scan is complete", "and so is the next one"] {
        let (passed, words) = match scan(device, stage, profiles_count, way_mm, fence).await {
            Ok(None) => (true, format!("{profiles_count} profiles")),
            Ok(Some(fault)) => (false, fault),
            Err(error) => (false, error.to_string()),
        };
        report.note(name, passed, words);
    }
    report
}

/// Describes what is wrong with the scan.
async fn scan(
    device: &mut dyn ProfileSensor,
    stage: &mut dyn Stage,
    profiles_count: u64,
    way_mm: f64,
    fence: u64,
) -> Result<Option<String>, DeviceError> {
    device.connect().await?;
    let from = stage.connect().await?;
    device.start(profiles_count).await?;
    stage.move_to(fence, from.actual_mm + way_mm, from.speed_mm_s.min(100.0)).await?;
    let (mut due, mut last, mut fault) = (0, f64::NEG_INFINITY, None);
    for _ in 0..100_000 {
        if due >= profiles_count {
            break;
        }
        // The stage gets heartbeats while profiles are awaited.
        stage.read().await?;
        for profile in device.receive().await? {
            let alike =
                profile.y.len() == profile.z.len() && (profile.x.is_empty() || profile.x.len() == profile.y.len());
            let finite = [&profile.x, &profile.y, &profile.z].into_iter().flatten().all(|value| value.is_finite());
            if profile.index != due || profile.travel_mm <= last || !alike || !finite {
                fault =
                    fault.or(Some(format!("profile {} at {} mm after {last} mm", profile.index, profile.travel_mm)));
            }
            (due, last) = (profile.index + 1, profile.travel_mm);
        }
    }
    device.stop().await?;
    stage_rests(stage).await?;
    let running = device.read().await?.running;
    Ok(fault.or_else(|| running.then(|| "it continues after it was ended".to_owned())))
}

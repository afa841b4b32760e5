//! The state machine, driven with random requests and events, against a small independent model: flags and rules in one place,
//! without effects. 100 000 steps; the message of a failure contains its seed.

use crate::cell::input::{Activity, Effect, Input, Member, Verdict};
use crate::cell::lease::TimeToLiveBounds;
use crate::cell::machine::Machine;
use crate::cell::state::State;
use crate::cell::{Failure, Fault, JobEnd, LeaseRequest, Manual, Refusal, Taken};
use crate::device::clock::now;
use crate::motion::Carrier;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;
use tokio::time::Instant;

const STEPS_COUNT: usize = 100_000;
/// A new machine after this number of steps, so that the paths from the start are tested as well.
const STEPS_A_MACHINE: usize = 500;
const BOUNDS: TimeToLiveBounds = TimeToLiveBounds { least: Duration::from_secs(1), most: Duration::from_secs(10) };

/// The model with which the machine must agree.
#[derive(Debug, Default, Clone)]
struct Model {
    up: [bool; 2],
    begun: bool,
    faulted: bool,
    resetting: bool,
    halting: bool,
    busy: Option<&'static str>,
    job: Option<String>,
    lease: Option<(String, u64)>,
    closing: bool,
    fence: u64,
}

#[derive(Debug, PartialEq, Clone, Copy)]
enum Said {
    Accepted,
    AlreadySo,
    Refused,
}

impl Model {
    fn state(&self) -> State {
        match (self.faulted, self.begun, self.halting, self.busy) {
            (true, ..) => State::Faulted,
            (_, false, ..) => State::Offline,
            (_, _, true, _) => State::Stopping,
            (.., Some("scan")) => State::Scanning,
            (.., Some(_)) => State::Moving,
            (.., None) => State::Idle,
        }
    }

    fn holds(&self, id: &str, ms: u64) -> bool {
        self.lease.as_ref().is_some_and(|(held, until)| held == id && ms < *until)
    }

    fn renew(&mut self, ms: u64) {
        if let Some((_, until)) = &mut self.lease {
            *until = ms + 2_000;
        }
    }

    fn moving(&self) -> bool {
        matches!(self.state(), State::Moving | State::Scanning)
    }

    fn fault(&mut self) {
        (self.faulted, self.resetting, self.halting, self.busy, self.job) = (true, false, false, None, None);
    }

    fn halt(&mut self) {
        self.halting |= self.begun && !self.faulted;
    }

    /// An expired lease stops the motion that was started under it.
    fn expire(&mut self, ms: u64) {
        if self.lease.as_ref().is_some_and(|(_, until)| ms >= *until) {
            self.lease = None;
            if self.moving() {
                self.halt();
            }
        }
    }

    /// The verdict that the machine must return; it also updates the model.
    fn put(&mut self, ms: u64, input: &Input) -> Said {
        match input {
            Input::TakeLease(request) => self.take(ms, &request.id),
            Input::RenewLease(id) if self.holds(id, ms) => {
                self.renew(ms);
                Said::Accepted
            }
            Input::ReleaseLease(id) if self.holds(id, ms) => {
                self.lease = None;
                if self.moving() {
                    self.halt();
                }
                Said::Accepted
            }
            Input::RenewLease(_) | Input::ReleaseLease(_) => Said::Refused,
            Input::Command { lease, fit, .. } => self.command(ms, lease, fit),
            Input::Start { lease, activity, fit } => self.start(ms, lease, activity, fit),
            Input::Stop => {
                self.halt();
                Said::Accepted
            }
            Input::Close => {
                self.closing = true;
                self.halt();
                Said::Accepted
            }
            Input::Reset { lease, fit } => self.reset(ms, lease, fit),
            _ => self.event(ms, input),
        }
    }

    fn take(&mut self, ms: u64, id: &str) -> Said {
        if self.closing {
            return Said::Refused;
        }
        self.expire(ms);
        match &self.lease {
            Some((held, _)) if held != id => Said::Refused,
            Some(_) => {
                self.renew(ms);
                Said::AlreadySo
            }
            None => {
                self.fence += 1;
                self.lease = Some((id.to_owned(), ms + 2_000));
                Said::Accepted
            }
        }
    }

    fn command(&mut self, ms: u64, lease: &str, fit: &Result<Taken, Refusal>) -> Said {
        if self.closing || !self.holds(lease, ms) || self.state() != State::Idle || fit.is_err() {
            return Said::Refused;
        }
        self.renew(ms);
        if *fit == Ok(Taken::AlreadySo) { Said::AlreadySo } else { Said::Accepted }
    }

    fn start(&mut self, ms: u64, lease: &str, activity: &Activity, fit: &Result<(), Refusal>) -> Said {
        let name = match activity {
            Activity::Move(_) => "move",
            Activity::Scan(_) => "scan",
            Activity::Home(_) => "home",
        };
        if self.closing || !self.holds(lease, ms) {
            return Said::Refused;
        }
        let same = self.busy == Some(name) && self.job.as_deref() == activity.job();
        if self.state() == State::Moving && same {
            self.renew(ms);
            return Said::AlreadySo;
        }
        if self.state() != State::Idle || fit.is_err() {
            return Said::Refused;
        }
        self.renew(ms);
        (self.busy, self.job) = (Some(name), activity.job().map(str::to_owned));
        Said::Accepted
    }

    fn reset(&mut self, ms: u64, lease: &str, fit: &Result<(), Refusal>) -> Said {
        if self.closing || !self.holds(lease, ms) {
            return Said::Refused;
        }
        if !self.faulted || self.resetting {
            self.renew(ms);
            return Said::AlreadySo;
        }
        if fit.is_err() {
            return Said::Refused;
        }
        self.renew(ms);
        self.resetting = true;
        Said::Accepted
    }

    fn event(&mut self, ms: u64, input: &Input) -> Said {
        match input {
            Input::Up { member, moves } => {
                if let Member::Manipulator(carrier) = member {
                    self.up[usize::from(*carrier == Carrier::M2)] = true;
                }
                self.begun |= self.up == [true, true] && !self.faulted;
                self.halting |= *moves && self.state() == State::Idle;
            }
            Input::Lost(Member::Manipulator(carrier), _) => {
                self.up[usize::from(*carrier == Carrier::M2)] = false;
                if self.state() != State::Offline {
                    self.fault();
                }
            }
            Input::Lost(Member::Stage, _) if self.state() != State::Offline => self.fault(),
            Input::Lost(Member::Sensor, _) if self.state() == State::Scanning => self.fault(),
            Input::Fault(_) => self.fault(),
            Input::Finished if self.moving() => (self.busy, self.job) = (None, None),
            Input::GivenUp(_) if self.moving() => self.halt(),
            Input::AtRest if self.state() == State::Stopping => {
                (self.halting, self.busy, self.job) = (false, None, None);
            }
            Input::Reread if self.faulted && self.resetting && self.up == [true, true] => {
                (self.faulted, self.resetting, self.begun) = (false, false, true);
            }
            Input::Time => self.expire(ms),
            _ => {}
        }
        Said::Accepted
    }
}

fn fault(rng: &mut ChaCha8Rng) -> Fault {
    let device = ["m1", "m2", "stage"][rng.random_range(0..3)].to_owned();
    let failure = Failure::DeviceFault { device: device.clone(), code: rng.random_range(0..3) };
    Fault { device, failure, at: now() }
}

fn member(rng: &mut ChaCha8Rng) -> Member {
    let all = [
        Member::Manipulator(Carrier::M1),
        Member::Manipulator(Carrier::M2),
        Member::Manipulator(Carrier::M1),
        Member::Manipulator(Carrier::M2),
        Member::Stage,
        Member::Sensor,
    ];
    all[rng.random_range(0..all.len())]
}

fn activity(rng: &mut ChaCha8Rng) -> Activity {
    let job = format!("job-{}", rng.random_range(0..3));
    match rng.random_range(0..5) {
        0 => Activity::Home(Carrier::M1),
        1 | 2 => Activity::Scan(job),
        _ => Activity::Move(job),
    }
}

/// Successful events are more frequent than failures, because otherwise the machine would hardly ever leave `faulted`.
fn input(rng: &mut ChaCha8Rng) -> Input {
    let lease = ["a", "a", "a", "b"][rng.random_range(0..4)].to_owned();
    let fit = if rng.random_ratio(3, 4) { Ok(()) } else { Err(Refusal::NotThere { what: "test" }) };
    match rng.random_range(0..100) {
        0..12 => {
            let time_to_live = Duration::from_secs(2);
            Input::TakeLease(LeaseRequest { id: lease, holder: "test".to_owned(), time_to_live })
        }
        12..18 => Input::RenewLease(lease),
        18..20 => Input::ReleaseLease(lease),
        20..26 => {
            let taken = if rng.random_ratio(1, 2) { Taken::Accepted } else { Taken::AlreadySo };
            let fit = fit.map(|()| taken);
            Input::Command { lease, carrier: Carrier::M1, manual: Manual::Enable, fit }
        }
        26..44 => Input::Start { lease, activity: activity(rng), fit },
        44..48 => Input::Stop,
        48..60 => Input::Reset { lease, fit },
        60..68 => Input::Up { member: member(rng), moves: rng.random_ratio(1, 4) },
        68..70 => {
            let fault = fault(rng);
            Input::Lost(member(rng), fault)
        }
        70..72 => Input::Fault(fault(rng)),
        72..76 => Input::Finished,
        76..78 => Input::GivenUp(Failure::ProfilesNotTaken),
        78..86 => Input::AtRest,
        86..94 => Input::Reread,
        _ => Input::Time,
    }
}

/// The invariants after every step, independent of the model.
#[derive(Default)]
struct Watch {
    job_open: bool,
    begun_count: u64,
    ended_count: u64,
    halted_count: u64,
}

impl Watch {
    fn look(&mut self, before: &Machine, after: &Machine, at: Instant, input: &Input, verdict: &Verdict) {
        let Verdict::Accepted(acts) = verdict else { return };
        for act in acts {
            match act {
                Effect::Begin => {
                    let leased = before.leases().held(at).is_some();
                    assert!(leased && before.state() == State::Idle && before.faults().is_empty() && !before.closing());
                    self.begun_count += 1;
                    self.job_open = after.activity().is_some_and(|activity| activity.job().is_some());
                }
                Effect::End(end) => {
                    assert!(self.job_open, "an end without a job: {end:?}");
                    self.job_open = false;
                    self.ended_count += 1;
                    assert_eq!(*end == JobEnd::Done, *input == Input::Finished);
                }
                Effect::Halt => self.halted_count += 1,
                Effect::Command(..) | Effect::Reread | Effect::Note(_) => {}
            }
        }
        let moved = |machine: &Machine| matches!(machine.state(), State::Moving | State::Scanning);
        if moved(before) && !moved(after) && *input != Input::Finished {
            assert!(acts.contains(&Effect::Halt), "the motion ended without a halt: {input:?} {acts:?}");
        }
        assert!(after.leases().fence() >= before.leases().fence());
        if before.state() == State::Faulted && after.state() != State::Faulted {
            assert!(*input == Input::Reread && before.resetting());
        }
    }
}

#[tokio::test(start_paused = true)]
async fn the_machine_agrees_with_a_small_model_over_a_hundred_thousand_steps() {
    let start = now();
    let mut watch = Watch::default();
    for round in 0..STEPS_COUNT / STEPS_A_MACHINE {
        let mut rng = ChaCha8Rng::seed_from_u64(round as u64);
        let (mut machine, mut model, mut ms) = (Machine::new(start, BOUNDS, 7), Model::default(), 0);
        model.fence = 7;
        watch.job_open = false;
        for step in 0..STEPS_A_MACHINE {
            ms += [0, 1, 10, 100, 400][rng.random_range(0..5)];
            let at = start + Duration::from_millis(ms);
            let input = if step + 20 == STEPS_A_MACHINE { Input::Close } else { input(&mut rng) };
            let before = machine.clone();
            let verdict = machine.put(at, input.clone());
            let expected = model.put(ms, &input);
            let told = format!("seed {round}, step {step}: {input:?} gave {verdict:?}; before it {before:?}");
            match &verdict {
                Verdict::Refused(_) => {
                    assert_eq!(expected, Said::Refused, "{told}");
                    assert_eq!(machine, before, "a refusal changes nothing; {told}");
                }
                // For an event it makes no difference whether the state was already reached.
                Verdict::AlreadySo => assert_ne!(expected, Said::Refused, "{told}"),
                Verdict::Accepted(_) => assert_eq!(expected, Said::Accepted, "{told}"),
            }
            let requests = matches!(input, Input::TakeLease(_) | Input::Command { .. } | Input::Start { .. });
            if requests || matches!(input, Input::Reset { .. }) {
                assert_eq!(verdict == Verdict::AlreadySo, expected == Said::AlreadySo, "{told}");
            }
            if matches!(input, Input::Stop | Input::Close) {
                let halts = matches!(&verdict, Verdict::Accepted(acts) if acts.contains(&Effect::Halt));
                assert!(halts, "a stop is always accepted; {told}");
            }
            assert_eq!(machine.state(), model.state(), "{told}");
            assert_eq!(machine.leases().fence(), model.fence, "{told}");
            watch.look(&before, &machine, at, &input, &verdict);
        }
    }
    // The random inputs have covered the important transitions.
    let Watch { begun_count, ended_count, halted_count, .. } = watch;
    let counts = format!("{begun_count} begun, {ended_count} ended, {halted_count} halts");
    assert!(begun_count > 300 && ended_count > 150 && halted_count > 3_000, "{counts}");
}

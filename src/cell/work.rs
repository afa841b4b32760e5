//! The active work of the cell (a path, a homing or a scan) with its job, and the purposes of the commands whose outcome is not yet
//! known. Pure.

use super::driver::messages::{Acquisition, Outcome};
use super::failure::JobEnd;
use super::input::Manual;
use super::request::{Job, JobState};
use super::run::Homing;
use super::run::{Run, Step};
use super::scanning::{ScanStep, Scanning};
use super::snapshot::JobView;
use crate::device::{Reading, StageReading};
use crate::motion::{Carrier, Pair, Position};
use tokio::sync::watch;
use tokio::time::Instant;

/// The kinds of work.
#[derive(Debug)]
pub(super) enum Work {
    Run(Box<Run>),
    Home(Homing),
    Scan(Box<Scanning>, Option<Acquisition>),
}

/// The next step of the work.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Next {
    Manipulators(Step),
    Scan(ScanStep),
}

/// The work under way, and its job.
#[derive(Debug)]
pub(super) struct ActiveWork {
    pub(super) work: Work,
    job: Option<(Job, watch::Sender<JobState>)>,
}

/// The purpose of a command to a driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// A step of the work, by a manipulator.
    Work(Carrier),
    /// A step of the scan, by the stage.
    Carry,
    /// A step of the scan, by the sensor.
    Arm,
    /// A manual command.
    Manual(Carrier, Manual),
    /// Acknowledges a fault of the device itself.
    Reset(Carrier),
}

impl Purpose {
    /// Whether its outcome is irrelevant after the work has ended.
    pub(super) const fn is_work(self) -> bool {
        matches!(self, Self::Work(_) | Self::Carry | Self::Arm)
    }
}

impl ActiveWork {
    /// Work without a job.
    pub(super) const fn homing(homing: Homing) -> Self {
        Self { work: Work::Home(homing), job: None }
    }

    /// Work that is a job.
    pub(super) fn job(work: Work, id: &str) -> (Self, Job) {
        let (job, reporter) = Job::new(id.to_owned());
        (Self { work, job: Some((job.clone(), reporter)) }, job)
    }

    /// The job, if it has this id.
    pub(super) fn job_named(&self, id: &str) -> Option<Job> {
        self.job.as_ref().filter(|(job, _)| job.id == id).map(|(job, _)| job.clone())
    }

    pub(super) fn view(&self) -> Option<JobView> {
        let (job, _) = self.job.as_ref()?;
        Some(JobView { id: job.id.clone(), progress: self.progress() })
    }

    /// Reports the progress, if it has changed.
    pub(super) fn report_progress(&self) {
        let Some((_, reporter)) = &self.job else { return };
        let progress = self.progress();
        reporter.send_if_modified(|state| {
            let new = JobState::Running { progress };
            let changed = *state != new && !matches!(state, JobState::Ended(_));
            if changed {
                *state = new;
            }
            changed
        });
    }

    pub(super) fn report_end(&self, end: JobEnd) {
        if let Some((_, reporter)) = &self.job {
            reporter.send_replace(JobState::Ended(end));
        }
    }

    fn progress(&self) -> f64 {
        match &self.work {
            Work::Run(run) => run.progress(),
            Work::Scan(scanning, _) => scanning.progress(),
            Work::Home(_) => 0.0,
        }
    }

    pub(super) fn begin(&self) -> Next {
        match &self.work {
            Work::Run(run) => Next::Manipulators(run.begin()),
            Work::Home(homing) => Next::Manipulators(homing.begin()),
            Work::Scan(scanning, _) => Next::Scan(scanning.begin()),
        }
    }

    pub(super) fn deadline(&self) -> Instant {
        match &self.work {
            Work::Run(run) => run.deadline(),
            Work::Home(homing) => homing.deadline(),
            Work::Scan(scanning, _) => scanning.deadline(),
        }
    }

    pub(super) fn time(&self, now: Instant, positions: &Pair<Option<Position>>, stage: Option<&StageReading>) -> Next {
        match &self.work {
            Work::Run(run) => Next::Manipulators(run.time(now, positions)),
            Work::Home(homing) => Next::Manipulators(homing.time(now)),
            Work::Scan(scanning, _) => Next::Scan(scanning.time(now, stage)),
        }
    }

    pub(super) fn read(&mut self, now: Instant, carrier: Carrier, asked_at: Instant, reading: &Reading) -> Next {
        match &mut self.work {
            Work::Run(run) => Next::Manipulators(run.read(now, carrier, asked_at, reading)),
            Work::Home(homing) => Next::Manipulators(homing.read(carrier, reading)),
            Work::Scan(..) => Next::Scan(ScanStep::Wait),
        }
    }

    pub(super) fn take_outcome(&mut self, now: Instant, purpose: Purpose, outcome: Outcome) -> Next {
        match (&mut self.work, purpose) {
            (Work::Run(run), Purpose::Work(carrier)) => Next::Manipulators(run.take_outcome(now, carrier, outcome)),
            (Work::Home(homing), Purpose::Work(carrier)) => Next::Manipulators(homing.take_outcome(carrier, outcome)),
            (Work::Scan(scanning, _), Purpose::Carry) => Next::Scan(scanning.stage_outcome(now, outcome)),
            (Work::Scan(scanning, _), Purpose::Arm) => Next::Scan(scanning.sensor_outcome(now, outcome)),
            (Work::Run(_) | Work::Home(_) | Work::Scan(..), _) => Next::Manipulators(Step::Wait),
        }
    }

    /// The scan, if the work is one.
    pub(super) const fn scan(&mut self) -> Option<&mut Scanning> {
        match &mut self.work {
            Work::Scan(scanning, _) => Some(scanning),
            Work::Run(_) | Work::Home(_) => None,
        }
    }

    /// The acquisition for the sensor; it can be taken only once.
    pub(super) const fn taking(&mut self) -> Option<Acquisition> {
        match &mut self.work {
            Work::Scan(_, taking) => taking.take(),
            Work::Run(_) | Work::Home(_) => None,
        }
    }
}

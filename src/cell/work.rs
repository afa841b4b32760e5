//! What is under way, whichever it is, with the one that is told about it; and what the orders were for whose word is still
//! out. Pure.

use super::driver::{Outcome, Taking};
use super::homing::Homing;
use super::input::Manual;
use super::job::{Job, JobEnd, JobState};
use super::run::{Run, Step};
use super::scanning::{ScanStep, Scanning};
use super::snapshot::JobView;
use crate::device::{Reading, StageReading};
use crate::motion::{Carrier, Pair, Position};
use tokio::sync::watch;
use tokio::time::Instant;

/// One of the things that can be under way.
#[derive(Debug)]
pub(super) enum Work {
    Run(Box<Run>),
    Home(Homing),
    Scan(Box<Scanning>, Option<Taking>),
}

/// The next step of whichever it is.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Next {
    Manipulators(Step),
    Scan(ScanStep),
}

/// What is under way, and the job that it is.
#[derive(Debug)]
pub(super) struct Course {
    pub(super) work: Work,
    job: Option<(Job, watch::Sender<JobState>)>,
}

/// What an order was for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// The work under way, at a manipulator.
    Work(Carrier),
    /// The scan under way, at the stage.
    Carry,
    /// The scan under way, at the sensor.
    Arm,
    /// A manual command.
    Manual(Carrier, Manual),
    /// To acknowledge a device's own fault.
    Reset(Carrier),
}

impl Purpose {
    /// Whether its word has no meaning when the work is over.
    pub(super) const fn is_work(self) -> bool {
        matches!(self, Self::Work(_) | Self::Carry | Self::Arm)
    }
}

impl Course {
    /// Work without a job.
    pub(super) const fn homing(homing: Homing) -> Self {
        Self { work: Work::Home(homing), job: None }
    }

    /// Work that is a job.
    pub(super) fn job(work: Work, id: &str) -> (Self, Job) {
        let (job, told) = Job::new(id.to_owned());
        (Self { work, job: Some((job.clone(), told)) }, job)
    }

    /// The job with this id, where it is that.
    pub(super) fn job_named(&self, id: &str) -> Option<Job> {
        self.job.as_ref().filter(|(job, _)| job.id == id).map(|(job, _)| job.clone())
    }

    pub(super) fn view(&self) -> Option<JobView> {
        let (job, _) = self.job.as_ref()?;
        Some(JobView { id: job.id.clone(), progress: self.progress() })
    }

    /// Tells how far it is, where that has changed.
    pub(super) fn tell_progress(&self) {
        let Some((_, told)) = &self.job else { return };
        let progress = self.progress();
        told.send_if_modified(|state| {
            let new = JobState::Running { progress };
            let changed = *state != new && !matches!(state, JobState::Ended(_));
            if changed {
                *state = new;
            }
            changed
        });
    }

    pub(super) fn tell_end(&self, end: JobEnd) {
        if let Some((_, told)) = &self.job {
            told.send_replace(JobState::Ended(end));
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

    pub(super) fn told(&mut self, now: Instant, purpose: Purpose, outcome: Outcome) -> Next {
        match (&mut self.work, purpose) {
            (Work::Run(run), Purpose::Work(carrier)) => Next::Manipulators(run.told(now, carrier, outcome)),
            (Work::Home(homing), Purpose::Work(carrier)) => Next::Manipulators(homing.told(carrier, outcome)),
            (Work::Scan(scanning, _), Purpose::Carry) => Next::Scan(scanning.stage_told(now, outcome)),
            (Work::Scan(scanning, _), Purpose::Arm) => Next::Scan(scanning.sensor_told(now, outcome)),
            (Work::Run(_) | Work::Home(_) | Work::Scan(..), _) => Next::Manipulators(Step::Wait),
        }
    }

    /// The scan, where it is one.
    pub(super) const fn scan(&mut self) -> Option<&mut Scanning> {
        match &mut self.work {
            Work::Scan(scanning, _) => Some(scanning),
            Work::Run(_) | Work::Home(_) => None,
        }
    }

    /// What the sensor is to do; once.
    pub(super) const fn taking(&mut self) -> Option<Taking> {
        match &mut self.work {
            Work::Scan(_, taking) => taking.take(),
            Work::Run(_) | Work::Home(_) => None,
        }
    }
}

//! Answers what is asked: finds out whether path and devices allow it, puts it to the machine, and replies at once.

use super::Task;
use crate::cell::driver::Taking;
use crate::cell::homing::Homing;
use crate::cell::input::{Activity, Input, Manual, Taken};
use crate::cell::job::Job;
use crate::cell::lease::{Lease, LeaseRequest};
use crate::cell::now;
use crate::cell::obstacles;
use crate::cell::refusal::Refusal;
use crate::cell::request::{Reply, Request, ScanBegun, answer};
use crate::cell::run::Run;
use crate::cell::scanning::Scanning;
use crate::cell::settings::ScanOrder;
use crate::cell::work::{Course, Work};
use crate::motion::{Carrier, Path, check_path};
use tokio::sync::mpsc;

/// Batches of profiles that may wait for the one that takes them.
const PROFILES_WAITING: usize = 64;
/// Jobs that are remembered, so that none is begun twice.
const JOBS_REMEMBERED: usize = 256;

impl Task {
    /// `None`: nobody holds the cell any more, so that it is closed.
    pub(super) fn take_request(&mut self, request: Option<Request>) {
        // A lease that has run out is over before anything else is decided.
        self.tell(Input::Time);
        match request {
            None => {
                self.held = false;
                self.tell(Input::Close);
            }
            Some(Request::Close(closer)) => {
                self.closers.push(closer);
                self.tell(Input::Close);
            }
            Some(Request::TakeLease(request, reply)) => answer(reply, self.take_lease(request)),
            Some(Request::RenewLease(id, reply)) => answer(reply, self.renew_lease(id)),
            Some(Request::ReleaseLease(id, reply)) => answer(reply, self.put(Input::ReleaseLease(id)).map(drop)),
            Some(request @ (Request::Act { .. } | Request::Move { .. })) => self.answer_or_wait(request),
            Some(Request::Scan { lease, job, order, reply }) => self.start_scan(lease, &job, order, reply),
            Some(Request::Reset { lease, reply }) => {
                let fit = obstacles::of_reset(&self.live, self.live_stage.as_ref(), now());
                answer(reply, self.put(Input::Reset { lease, fit }));
            }
        }
    }

    fn take_lease(&mut self, request: LeaseRequest) -> Result<Lease, Refusal> {
        self.put(Input::TakeLease(request))?;
        self.flag.set_fence(self.machine.tenancy().fence());
        self.machine.tenancy().held(now()).cloned().ok_or(Refusal::LeaseOver)
    }

    fn renew_lease(&mut self, id: String) -> Result<Lease, Refusal> {
        self.put(Input::RenewLease(id))?;
        self.machine.tenancy().held(now()).cloned().ok_or(Refusal::LeaseOver)
    }

    pub(super) fn manual(&mut self, lease: String, carrier: Carrier, manual: Manual) -> Result<Taken, Refusal> {
        let fit = match self.outdated(carrier, now()) {
            Some(refusal) => Err(refusal),
            None => obstacles::of_manual(&self.live, carrier, manual, now()),
        };
        match manual {
            Manual::Home if fit == Ok(Taken::AlreadySo) && !self.works() => {
                self.put(Input::Command { lease, carrier, manual, fit })
            }
            Manual::Enable | Manual::Disable => self.put(Input::Command { lease, carrier, manual, fit }),
            Manual::Home => {
                let names = self.live.map(|_, one| one.name.clone());
                self.prepared = Some(Course::homing(Homing::new(carrier, names, &self.settings, now())));
                self.put(Input::Start { lease, activity: Activity::Home(carrier), fit: fit.map(drop) })
            }
        }
    }

    pub(super) fn start_move(&mut self, lease: String, job: &str, path: Path) -> Result<Job, Refusal> {
        if let Some(job) = self.under_way(&lease, job)? {
            return Ok(job);
        }
        let fit = self.fit_to_move(job, &path);
        let names = self.live.map(|_, one| one.name.clone());
        let (course, told) = Course::job(Work::Run(Box::new(Run::new(path, names, &self.settings, now()))), job);
        self.prepared = Some(course);
        self.put(Input::Start { lease, activity: Activity::Move(job.to_owned()), fit })?;
        self.remember(job);
        Ok(told)
    }

    /// The same job, where it is under way: its holder has lost the answer, and asks again.
    fn under_way(&mut self, lease: &str, job: &str) -> Result<Option<Job>, Refusal> {
        let Some(job) = self.course.as_ref().filter(|_| self.works()).and_then(|course| course.job_named(job)) else {
            return Ok(None);
        };
        self.put(Input::RenewLease(lease.to_owned()))?;
        Ok(Some(job))
    }

    fn fit_to_move(&self, job: &str, path: &Path) -> Result<(), Refusal> {
        let now = now();
        self.not_begun(job)?;
        if let Some(outdated) = Carrier::ALL.into_iter().find_map(|carrier| self.outdated(carrier, now)) {
            return Err(outdated);
        }
        if let Some(obstacle) = obstacles::of_move(&self.live, now).into_iter().next() {
            return Err(obstacle);
        }
        let actual = obstacles::positions(&self.live, now)?;
        check_path(&self.settings.arrangement, &actual, path)?;
        obstacles::of_own_limits(&self.live, path, now)
    }

    fn start_scan(&mut self, lease: String, job: &str, order: ScanOrder, reply: Reply<ScanBegun>) {
        let prepared = self.prepare_scan(job, order);
        let (fit, begun) = match prepared {
            Ok(begun) => (Ok(()), Some(begun)),
            Err(refusal) => (Err(refusal), None),
        };
        let taken = self.put(Input::Start { lease, activity: Activity::Scan(job.to_owned()), fit });
        match (taken, begun) {
            (Ok(_), Some(begun)) => {
                self.remember(job);
                answer(reply, Ok(begun));
            }
            // The machine accepts nothing that is not fit.
            (Ok(_), None) => answer(reply, Err(Refusal::NotThere { what: "scan" })),
            (Err(refusal), _) => answer(reply, Err(refusal)),
        }
    }

    fn prepare_scan(&mut self, job: &str, order: ScanOrder) -> Result<ScanBegun, Refusal> {
        self.not_begun(job)?;
        obstacles::of_scan(&self.live, self.live_stage.as_ref(), self.live_sensor.as_ref(), &order, now())?;
        let from = self.live_stage.as_ref().and_then(|stage| stage.reading);
        let from = from.ok_or(Refusal::NotThere { what: "stage" })?;
        let (sink, profiles) = mpsc::channel(PROFILES_WAITING);
        let patience = self.settings.scan_stall;
        let taking = Taking { profiles_count: order.profiles_count, sink, patience };
        let names = (self.stage_name(), self.sensor_name());
        let waits = (&self.settings, &self.lines.sensor_deadlines);
        let scanning = Scanning::new(order, names, from, waits, now());
        let (course, told) = Course::job(Work::Scan(Box::new(scanning), Some(taking)), job);
        self.prepared = Some(course);
        Ok((told, profiles))
    }

    fn not_begun(&self, job: &str) -> Result<(), Refusal> {
        if self.begun.iter().any(|begun| begun == job) {
            return Err(Refusal::Repeated { job: job.to_owned() });
        }
        Ok(())
    }

    fn remember(&mut self, job: &str) {
        if self.begun.len() == JOBS_REMEMBERED {
            self.begun.pop_front();
        }
        self.begun.push_back(job.to_owned());
    }
}

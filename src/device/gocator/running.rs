//! A running scan: the data channel, which is read as fast as data arrive, and its deadlines.

use super::assembly::{Assembly, AssemblyError};
use super::channel::{Channel, Peer};
use super::codec::decode;
use super::health::HealthLink;
use super::settings::{Checked, duration};
use crate::device::error::{DeviceError, ScanFault};
use crate::device::sensor::Profile;
use std::pin::Pin;
use std::time::Duration;
use tokio::time::{Sleep, sleep};

/// A deadline that is renewed by each event.
#[derive(Debug)]
struct Patience {
    within: Duration,
    end: Pin<Box<Sleep>>,
}

impl Patience {
    fn new(within: Duration) -> Self {
        Self { within, end: Box::pin(sleep(within)) }
    }
}

/// A running scan.
#[derive(Debug)]
pub(super) struct RunningScan {
    channel: Channel,
    assembly: Assembly,
    next_within: Duration,
    profiles: Patience,
    health: Patience,
    /// The error that ended the scan.
    failed: Option<DeviceError>,
}

/// No profile was received within the deadline.
pub(super) struct ProfileTimeout {
    pub(super) within: Duration,
}

impl RunningScan {
    /// Connects before the sensor is started, because frames without a client are lost.
    pub(super) async fn open(peer: &Peer, checked: &Checked, profiles_count: u64) -> Result<Self, DeviceError> {
        let Checked { settings, travel, placement } = checked;
        let deadlines = settings.deadlines;
        let frame_bytes_max = settings.frame_mb_max as usize * 1024 * 1024;
        let within = duration(deadlines.connect_ms);
        Ok(Self {
            channel: Channel::open(peer, settings.data_port, within, frame_bytes_max).await?,
            assembly: Assembly::new(*placement, *travel, profiles_count),
            next_within: duration(deadlines.next_profile_ms),
            profiles: Patience::new(duration(deadlines.first_profile_ms)),
            health: Patience::new(duration(deadlines.health_ms)),
            failed: None,
        })
    }

    /// Starts the deadlines.
    pub(super) fn begin(&mut self) {
        self.profiles = Patience::new(self.profiles.within);
        self.health = Patience::new(self.health.within);
    }

    pub(super) fn is_complete(&self) -> bool {
        self.assembly.is_complete()
    }

    pub(super) fn failure(&self) -> Option<DeviceError> {
        self.failed.clone()
    }

    /// Ends the scan with this error, unless it has already ended with another one.
    pub(super) fn fail(&mut self, error: DeviceError) -> DeviceError {
        self.failed.get_or_insert(error).clone()
    }

    pub(super) fn incomplete(&self) -> ScanFault {
        self.assembly.incomplete()
    }

    /// Waits for the next profiles. It can be dropped at any time without losing data.
    pub(super) async fn next(
        &mut self,
        health: &mut HealthLink,
    ) -> Result<Result<Vec<Profile>, ProfileTimeout>, DeviceError> {
        loop {
            let profiles = self.take_all()?;
            if !profiles.is_empty() {
                self.profiles = Patience::new(self.next_within);
                return Ok(Ok(profiles));
            }
            tokio::select! {
                biased;
                heard = health.hear() => {
                    heard?;
                    self.health = Patience::new(self.health.within);
                    if let Some(fault) = health.status.fault() {
                        return Err(DeviceError::ScanFault { device: self.channel.peer.device.clone(), fault });
                    }
                }
                filled = self.channel.fill() => filled?,
                () = self.profiles.end.as_mut() => return Ok(Err(ProfileTimeout { within: self.profiles.within })),
                () = self.health.end.as_mut() => return Err(self.channel.peer.silent(self.health.within)),
            }
        }
    }

    /// The profiles of the received frames. After a fault it returns none, because the scan is incomplete.
    fn take_all(&mut self) -> Result<Vec<Profile>, DeviceError> {
        let Self { channel, assembly, .. } = self;
        let peer = channel.peer.clone();
        let mut take_next = || -> Result<bool, AssemblyError> {
            let Some(frame) = channel.frame()? else { return Ok(false) };
            assembly.take(&decode(frame)?)?;
            Ok(true)
        };
        loop {
            match take_next() {
                Ok(true) => {}
                Ok(false) => return Ok(assembly.take_ready()),
                Err(AssemblyError::Fault(fault)) => return Err(DeviceError::ScanFault { device: peer.device, fault }),
                Err(error) => return Err(peer.implausible(&error)),
            }
        }
    }
}

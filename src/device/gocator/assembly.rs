//! Assembles the messages of the data channel into profiles in the rail frame. The last message of a group is marked; a group is a
//! frame: its stamps first, then its data. Every gap or fault ends the scan with its reason. Pure: no socket, no clock.

use super::codec::{CodecError, Framed, INVALID, Message, Profiles, Stamp, Stamps, Surface};
use super::extrinsic::Placement;
use super::travel::{Odometer, Stuck, Travel};
use crate::device::error::ScanFault;
use crate::device::sensor::Profile;

/// Why a message does not belong to a scan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum AssemblyError {
    #[error(transparent)]
    Fault(#[from] ScanFault),
    #[error(transparent)]
    Codec(#[from] CodecError),
    #[error("a profile has no stamp")]
    Unstamped,
    #[error("{stamps_count} stamps were received for {profiles_count} profiles")]
    StampCount { stamps_count: usize, profiles_count: u32 },
    #[error("a frame has profiles in two forms; switch off all but one of them in the sensor's output")]
    TwoForms,
    #[error("the sensor's clock went from {from} to {to}")]
    Clock { from: u64, to: u64 },
    #[error(
        "the position of a surface on the rail cannot be determined from zero_ticks; leave it out, or switch on profiles"
    )]
    SurfaceByZero,
}

impl From<Stuck> for AssemblyError {
    fn from(stuck: Stuck) -> Self {
        match stuck {
            Stuck::Encoder(fault) => fault.into(),
            Stuck::Clock { from, to } => Self::Clock { from, to },
        }
    }
}

/// The received part of a scan.
#[derive(Debug)]
pub(super) struct Assembly {
    placement: Placement,
    start_mm: Option<f64>,
    odometer: Odometer,
    expected_count: u64,
    received_count: u64,
    next_frame: Option<u64>,
    /// Stamps of the current group.
    stamps: Vec<Stamp>,
    /// Whether the current group has contained any data.
    seen: bool,
    ready: Vec<Profile>,
}

impl Assembly {
    pub(super) fn new(placement: Placement, travel: Travel, expected_count: u64) -> Self {
        Self {
            placement,
            start_mm: travel.start_mm(),
            odometer: Odometer::new(travel),
            expected_count,
            received_count: 0,
            next_frame: None,
            stamps: Vec::new(),
            seen: false,
            ready: Vec::new(),
        }
    }

    /// Whether the requested number of profiles was received.
    pub(super) fn is_complete(&self) -> bool {
        self.received_count >= self.expected_count
    }

    /// The profiles completed since the last call.
    pub(super) fn take_ready(&mut self) -> Vec<Profile> {
        std::mem::take(&mut self.ready)
    }

    /// Takes the next message. Messages after the complete scan are ignored.
    pub(super) fn take(&mut self, framed: &Framed<'_>) -> Result<(), AssemblyError> {
        if self.is_complete() {
            return Ok(());
        }
        match &framed.message {
            Message::Stamps(stamps) => self.open(stamps)?,
            Message::PointClouds(profiles) => self.take_point_clouds(profiles)?,
            Message::Uniform(profiles) => self.take_uniform(profiles)?,
            Message::Surface(surface) => self.take_surface(surface)?,
            Message::Intensity(_) | Message::Health(_) | Message::Other { .. } => {}
        }
        if framed.last { self.close() } else { Ok(()) }
    }

    /// Begins a group with its stamps. The frame numbers must follow each other without a gap.
    fn open(&mut self, stamps: &Stamps<'_>) -> Result<(), AssemblyError> {
        for stamp in stamps.iter() {
            let found = stamp.frame_index;
            match self.next_frame {
                Some(expected) if found != expected => return Err(ScanFault::FrameGap { expected, found }.into()),
                _ => self.next_frame = Some(found.wrapping_add(1)),
            }
            self.stamps.push(stamp);
        }
        Ok(())
    }

    /// Ends a group. Stamps without data mean that the sensor sends other messages.
    fn close(&mut self) -> Result<(), AssemblyError> {
        let blind = !self.stamps.is_empty() && !self.seen;
        self.stamps.clear();
        self.seen = false;
        if blind { Err(ScanFault::NoProfiles.into()) } else { Ok(()) }
    }

    fn see(&mut self) -> Result<(), AssemblyError> {
        if self.stamps.is_empty() {
            return Err(AssemblyError::Unstamped);
        }
        if self.seen {
            return Err(AssemblyError::TwoForms);
        }
        self.seen = true;
        Ok(())
    }

    /// The stamps of this number of profiles, one for each.
    fn stamps_of(&mut self, profiles_count: u32) -> Result<Vec<Stamp>, AssemblyError> {
        self.see()?;
        let stamps_count = self.stamps.len();
        if u64::from(profiles_count) != stamps_count as u64 {
            return Err(AssemblyError::StampCount { stamps_count, profiles_count });
        }
        Ok(self.stamps.clone())
    }

    fn take_point_clouds(&mut self, profiles: &Profiles<'_>) -> Result<(), AssemblyError> {
        let stamps = self.stamps_of(profiles.count)?;
        for (stamp, points) in stamps.iter().zip(profiles.point_clouds()) {
            let points =
                Exactly(profiles.width as usize, points.map(|[x, z]| ((x != INVALID).then_some(f64::from(x)), z)));
            let travel_mm = self.odometer.at(stamp)?;
            self.add(travel_mm, profiles, points);
        }
        Ok(())
    }

    fn take_uniform(&mut self, profiles: &Profiles<'_>) -> Result<(), AssemblyError> {
        let stamps = self.stamps_of(profiles.count)?;
        for (stamp, row) in stamps.iter().zip(profiles.uniform()) {
            let travel_mm = self.odometer.at(stamp)?;
            let points = Exactly(profiles.width as usize, row.enumerate().map(|(at, z)| (Some(at as f64), z)));
            self.add(travel_mm, profiles, points);
        }
        Ok(())
    }

    fn add(
        &mut self,
        travel_mm: f64,
        profiles: &Profiles<'_>,
        points: impl ExactSizeIterator<Item = (Option<f64>, i16)>,
    ) {
        if self.is_complete() {
            return;
        }
        let profile = self.placement.profile(self.received_count, travel_mm, [profiles.x, profiles.z], points);
        self.ready.push(profile);
        self.received_count += 1;
    }

    /// A surface is a complete scan: its rows are the profiles. A second surface could not be placed, because its start is unknown.
    fn take_surface(&mut self, surface: &Surface<'_>) -> Result<(), AssemblyError> {
        self.see()?;
        let start_mm = self.start_mm.ok_or(AssemblyError::SurfaceByZero)?;
        let step_mm = self.placement.forwards() * surface.y.step_mm();
        for (at, row) in surface.rows().enumerate() {
            if self.is_complete() {
                break;
            }
            let points = Exactly(surface.width as usize, row.enumerate().map(|(at, z)| (Some(at as f64), z)));
            let travel_mm = start_mm + step_mm * at as f64;
            let profile = self.placement.profile(self.received_count, travel_mm, [surface.x, surface.z], points);
            self.ready.push(profile);
            self.received_count += 1;
        }
        if self.is_complete() { Ok(()) } else { Err(self.incomplete().into()) }
    }

    pub(super) fn incomplete(&self) -> ScanFault {
        ScanFault::Incomplete { received_count: self.received_count, expected_count: self.expected_count }
    }
}

/// An iterator with a known length.
struct Exactly<I>(usize, I);

impl<I: Iterator> Iterator for Exactly<I> {
    type Item = I::Item;

    fn next(&mut self) -> Option<Self::Item> {
        let next = self.1.next()?;
        self.0 = self.0.saturating_sub(1);
        Some(next)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.0, Some(self.0))
    }
}

impl<I: Iterator> ExactSizeIterator for Exactly<I> {}

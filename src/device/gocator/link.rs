//! The adaptor of the sensor: control, data and health channels, each with its deadlines. A failure of a channel closes it; a
//! failure during a scan ends the scan.
//!
//! ```text
//! connect: control, version, identity, state, health     (the laser is not switched; if it is on, health is not awaited)
//! start:   data; stop if it is still running; start
//! receive: data -> profiles, health -> losses; no data for too long -> read the state
//! stop:    stop, also a scan of another client; after a complete scan, one more health message
//! ```

use super::channel::Control;
use super::channel::Peer;
use super::codec::{Command, Identity, SensorState};
use super::health::HealthLink;
use super::health::HealthStatus;
use super::running::RunningScan;
use super::settings::{Checked, Deadlines, Settings, SettingsError, duration};
use crate::device::error::DeviceError;
use crate::device::error::Pending;
use crate::device::sensor::{Profile, ProfileSensor, SensorDeadlines, SensorReading};

/// A Gocator. It connects only when it is requested to.
#[derive(Debug)]
pub struct Gocator {
    peer: Peer,
    checked: Checked,
    identity: Option<Identity>,
    /// Taken out while a request is under way.
    control: Option<Control>,
    health: Option<HealthLink>,
    scan: Option<RunningScan>,
    /// Whether the laser may be on: the sensor was started by this adaptor, or found running.
    may_run: bool,
}

/// A sensor with these settings that is not connected yet.
///
/// # Errors
/// [`SettingsError`] if they are not valid.
pub fn open(name: &str, settings: &Settings) -> Result<Box<dyn ProfileSensor>, SettingsError> {
    Gocator::new(name, settings).map(|sensor| Box::new(sensor) as Box<dyn ProfileSensor>)
}

impl Gocator {
    /// A sensor with these settings that is not connected yet.
    ///
    /// # Errors
    /// [`SettingsError`] if they are not valid.
    pub fn new(name: &str, settings: &Settings) -> Result<Self, SettingsError> {
        let checked = settings.checked()?;
        let peer = Peer { device: name.to_owned(), host: settings.host.clone() };
        Ok(Self { peer, checked, identity: None, control: None, health: None, scan: None, may_run: false })
    }

    /// The time of the sensor's clock, µs; 1.024 of its ticks are a microsecond.
    ///
    /// # Errors
    /// [`DeviceError`] if it does not answer.
    pub async fn clock_us(&mut self) -> Result<f64, DeviceError> {
        let ticks = self.ticks(Command::Timestamp).await?;
        Ok(u64::from_le_bytes(ticks) as f64 / 1.024)
    }

    /// The present encoder position in ticks.
    ///
    /// # Errors
    /// [`DeviceError`] if it does not answer.
    pub async fn encoder_ticks(&mut self) -> Result<i64, DeviceError> {
        self.ticks(Command::Encoder).await.map(i64::from_le_bytes)
    }

    async fn ticks(&mut self, command: Command) -> Result<[u8; 8], DeviceError> {
        let mut control = self.take_control()?;
        let answer = control.ticks(command).await;
        self.keep(control, answer)
    }

    async fn ask(&mut self, command: Command) -> Result<(), DeviceError> {
        let mut control = self.take_control()?;
        let answer = control.ask(command).await;
        self.keep(control, answer).map(|_| ())
    }

    async fn state(&mut self) -> Result<SensorState, DeviceError> {
        let mut control = self.take_control()?;
        let answer = control.state().await;
        self.keep(control, answer)
    }

    fn take_control(&mut self) -> Result<Control, DeviceError> {
        self.control.take().ok_or_else(|| self.peer.lost(&"not connected"))
    }

    /// Keeps the control channel only if the sensor has answered, because a late answer would be attributed to the next request.
    fn keep<T>(&mut self, control: Control, answer: Result<T, DeviceError>) -> Result<T, DeviceError> {
        if matches!(answer, Ok(_) | Err(DeviceError::Rejected { .. })) {
            self.control = Some(control);
        }
        answer
    }

    fn reading(&self, state: SensorState) -> Result<SensorReading, DeviceError> {
        let identity = self.identity.as_ref().ok_or_else(|| self.peer.lost(&"not connected"))?;
        Ok(SensorReading {
            model: identity.model.clone(),
            serial: identity.serial.to_string(),
            firmware: identity.firmware.map(|part| part.to_string()).join("."),
            running: state == SensorState::Running,
            temperature_c: self.health.as_ref().and_then(|health| health.status.temperature_c()),
        })
    }

    async fn connect_anew(&mut self) -> Result<SensorReading, DeviceError> {
        (self.control, self.health, self.scan, self.identity) = (None, None, None, None);
        let (peer, settings) = (&self.peer, &self.checked.settings);
        let mut control = Control::open(peer, settings).await?;
        let identity = control.identity().await?;
        if let Some(wanted) = settings.serial.filter(|wanted| *wanted != identity.serial) {
            let found = identity.serial;
            return Err(peer.implausible(&format!("its serial number is {found}, and {wanted} is configured")));
        }
        let state = control.state().await?;
        self.note_state(state);
        // A laser that is on has to be switched off before anything else, and a health message may take a second to arrive.
        let health = match HealthLink::open(&self.peer, &self.checked.settings, state != SensorState::Running).await {
            Ok(health) => health,
            Err(error) => {
                if self.may_run {
                    control.ask(Command::Stop).await?;
                    self.may_run = false;
                }
                return Err(error);
            }
        };
        (self.control, self.health, self.identity) = (Some(control), Some(health), Some(identity));
        self.reading(state)
    }

    /// A running sensor has its laser on, whichever client started it.
    fn note_state(&mut self, state: SensorState) {
        self.may_run |= state == SensorState::Running;
    }

    async fn read_once(&mut self) -> Result<SensorReading, DeviceError> {
        let state = self.state().await?;
        self.note_state(state);
        self.catch_up()?;
        self.reading(state)
    }

    /// Handles the messages of the health channel. If the channel fails, it remains closed until the next connect.
    fn catch_up(&mut self) -> Result<(), DeviceError> {
        let health = self.health.as_mut().ok_or_else(|| self.peer.lost(&"the health channel is not connected"))?;
        let heard = health.catch_up();
        if heard.is_err() {
            self.health = None;
        }
        heard
    }

    async fn start_scan(&mut self, profiles_count: u64) -> Result<(), DeviceError> {
        self.scan = None;
        self.catch_up()?;
        match self.state().await? {
            SensorState::Running => self.ask(Command::Stop).await?,
            SensorState::Ready => {}
            state => return Err(self.peer.implausible(&format!("its state is {state:?}, it cannot be started"))),
        }
        let mut scan = RunningScan::open(&self.peer, &self.checked, profiles_count).await?;
        if let Some(health) = self.health.as_mut() {
            // The counters of an earlier message distinguish losses before the scan from losses during it.
            health.hear_first().await?;
            health.status.begin_scan();
        }
        self.may_run = true;
        let started = self.ask(Command::Start).await;
        match started {
            Ok(()) => {
                scan.begin();
                self.scan = Some(scan);
            }
            // The sensor has refused, and is not running.
            Err(DeviceError::Rejected { .. }) => self.may_run = false,
            Err(_) => {}
        }
        started
    }

    async fn receive_next(&mut self) -> Result<Vec<Profile>, DeviceError> {
        let Some(scan) = self.scan.as_mut() else {
            return Err(DeviceError::Unsupported {
                device: self.peer.device.clone(),
                what: "receive profiles: no scan was started".to_owned(),
            });
        };
        if let Some(error) = scan.failure() {
            return Err(error);
        }
        if scan.is_complete() {
            return Err(DeviceError::Unsupported {
                device: self.peer.device.clone(),
                what: "receive more profiles than were requested".to_owned(),
            });
        }
        let Some(health) = self.health.as_mut() else {
            return Err(scan.fail(self.peer.lost(&"the health channel is not connected")));
        };
        let quiet = match scan.next(health).await {
            Ok(Ok(profiles)) => return Ok(profiles),
            Ok(Err(quiet)) => quiet,
            Err(error) => return Err(scan.fail(error)),
        };
        let state = self.state().await;
        let scan = self.scan.as_mut().ok_or_else(|| self.peer.lost(&"no scan"))?;
        // A sensor that has stopped by itself sends no more profiles; one that is running may hang, or wait for its trigger.
        Err(scan.fail(match state? {
            SensorState::Ready => DeviceError::ScanFault { device: self.peer.device.clone(), fault: scan.incomplete() },
            _ => self.peer.silent(quiet.within),
        }))
    }

    /// Switches the laser off first, over a new control channel if the old one was lost.
    async fn stop_scan(&mut self) -> Result<(), DeviceError> {
        let scan = self.scan.take();
        let (scanned, whole) = (scan.is_some(), scan.is_some_and(|scan| scan.is_complete()));
        if !self.may_run && self.control.is_some() {
            let state = self.state().await?;
            self.note_state(state);
        }
        if !self.may_run {
            return Ok(());
        }
        if self.control.is_none() {
            self.control = Some(Control::open(&self.peer, &self.checked.settings).await?);
        }
        // Health messages from before the stop do not show the end of the scan; those after its reply do, and are awaited below.
        let mut heard = self.health.as_mut().map_or(Ok(()), HealthLink::catch_up);
        self.ask(Command::Stop).await?;
        self.may_run = false;
        let Some(health) = self.health.as_mut() else {
            return Err(self.peer.lost(&"the health channel is not connected"));
        };
        // The first message after the end reports losses at the end; after a cancelled scan they are irrelevant.
        if heard.is_ok() {
            heard = if whole { health.hear_until(HealthStatus::is_stopped).await } else { health.catch_up() };
        }
        health.status.end_scan();
        let fault = health.status.fault().filter(|_| scanned);
        if let Err(error) = heard {
            self.health = None;
            return Err(error);
        }
        fault.map_or(Ok(()), |fault| Err(DeviceError::ScanFault { device: self.peer.device.clone(), fault }))
    }
}

impl ProfileSensor for Gocator {
    fn name(&self) -> &str {
        &self.peer.device
    }

    fn connect(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>> {
        Box::pin(self.connect_anew())
    }

    fn read(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>> {
        Box::pin(self.read_once())
    }

    fn start(&mut self, profiles_count: u64) -> Pending<'_, Result<(), DeviceError>> {
        Box::pin(self.start_scan(profiles_count))
    }

    fn receive(&mut self) -> Pending<'_, Result<Vec<Profile>, DeviceError>> {
        Box::pin(self.receive_next())
    }

    fn stop(&mut self) -> Pending<'_, Result<(), DeviceError>> {
        Box::pin(self.stop_scan())
    }

    /// The sums of the deadlines of successive requests.
    fn deadlines(&self) -> SensorDeadlines {
        let Deadlines { connect_ms, reply_ms, start_stop_ms, first_profile_ms, health_ms, .. } =
            self.checked.settings.deadlines;
        let [connect, reply, start_stop, health] = [connect_ms, reply_ms, start_stop_ms, health_ms].map(duration);
        SensorDeadlines {
            connect: 2 * connect + 4 * reply + health,
            reply,
            start: reply + 2 * start_stop + connect + health,
            stop: connect + 2 * reply + start_stop + health,
            first_profile: duration(first_profile_ms),
        }
    }
}

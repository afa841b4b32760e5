//! The PLC side of the map, for a simulated PLC: controllers as blocks of registers. Device n has base 256 n under the unit ids 0,
//! 1 and 255, and base 0 under unit id n + 1; a single device has base 0 under every unit id. Input: requests; output: responses. A
//! [`Reading`] becomes the registers of the status block.

use std::future::{Ready, ready};
use std::io;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::time::Instant;
use tokio_modbus::prelude::SlaveRequest;
use tokio_modbus::server::{Service, tcp};
use tokio_modbus::{ExceptionCode, Request, Response};

use crate::device::manipulator::{AxisReading, Reading};
use crate::device::simulated::Controller;
use crate::motion::{Axes, Axis};

use super::command::decode;
use super::error::MapError;
use super::layout::{CommandMap, Layout, StatusFunction};
use crate::device::clock::now;

/// Distance between the blocks of two devices.
const BLOCK_STEP: u16 = 256;
/// The watchdog time if the map has no register for it.
const WATCHDOG: Duration = Duration::from_millis(500);

/// A simulated PLC.
#[derive(Debug)]
pub struct Plc {
    layout: Layout,
    started: Instant,
    devices: Mutex<Vec<Device>>,
}

#[derive(Debug)]
struct Device {
    controller: Controller,
    command: Vec<u16>,
    images_count: u16,
}

impl Plc {
    /// A PLC with these devices, in the order of their blocks.
    #[must_use]
    pub fn new(layout: Layout, controllers: Vec<Controller>) -> Self {
        let command = vec![0; usize::from(layout.command.count)];
        let device = |controller| Device { controller, command: command.clone(), images_count: 0 };
        Self { layout, started: now(), devices: Mutex::new(controllers.into_iter().map(device).collect()) }
    }

    /// Accesses a device at the PLC's time.
    pub fn with<T>(&self, device: usize, act: impl FnOnce(&mut Controller, Duration) -> T) -> Option<T> {
        let mut devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        devices.get_mut(device).map(|device| act(&mut device.controller, self.time()))
    }

    /// Answers one request.
    ///
    /// # Errors
    /// The exception of the protocol: functions other than 3, 4, 6 and 16; registers outside a block; commands that cannot be
    /// decoded.
    pub fn answer(&self, unit: u8, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        match request {
            Request::ReadInputRegisters(at, count) => {
                self.read(unit, *at, *count, StatusFunction::Input).map(Response::ReadInputRegisters)
            }
            Request::ReadHoldingRegisters(at, count) => {
                self.read(unit, *at, *count, StatusFunction::Holding).map(Response::ReadHoldingRegisters)
            }
            Request::WriteSingleRegister(at, word) => {
                self.write(unit, *at, &[*word]).map(|()| Response::WriteSingleRegister(*at, *word))
            }
            Request::WriteMultipleRegisters(at, words) => {
                let count = u16::try_from(words.len()).map_err(|_| ExceptionCode::IllegalDataValue)?;
                self.write(unit, *at, words).map(|()| Response::WriteMultipleRegisters(*at, count))
            }
            _ => Err(ExceptionCode::IllegalFunction),
        }
    }

    fn read(&self, unit: u8, at: u16, count: u16, kind: StatusFunction) -> Result<Vec<u16>, ExceptionCode> {
        let mut devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        let (index, at) = place(unit, at, devices.len());
        let device = devices.get_mut(index).ok_or(ExceptionCode::IllegalDataAddress)?;
        let (status, command) = (&self.layout.status, &self.layout.command);
        let words =
            within(at, count, status.base, status.count).filter(|_| kind == status.function).and_then(|range| {
                let image = device.image(&self.layout, self.time());
                image.get(range).map(<[u16]>::to_vec)
            });
        let told = || within(at, count, command.base, command.count).filter(|_| kind == StatusFunction::Holding);
        words
            .or_else(|| told().and_then(|range| device.command.get(range).map(<[u16]>::to_vec)))
            .ok_or(ExceptionCode::IllegalDataAddress)
    }

    fn write(&self, unit: u8, at: u16, words: &[u16]) -> Result<(), ExceptionCode> {
        let mut devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        let (index, at) = place(unit, at, devices.len());
        let device = devices.get_mut(index).ok_or(ExceptionCode::IllegalDataAddress)?;
        let map = &self.layout.command;
        let count = u16::try_from(words.len()).map_err(|_| ExceptionCode::IllegalDataValue)?;
        let range = within(at, count, map.base, map.count).ok_or(ExceptionCode::IllegalDataAddress)?;
        device.write(&self.layout, range, words, self.time()).map_err(|_| ExceptionCode::IllegalDataValue)
    }

    fn time(&self) -> Duration {
        now() - self.started
    }
}

impl Device {
    fn image(&mut self, layout: &Layout, time: Duration) -> Vec<u16> {
        self.images_count = self.images_count.wrapping_add(1);
        let extras = Extras {
            heartbeat_echo: self.command.get(usize::from(layout.command.heartbeat)).copied().unwrap_or(0),
            uptime_ms: (time.as_millis() & u128::from(u32::MAX)) as u32,
            snapshot: self.images_count,
        };
        status_image(layout, &self.controller.reading(time), extras)
    }

    /// Writes registers. If they do not form a valid command, the controller does not receive it and the previous registers remain.
    fn write(&mut self, layout: &Layout, range: Range<usize>, words: &[u16], time: Duration) -> Result<(), MapError> {
        let CommandMap { heartbeat, sequence, .. } = layout.command;
        let mut registers = self.command.clone();
        registers.splice(range.clone(), words.iter().copied());
        let number = registers.get(usize::from(sequence)).copied().unwrap_or(0);
        if range.contains(&usize::from(sequence)) && number != 0 {
            let command = decode(layout, &registers, WATCHDOG)?;
            self.controller.take(&command, time);
        } else if range.contains(&usize::from(heartbeat)) {
            self.controller.beat(time);
        }
        self.command = registers;
        Ok(())
    }
}

/// The index of the device, and the register relative to its base.
const fn place(unit: u8, at: u16, devices_count: usize) -> (usize, u16) {
    match unit {
        _ if devices_count == 1 => (0, at),
        0 | 1 | 255 => ((at / BLOCK_STEP) as usize, at % BLOCK_STEP),
        unit => (unit as usize - 1, at),
    }
}

/// The range of `count` registers from `at` on in a block; `None` if they are not in the block.
fn within(at: u16, count: u16, base: u16, block_count: u16) -> Option<Range<usize>> {
    let first = usize::from(at.checked_sub(base)?);
    let end = first + usize::from(count);
    (count > 0 && end <= usize::from(block_count)).then_some(first..end)
}

impl Service for Plc {
    type Request = SlaveRequest<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        ready(self.answer(request.slave, &request.request))
    }
}

/// Serves a PLC until the listener fails.
///
/// # Errors
/// The error of the operating system.
pub async fn serve(listener: TcpListener, plc: Arc<Plc>) -> io::Result<()> {
    let connected = |stream: tokio::net::TcpStream, address| {
        let plc = Arc::clone(&plc);
        async move {
            tracing::debug!(%address, "a Modbus client has connected");
            // Without this option answers may be delayed, but are not wrong.
            let _ = stream.set_nodelay(true);
            Ok(Some((plc, stream)))
        }
    };
    tcp::Server::new(listener)
        .serve(&connected, |error| tracing::debug!(%error, "a Modbus client has disconnected"))
        .await
}

/// Values of the status block besides the state.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Extras {
    /// The heartbeat of coaxis as it was received.
    pub(super) heartbeat_echo: u16,
    /// Time since the start.
    pub(super) uptime_ms: u32,
    /// Counter of the status images.
    pub(super) snapshot: u16,
}

/// Encodes the registers. A value that they cannot represent is 0, and a state without a number is shown as a fault.
pub(super) fn status_image(layout: &Layout, reading: &Reading, extras: Extras) -> Vec<u16> {
    let map = &layout.status;
    let mut image = Image { layout, registers: vec![0; usize::from(map.count)] };
    image.optional(map.magic, map.magic_value);
    image.put(map.heartbeat, reading.heartbeat);
    image.optional(map.heartbeat_echo, extras.heartbeat_echo);
    image.put(map.mode, layout.codes.modes.code(reading.mode));
    image.put(map.safety, image.safety(reading));
    image.put(map.state, image.state(reading.state));
    image.put(map.sequence, reading.acknowledged.sequence);
    image.put(map.result, layout.codes.results.code(reading.acknowledged.result));
    image.double(map.fault_code, reading.fault_code);
    image.put(map.axis_flags, image.axis_flags(&reading.axes));
    for (axis, reading) in reading.axes.iter() {
        image.axis(axis, reading);
    }
    if let Some(at) = map.uptime {
        image.double(at, extras.uptime_ms);
    }
    image.optional(map.snapshot, extras.snapshot);
    image.optional(map.snapshot_copy, extras.snapshot);
    image.registers
}

struct Image<'a> {
    layout: &'a Layout,
    registers: Vec<u16>,
}

impl Image<'_> {
    fn axis(&mut self, axis: Axis, reading: &AxisReading) {
        let map = &self.layout.status;
        self.put(*map.axis_states.get(axis), self.state(reading.state));
        let numbers = [
            (map.actual, reading.actual),
            (map.commanded, reading.commanded),
            (map.lower, reading.lower),
            (map.upper, reading.upper),
            (map.speed, reading.speed),
        ];
        for (places, value) in numbers {
            self.double(*places.get(axis), self.layout.numbers.bits(axis, axis.outside(value)).unwrap_or(0));
        }
    }

    fn state(&self, state: crate::device::manipulator::AxisState) -> u16 {
        self.layout.codes.states.codes().code(state)
    }

    fn safety(&self, reading: &Reading) -> u16 {
        let (bits, safety) = (self.layout.status.safety_bits, reading.safety);
        flag(safety.emergency_stop_ok, bits.emergency_stop_ok)
            | flag(safety.guard_closed, bits.guard_closed)
            | flag(safety.drives_ready, bits.drives_ready)
            | flag(safety.remote_enabled, bits.remote_enabled)
    }

    fn axis_flags(&self, axes: &Axes<AxisReading>) -> u16 {
        let bits = self.layout.status.axis_bits;
        axes.iter().fold(0, |word, (axis, reading)| {
            word | flag(reading.homed, *bits.homed.get(axis))
                | flag(reading.in_position, *bits.in_position.get(axis))
                | flag(reading.fault, *bits.fault.get(axis))
                | flag(reading.limit_hit, *bits.limit_hit.get(axis))
        })
    }

    fn optional(&mut self, at: Option<u16>, word: u16) {
        if let Some(at) = at {
            self.put(at, word);
        }
    }

    fn double(&mut self, at: u16, bits: u32) {
        let [first, second] = self.layout.word_order.registers(bits);
        self.put(at, first);
        self.put(at.saturating_add(1), second);
    }

    fn put(&mut self, at: u16, word: u16) {
        if let Some(register) = self.registers.get_mut(usize::from(at)) {
            *register = word;
        }
    }
}

fn flag(set: bool, bit: u8) -> u16 {
    u16::from(set).checked_shl(u32::from(bit)).unwrap_or(0)
}

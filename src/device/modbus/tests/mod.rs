//! Tests the guarantees of the adaptors over a pipe to the PLC side of the map, on paused time, also over a connection that breaks,
//! stalls, corrupts, duplicates and delays.

mod devices;
mod guarantees;

use super::{Dial, Layout, ModbusManipulator, Plc, Settings, Transport};
use crate::device::simulated::{Controller, ControllerSettings};
use crate::device::{Action, Command};
use crate::motion::{Axes, AxisLimits, Position};
use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
use tokio::time::sleep;
use tokio_modbus::{Request, Response};

/// A controller with limits of ±200 mm and ±200 degrees, 50 mm/s, 500 mm/s².
fn controller() -> Controller {
    let limits = AxisLimits { lower: -200.0, upper: 200.0, speed: 50.0, acceleration: 500.0, jerk: 5e3, step: 400.0 };
    let turn = AxisLimits { lower: -3.5, upper: 3.5, speed: 1.0, acceleration: 10.0, jerk: 100.0, step: 7.0 };
    Controller::new(ControllerSettings::exact(Axes { x: limits, y: limits, z: limits, c: turn }))
}

/// A PLC with two manipulators and a stage.
fn plc() -> Arc<Plc> {
    Arc::new(Plc::new(Layout::default(), vec![controller(), controller(), controller()]))
}

/// A manipulator over a connection with the faults of `wire`.
fn manipulator(wire: &Wire) -> ModbusManipulator {
    Settings::default().manipulator("m1", wire.dial()).expect("valid settings")
}

fn command(sequence: u16, action: Action) -> Command {
    Command { sequence, fence: 1, watchdog: Duration::from_millis(500), action }
}

/// A move of x to `target_mm` at the greatest speed.
fn x_to(target_mm: f64) -> Action {
    let only_x = |x| Position { x, ..Position::default() };
    Action::MoveTo { axes: Axes { x: true, ..Axes::default() }, targets: only_x(target_mm), speeds: only_x(50.0) }
}

/// A fault of a request or of its answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WireFault {
    /// The request does not arrive, and the connection is closed.
    CutBefore,
    /// The request does not arrive, and neither do later ones.
    StallBefore,
    /// This byte of the request is XORed with this value.
    CorruptRequest(u8, u8),
    /// The request arrives twice, and is answered twice.
    DoubleRequest,
    /// The request arrives a second time after this many ms, even if its sender has disconnected by then.
    LateAgain(u16),
    /// The connection is closed, but the request arrives after this many ms.
    LateRequest(u16),
    /// The request is executed, and the connection is closed.
    CutAfter,
    /// The request is executed, and no answer arrives.
    StallAfter,
    /// This byte of the answer is XORed with this value.
    CorruptAnswer(u8, u8),
    /// The answer arrives twice.
    DoubleAnswer,
    /// The answer arrives after this many ms.
    LateAnswer(u16),
    /// Half of the answer arrives, and the connection is closed.
    HalfAnswer,
    /// This register of a status is XORed with this value.
    ChangeRegister(u8, u16),
    /// This register of a status always has this value.
    HoldRegister(u8, u16),
}

/// The faults of the next requests, in order; a request with `None`, and every request after the last entry, has no fault.
#[derive(Clone)]
pub(super) struct Wire {
    plc: Arc<Plc>,
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    faults: VecDeque<Option<WireFault>>,
    every: Option<WireFault>,
    functions: Vec<u8>,
    faults_count: usize,
    dials_count: usize,
}

impl Wire {
    pub(super) fn to(plc: &Arc<Plc>) -> Self {
        Self { plc: Arc::clone(plc), state: Arc::default() }
    }

    /// Plans the faults of the next requests.
    pub(super) fn plan(&self, faults: impl IntoIterator<Item = Option<WireFault>>) {
        self.state.lock().expect("a lock").faults = faults.into_iter().collect();
    }

    /// Sets the fault of every request that has no plan.
    pub(super) fn every(&self, fault: Option<WireFault>) {
        self.state.lock().expect("a lock").every = fault;
    }

    /// The functions of the requests that were sent so far.
    pub(super) fn functions(&self) -> Vec<u8> {
        self.state.lock().expect("a lock").functions.clone()
    }

    /// The number of requests and answers with a fault.
    pub(super) fn faults_count(&self) -> usize {
        self.state.lock().expect("a lock").faults_count
    }

    /// The number of connections that were made.
    pub(super) fn dials_count(&self) -> usize {
        self.state.lock().expect("a lock").dials_count
    }

    pub(super) fn dial(&self) -> Dial {
        let wire = self.clone();
        Box::new(move || {
            let (ours, theirs) = duplex(4096);
            wire.state.lock().expect("a lock").dials_count += 1;
            tokio::spawn(wire.clone().carry(theirs));
            Box::pin(async { Ok(Box::new(ours) as Box<dyn Transport>) })
        })
    }

    /// Forwards requests and answers until either side disconnects or a fault closes the connection.
    async fn carry(self, mut stream: DuplexStream) {
        while let Some(frame) = next_frame(&mut stream).await {
            if self.pass(&mut stream, frame).await.is_none() {
                return;
            }
        }
    }

    fn fault(&self, function: u8) -> Option<WireFault> {
        let mut state = self.state.lock().expect("a lock");
        state.functions.push(function);
        let fault = state.faults.pop_front().unwrap_or(state.every);
        state.faults_count += usize::from(fault.is_some());
        fault
    }

    /// Forwards one request; returns `None` if the connection is closed.
    async fn pass(&self, stream: &mut DuplexStream, mut frame: Vec<u8>) -> Option<()> {
        let fault = self.fault(frame[7]);
        match fault {
            Some(WireFault::CutBefore) => return None,
            Some(WireFault::StallBefore) => return stall(stream).await,
            Some(WireFault::LateRequest(ms)) => {
                self.later(frame, ms);
                return None;
            }
            Some(WireFault::CorruptRequest(at, change)) => {
                let at = usize::from(at) % frame.len();
                frame[at] ^= change.max(1);
            }
            Some(WireFault::LateAgain(ms)) => self.later(frame.clone(), ms),
            _ => {}
        }
        let mut answer = answer(&self.plc, &frame)?;
        match fault {
            Some(WireFault::CutAfter) => return None,
            Some(WireFault::StallAfter) => return stall(stream).await,
            Some(WireFault::DoubleRequest) => {
                let second = self::answer(&self.plc, &frame)?;
                answer.extend(second);
            }
            Some(WireFault::DoubleAnswer) => answer.extend(answer.clone()),
            Some(WireFault::CorruptAnswer(at, change)) => {
                let at = usize::from(at) % answer.len();
                answer[at] ^= change.max(1);
            }
            Some(WireFault::ChangeRegister(register, change)) => {
                let before = word(&answer, register_at(register)).unwrap_or(0);
                set_register(&mut answer, register, before ^ change);
            }
            Some(WireFault::HoldRegister(register, shown)) => set_register(&mut answer, register, shown),
            Some(WireFault::LateAnswer(ms)) => sleep(Duration::from_millis(ms.into())).await,
            Some(WireFault::HalfAnswer) => {
                let _ = stream.write_all(&answer[..answer.len() / 2]).await;
                return None;
            }
            _ => {}
        }
        stream.write_all(&answer).await.ok()
    }

    fn later(&self, frame: Vec<u8>, ms: u16) {
        let plc = Arc::clone(&self.plc);
        tokio::spawn(async move {
            sleep(Duration::from_millis(ms.into())).await;
            let _ = answer(&plc, &frame);
        });
    }
}

/// Offset of a register in the answer to a reading, after the header, the function and the number of bytes.
const fn register_at(register: u8) -> usize {
    9 + 2 * register as usize
}

/// Sets a register in the answer to a reading; answers to writing remain unchanged.
fn set_register(answer: &mut [u8], register: u8, shown: u16) {
    if let Some(place) = answer.get_mut(register_at(register)..register_at(register) + 2) {
        place.copy_from_slice(&shown.to_be_bytes());
    }
}

/// Sends nothing until the other side has disconnected.
async fn stall(stream: &mut DuplexStream) -> Option<()> {
    let mut rest = Vec::new();
    let _ = stream.read_to_end(&mut rest).await;
    None
}

/// Reads a frame: the header (transaction, protocol, length of the rest, unit), then function and data.
async fn next_frame(stream: &mut DuplexStream) -> Option<Vec<u8>> {
    let mut frame = vec![0; 7];
    stream.read_exact(&mut frame).await.ok()?;
    let length = usize::from(word(&frame, 4)?);
    let mut rest = vec![0; length.checked_sub(1)?];
    stream.read_exact(&mut rest).await.ok()?;
    frame.extend(rest);
    (frame.len() > 7).then_some(frame)
}

/// The answer of the PLC; `None` if the frame is invalid and the connection is closed.
fn answer(plc: &Plc, frame: &[u8]) -> Option<Vec<u8>> {
    let whole = word(frame, 2)? == 0 && usize::from(word(frame, 4)?) + 6 == frame.len();
    let pdu = frame.get(7..).filter(|_| whole)?;
    let (function, first) = (*pdu.first()?, word(pdu, 1)?);
    let request = match (function, pdu.len()) {
        (3, 5) => Request::ReadHoldingRegisters(first, word(pdu, 3)?),
        (4, 5) => Request::ReadInputRegisters(first, word(pdu, 3)?),
        (6, 5) => Request::WriteSingleRegister(first, word(pdu, 3)?),
        (16, length) if length == 6 + usize::from(pdu[5]) && u16::from(pdu[5]) == word(pdu, 3)?.wrapping_mul(2) => {
            let words: Option<Vec<u16>> = (6..length).step_by(2).map(|at| word(pdu, at)).collect();
            Request::WriteMultipleRegisters(first, Cow::Owned(words?))
        }
        (3 | 4 | 6 | 16, _) => return None,
        _ => return Some(framed(frame, &[function | 0x80, 1])),
    };
    let pdu = match plc.answer(frame[6], &request) {
        Ok(Response::ReadHoldingRegisters(words) | Response::ReadInputRegisters(words)) => {
            let bytes = words.iter().flat_map(|word| word.to_be_bytes());
            [function, (words.len() * 2) as u8].into_iter().chain(bytes).collect()
        }
        Ok(_) => pdu[..5].to_vec(),
        Err(exception) => vec![function | 0x80, exception.into()],
    };
    Some(framed(frame, &pdu))
}

fn framed(request: &[u8], pdu: &[u8]) -> Vec<u8> {
    let length = (pdu.len() + 1) as u16;
    [&request[0..4], &length.to_be_bytes(), &request[6..7], pdu].concat()
}

fn word(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]))
}

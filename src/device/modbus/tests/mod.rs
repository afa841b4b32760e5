//! The adaptors over a pipe to the PLC side of the map, on paused time: what they guarantee, also over a wire that cuts, stalls,
//! corrupts, doubles and delays.

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

/// Limits of 200 mm and 200 degrees to both sides, 50 mm/s, 500 mm/s².
fn controller() -> Controller {
    let limits = AxisLimits { lower: -200.0, upper: 200.0, speed: 50.0, acceleration: 500.0, jerk: 5e3, step: 400.0 };
    let turn = AxisLimits { lower: -3.5, upper: 3.5, speed: 1.0, acceleration: 10.0, jerk: 100.0, step: 7.0 };
    Controller::new(ControllerSettings::exact(Axes { x: limits, y: limits, z: limits, c: turn }))
}

/// A PLC with two manipulators and a stage.
fn plc() -> Arc<Plc> {
    Arc::new(Plc::new(Layout::default(), vec![controller(), controller(), controller()]))
}

/// A manipulator over a wire with the faults of `wire`.
fn manipulator(wire: &Wire) -> ModbusManipulator {
    Settings::default().manipulator("m1", wire.dial()).expect("settings that can be")
}

fn command(sequence: u16, action: Action) -> Command {
    Command { sequence, fence: 1, watchdog: Duration::from_millis(500), action }
}

/// x to `target_mm` at the greatest speed.
fn x_to(target_mm: f64) -> Action {
    let only_x = |x| Position { x, ..Position::default() };
    Action::MoveTo { axes: Axes { x: true, ..Axes::default() }, targets: only_x(target_mm), speeds: only_x(50.0) }
}

/// What happens to a request, or to the answer to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WireFault {
    /// The request does not arrive, and the connection is cut.
    CutBefore,
    /// The request does not arrive, and nothing else does.
    StallBefore,
    /// This byte of the request is changed by this.
    CorruptRequest(u8, u8),
    /// The request arrives twice, and is answered twice.
    DoubleRequest,
    /// The request arrives twice, the second time after this many ms, also if its sender has disconnected by then.
    LateAgain(u16),
    /// The connection is cut, and the request arrives nevertheless, after this many ms.
    LateRequest(u16),
    /// The request is done, and the connection is cut.
    CutAfter,
    /// The request is done, and no answer comes.
    StallAfter,
    /// This byte of the answer is changed by this.
    CorruptAnswer(u8, u8),
    /// The answer comes twice.
    DoubleAnswer,
    /// The answer comes after this many ms.
    LateAnswer(u16),
    /// Half of the answer comes, and the connection is cut.
    HalfAnswer,
    /// This register of a status is changed by this.
    ChangeRegister(u8, u16),
    /// This register of a status always shows this.
    HoldRegister(u8, u16),
}

/// Faults for the next requests, in order; none for `None`, and none after the last.
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

    /// What happens to the requests to come.
    pub(super) fn plan(&self, faults: impl IntoIterator<Item = Option<WireFault>>) {
        self.state.lock().expect("a lock").faults = faults.into_iter().collect();
    }

    /// What happens to every request that has no plan.
    pub(super) fn every(&self, fault: Option<WireFault>) {
        self.state.lock().expect("a lock").every = fault;
    }

    /// The functions of the requests that were sent so far.
    pub(super) fn functions(&self) -> Vec<u8> {
        self.state.lock().expect("a lock").functions.clone()
    }

    /// Requests and answers that met a fault.
    pub(super) fn faults_count(&self) -> usize {
        self.state.lock().expect("a lock").faults_count
    }

    /// Connections that were made.
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

    /// Until either side hangs up or a fault cuts.
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

    /// One request; none where the connection is cut.
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

/// In the answer to a reading: header, function and count of bytes come before the registers.
const fn register_at(register: u8) -> usize {
    9 + 2 * register as usize
}

/// Leaves answers to writing as they are.
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

/// Header: transaction, protocol, length of what follows it, unit. Then function and data.
async fn next_frame(stream: &mut DuplexStream) -> Option<Vec<u8>> {
    let mut frame = vec![0; 7];
    stream.read_exact(&mut frame).await.ok()?;
    let length = usize::from(word(&frame, 4)?);
    let mut rest = vec![0; length.checked_sub(1)?];
    stream.read_exact(&mut rest).await.ok()?;
    frame.extend(rest);
    (frame.len() > 7).then_some(frame)
}

/// What the PLC answers; none where the frame is none, and the connection is cut.
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

//! Data from devices, and data to the simulated PLC: replies of a Gocator, registers over Modbus TCP, values over OPC UA.

use coaxis::device::gocator::codec::{
    Command as GocatorCommand, Identity, Message, Reply, Request as GocatorRequest, SensorState, Splitter, Version,
    decode,
};
use coaxis::device::gocator::{Extrinsic, Travel, fuzzing};
use coaxis::device::modbus::{Dial, Layout, Numbers, Plc, Scales, Settings, StatusFunction, Transport, WordOrder};
use coaxis::device::simulated::{Controller, ControllerSettings};
use coaxis::device::{Action, AxisReading, Command, Manipulator, Reading, Stage};
use coaxis::motion::{Axes, AxisLimits, Position};
use std::borrow::Cow;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
use tokio_modbus::{Request, Response};

/// The default of `frame_mb_max` is far larger than a fuzzed stream, so a smaller limit is used.
const FRAME_BYTES_MAX: usize = 16 << 10;

/// The data and health channels: any stream in two pieces, from frames to profiles.
pub fn gocator_data(stream: &[u8]) {
    let mut splitter = Splitter::new(FRAME_BYTES_MAX);
    let (first, second) = stream.split_at(stream.len() / 2);
    for piece in [first, second] {
        splitter.room().extend_from_slice(piece);
        while let Ok(Some(frame)) = splitter.next_frame() {
            let Ok(framed) = decode(frame) else { continue };
            let values_count: usize = match framed.message {
                Message::Health(health) => health.iter().count(),
                Message::Stamps(stamps) => stamps.iter().count(),
                Message::PointClouds(profiles) => profiles.point_clouds().map(Iterator::count).sum(),
                Message::Uniform(profiles) => profiles.uniform().map(Iterator::count).sum(),
                Message::Intensity(intensity) => intensity.values.len(),
                Message::Surface(surface) => surface.rows().map(Iterator::count).sum(),
                Message::Other { .. } => 0,
            };
            assert!(values_count <= frame.len(), "{values_count} values in {} bytes", frame.len());
        }
    }
    let sum = stream.iter().fold(0, |sum: usize, byte| sum + usize::from(*byte));
    let (sin, cos) = 0.3_f64.sin_cos();
    let upright = Extrinsic {
        sensor_x: [0.0, 1.0, 0.0],
        sensor_y: [1.0, 0.0, 0.0],
        sensor_z: [0.0, 0.0, -1.0],
        mirrored: false,
        translation_mm: [10.0, 0.0, 400.0],
    };
    // Rotated about z, so that every point has its own x.
    let turned = Extrinsic { sensor_x: [-sin, cos, 0.0], sensor_y: [cos, sin, 0.0], ..upright };
    let travels = [
        Travel::Time { speed_mm_s: -40.0, start_mm: 5.0 },
        Travel::Encoder { mm_per_tick: 0.001, start_mm: 0.0, zero_ticks: None },
        Travel::Encoder { mm_per_tick: -1e6, start_mm: 0.0, zero_ticks: Some(i64::MIN) },
    ];
    let placement = [upright, turned][sum % 2].place().expect("a rigid extrinsic");
    let profiles = fuzzing::assemble(stream, FRAME_BYTES_MAX, placement, travels[sum % 3], 1_000);
    assert!(profiles.len() <= 1_000, "{} profiles, 1000 were asked for", profiles.len());
    for profile in profiles {
        assert_eq!(profile.y.len(), profile.z.len());
        assert!(profile.x.is_empty() || profile.x.len() == profile.y.len());
    }
}

/// The control channel: replies to the client, and requests to the simulated sensor.
pub fn gocator_control(frame: &[u8]) {
    if let Ok(request) = GocatorRequest::decode(frame) {
        let mut bytes = Vec::new();
        request.encode(&mut bytes);
        assert_eq!(GocatorRequest::decode(&bytes), Ok(request), "a request reads back as written");
        let _ = GocatorCommand::from_id(request.id);
    }
    if let Ok(reply) = Reply::decode(frame) {
        let mut bytes = Vec::new();
        reply.encode(&mut bytes);
        assert_eq!(Reply::decode(&bytes), Ok(reply), "a reply reads back as written");
        let _ = reply.status.to_string();
        let _ = (Version::decode(reply.payload), SensorState::decode(reply.payload));
        for identity in [Identity::decode_v1(reply.payload), Identity::decode_v2(reply.payload)].into_iter().flatten() {
            assert_eq!(
                Identity::decode_v2(&identity.encode_v2(true)),
                Ok(identity),
                "an identity reads back as written"
            );
        }
    }
}

/// Limits of ± 200 mm and ± 200°.
fn controller() -> Controller {
    let linear = AxisLimits { lower: -200.0, upper: 200.0, speed: 50.0, acceleration: 500.0, jerk: 5e3, step: 400.0 };
    let turn = AxisLimits { lower: -3.5, upper: 3.5, speed: 1.0, acceleration: 10.0, jerk: 100.0, step: 7.0 };
    Controller::new(ControllerSettings::exact(Axes { x: linear, y: linear, z: linear, c: turn }))
}

/// The bytes of an input, consumed from the front; zeros after the end.
struct Bytes(Vec<u8>);

impl Bytes {
    fn of(input: &[u8]) -> Self {
        Self(input.iter().rev().copied().collect())
    }

    fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn byte(&mut self) -> u8 {
        self.0.pop().unwrap_or(0)
    }

    fn word(&mut self) -> u16 {
        u16::from_be_bytes([self.byte(), self.byte()])
    }
}

fn layout(choice: u8) -> Layout {
    let mut layout = Layout::default();
    layout.word_order = WordOrder::ALL[usize::from(choice & 3)];
    if choice & 4 != 0 {
        layout.numbers = Numbers::I32(Scales::default());
    }
    if choice & 8 != 0 {
        layout.status.function = StatusFunction::Holding;
    }
    layout
}

/// The answer of a PLC as modified by the input; `None` if the connection ends.
fn modbus_answer(plc: &Plc, bytes: &mut Bytes, head: [u8; 7], request: &[u8]) -> Option<Vec<u8>> {
    let [transaction_0, transaction_1, _, _, _, _, unit] = head;
    let framed = |pdu: Vec<u8>| {
        let length = u16::try_from(pdu.len() + 1).expect("a short answer").to_be_bytes();
        [&[transaction_0, transaction_1, 0, 0][..], &length, &[unit], &pdu].concat()
    };
    let number = |at: usize| u16::from_be_bytes([request[at], request[at + 1]]);
    match bytes.byte() {
        // Arbitrary bytes.
        0xFF => Some((0..bytes.byte()).map(|_| bytes.byte()).collect()),
        // An arbitrary answer to this request.
        0xFE => Some(framed((0..bytes.byte()).map(|_| bytes.byte()).collect())),
        0xFD => None,
        // The correct answer with some changed registers.
        changes_count => {
            let answer = match request.first()? {
                3 => plc.answer(unit, &Request::ReadHoldingRegisters(number(1), number(3))),
                4 => plc.answer(unit, &Request::ReadInputRegisters(number(1), number(3))),
                6 => plc.answer(unit, &Request::WriteSingleRegister(number(1), number(3))),
                _ => {
                    let words: Vec<_> = (6..request.len() - 1).step_by(2).map(number).collect();
                    plc.answer(unit, &Request::WriteMultipleRegisters(number(1), Cow::Owned(words)))
                }
            };
            let function = request[0];
            Some(framed(match answer {
                Ok(Response::ReadHoldingRegisters(mut words) | Response::ReadInputRegisters(mut words)) => {
                    for _ in 0..changes_count {
                        let (index, change) = (usize::from(bytes.byte()) % words.len(), bytes.word());
                        words[index] ^= change;
                    }
                    let length = u8::try_from(2 * words.len()).expect("at most 125 registers");
                    [vec![function, length], words.iter().flat_map(|word| word.to_be_bytes()).collect()].concat()
                }
                Ok(_) => request[..5].to_vec(),
                Err(exception) => vec![function | 0x80, exception.into()],
            }))
        }
    }
}

/// Answers the requests of a client until one of them ends.
async fn modbus_peer(plc: Arc<Plc>, bytes: Arc<Mutex<Bytes>>, mut stream: DuplexStream) {
    loop {
        let mut head = [0; 7];
        if stream.read_exact(&mut head).await.is_err() {
            return;
        }
        let mut request = vec![0; usize::from(u16::from_be_bytes([head[4], head[5]])) - 1];
        if stream.read_exact(&mut request).await.is_err() {
            return;
        }
        let answer = modbus_answer(&plc, &mut bytes.lock().expect("not poisoned"), head, &request);
        let Some(answer) = answer else { return };
        if stream.write_all(&answer).await.is_err() {
            return;
        }
    }
}

/// Runs on a paused clock that advances when all tasks wait.
fn on_paused_time(work: impl Future<Output = ()>) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build();
    runtime.expect("a runtime").block_on(work);
}

/// A manipulator and a stage whose PLC answers as the input determines.
pub fn modbus(input: &[u8]) {
    let mut bytes = Bytes::of(input);
    let layout = layout(bytes.byte());
    let settings = Settings { layout, ..Settings::default() };
    let bytes = Arc::new(Mutex::new(bytes));
    on_paused_time(async move {
        let plc = Arc::new(Plc::new(layout, vec![controller()]));
        let dial = || -> Dial {
            let (plc, bytes) = (Arc::clone(&plc), Arc::clone(&bytes));
            Box::new(move || {
                let (ours, theirs) = duplex(1024);
                tokio::spawn(modbus_peer(Arc::clone(&plc), Arc::clone(&bytes), theirs));
                Box::pin(async move { Ok(Box::new(ours) as Box<dyn Transport>) })
            })
        };
        let mut manipulator = settings.manipulator("m1", dial()).expect("settings that pass their check");
        let axes = Axes { x: true, ..Axes::default() };
        let (targets, speeds) =
            (Position { x: 10.0, ..Position::default() }, Position { x: 5.0, ..Position::default() });
        let action = Action::MoveTo { axes, targets, speeds };
        let command = Command { sequence: 1, fence: 1, watchdog: Duration::from_millis(400), action };
        check(manipulator.connect().await.ok());
        check(manipulator.read().await.ok());
        let _ = manipulator.send(&command).await;
        check(manipulator.read().await.ok());
        let mut stage = settings.stage("stage", dial()).expect("settings that pass their check");
        for reading in [stage.connect().await, stage.read().await].into_iter().flatten() {
            assert!(reading.lower_mm < reading.upper_mm && reading.actual_mm.is_finite() && reading.speed_mm_s > 0.0);
        }
        let _ = stage.move_to(2, 20.0, 5.0).await;
        let _ = stage.halt().await;
    });
}

/// Checks the guarantees of a reading.
fn check(reading: Option<Reading>) {
    let Some(Reading { axes, .. }) = reading else { return };
    for AxisReading { actual, commanded, lower, upper, speed, .. } in [axes.x, axes.y, axes.z, axes.c] {
        assert!([actual, commanded, lower, upper, speed].iter().all(|value| value.is_finite()), "{axes:?}");
        assert!(lower < upper && speed > 0.0, "{axes:?}");
    }
}

/// The simulated PLC with arbitrary requests.
pub fn modbus_plc(input: &[u8]) {
    let mut bytes = Bytes::of(input);
    let plc = Plc::new(layout(bytes.byte()), vec![controller(), controller()]);
    on_paused_time(async {
        while !bytes.is_empty() {
            let (kind, at) = (bytes.byte(), bytes.word());
            let unit = [0, 1, 2, 255][usize::from(kind >> 6)];
            let mut words = || -> Vec<u16> { (0..bytes.byte() % 30).map(|_| bytes.word()).collect() };
            let request = match kind & 7 {
                0 => Request::ReadHoldingRegisters(at, u16::from(kind >> 3)),
                1 => Request::ReadInputRegisters(at, bytes.word()),
                2 => Request::WriteSingleRegister(at, bytes.word()),
                3 => Request::WriteMultipleRegisters(at, Cow::Owned(words())),
                // All of a command, so that its sequence number changes with it.
                4 | 5 => Request::WriteMultipleRegisters(128, Cow::Owned((0..24).map(|_| bytes.word()).collect())),
                6 => Request::ReadInputRegisters(0, 64),
                _ => {
                    tokio::time::advance(Duration::from_millis(u64::from(at))).await;
                    continue;
                }
            };
            let answer = plc.answer(unit, &request);
            if let (Request::ReadInputRegisters(_, count), Ok(Response::ReadInputRegisters(words))) = (request, answer)
            {
                assert_eq!(words.len(), usize::from(count));
            }
        }
        for device in 0..2 {
            check(plc.with(device, |controller, time| controller.reading(time)));
        }
    });
}

/// Values of the nodes of an OPC UA server.
pub fn opcua(input: &[u8]) {
    let reading = controller().reading(Duration::from_millis(120));
    let read = coaxis::device::opcua::fuzzing::read(input, &reading);
    assert!(read.is_some() || !input.is_empty(), "the valid answer is read");
    check(read);
}

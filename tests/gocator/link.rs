//! Client and simulated sensor on loopback: sent data arrive, and each fault is reported by name.

use super::sensor::{POINTS, PROFILES, SERIAL, STEP_MM, impatient, sensor, serve, serve_told, settings, taken, view};
use coaxis::device::gocator::codec::{Generation, Reply, Status, indicator};
use coaxis::device::gocator::server::{Faults, Form, ScanSource, Taken, View};
use coaxis::device::gocator::{Gocator, Settings, Travel};
use coaxis::device::{DeviceError, Profile, ProfileSensor, ScanFault};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

async fn collect(sensor: &mut Gocator, count: usize) -> Result<Vec<Profile>, DeviceError> {
    let mut profiles = Vec::new();
    while profiles.len() < count {
        profiles.extend(sensor.receive().await?);
    }
    Ok(profiles)
}

async fn scan(sensor: &mut Gocator) -> Result<Vec<Profile>, DeviceError> {
    sensor.connect().await?;
    sensor.start(PROFILES as u64).await?;
    let profiles = collect(sensor, PROFILES).await?;
    sensor.stop().await?;
    Ok(profiles)
}

fn fault(fault: ScanFault) -> DeviceError {
    DeviceError::ScanFault { device: "profiler".to_owned(), fault }
}

/// Half a step of each number, and the rounding of 200 mm to single precision.
fn assert_same(profile: &Profile, taken: &Taken, view: &View) {
    let seen: Vec<[f64; 2]> = taken.points.iter().copied().flatten().collect();
    assert_eq!((profile.y.len(), profile.z.len(), profile.x.len()), (seen.len(), seen.len(), 0));
    assert_eq!(profile.missing_count, (POINTS - seen.len()) as u64);
    let within = |scale_nm: u32| 0.5e-6 * f64::from(scale_nm) + 2e-5;
    let across = if view.form == Form::PointCloud { within(view.x.scale_nm) } else { 2e-5 };
    for ((y, z), [x_seen, z_seen]) in profile.y.iter().zip(&profile.z).zip(seen) {
        assert!((f64::from(*y) - x_seen).abs() <= across, "y {y}, {x_seen} was seen");
        assert!((f64::from(*z) - z_seen).abs() <= within(view.z.scale_nm), "z {z}, {z_seen} was seen");
    }
}

#[tokio::test]
async fn received_data_equal_sent_data_in_every_form_and_generation() {
    for form in [Form::PointCloud, Form::Uniform, Form::Surface] {
        for generation in [Generation::Base, Generation::StreamStep, Generation::Arrayed] {
            let view = View { generation, ..view(form) };
            let server = serve(view, taken(), None).await;
            let profiles = scan(&mut sensor(&settings(&server))).await.expect("whole");
            assert_eq!(profiles.len(), PROFILES, "{form:?} {generation:?}");
            for ((at, profile), taken) in profiles.iter().enumerate().zip(taken()) {
                assert_eq!(profile.index, at as u64);
                assert!((profile.travel_mm - 100.0 - STEP_MM * at as f64).abs() < 1e-9, "{}", profile.travel_mm);
                assert_same(profile, &taken, &view);
            }
        }
    }
}

#[tokio::test]
async fn a_sensor_reports_its_identity_and_its_health() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    let mut sensor = sensor(&settings(&server));
    let reading = sensor.connect().await.expect("there");
    assert_eq!((reading.model.as_str(), reading.serial.as_str()), ("Gocator 2350", "40959"));
    assert_eq!((reading.firmware.as_str(), reading.running, reading.temperature_c), ("4.8.26.44", false, Some(41.0)));
    sensor.start(1).await.expect("started");
    assert!(sensor.read().await.expect("reading").running);
    collect(&mut sensor, 1).await.expect("a profile");
    sensor.stop().await.expect("stopped");
    assert!(!sensor.read().await.expect("reading").running);
    assert!(sensor.clock_us().await.expect("clock") >= 5_000.0 / 1.024);
    assert!(sensor.encoder_ticks().await.expect("encoder") >= 1_000);
}

#[tokio::test]
async fn successive_scans_are_independent_of_each_other() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    let mut sensor = sensor(&settings(&server));
    sensor.connect().await.expect("there");
    for profiles_count in [3, PROFILES, 5] {
        sensor.start(profiles_count as u64).await.expect("started");
        let profiles = collect(&mut sensor, profiles_count).await.expect("whole");
        assert_eq!((profiles.len(), profiles[0].index, profiles[0].travel_mm), (profiles_count, 0, 100.0));
        sensor.stop().await.expect("nothing lost");
    }
}

#[tokio::test]
async fn the_travel_is_calculated_from_time_if_configured() {
    let server = serve(view(Form::Uniform), taken(), None).await;
    let travel = Some(Travel::Time { speed_mm_s: -50.0, start_mm: 7.0 });
    let profiles = scan(&mut sensor(&Settings { travel, ..settings(&server) })).await.expect("whole");
    for (at, profile) in profiles.iter().enumerate() {
        // 1024 ticks are a thousandth of a second.
        assert!((profile.travel_mm - (7.0 - 0.05 * at as f64)).abs() < 1e-9, "{}", profile.travel_mm);
    }
}

#[tokio::test]
async fn several_clients_receive_the_same_scan() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    let mut listener = TcpStream::connect(("127.0.0.1", server.ports().data)).await.expect("a second client");
    let listened = tokio::spawn(async move {
        let mut bytes = vec![0; PROFILES * (70 + 40 + 4 * POINTS)];
        listener.read_exact(&mut bytes).await.expect("all of it");
        bytes
    });
    scan(&mut sensor(&settings(&server))).await.expect("whole");
    let frames = super::golden::frames(&listened.await.expect("a task"));
    assert_eq!(frames.len(), 2 * PROFILES);
}

#[tokio::test]
async fn a_missing_frame_ends_the_scan_by_name() {
    for form in [Form::PointCloud, Form::Uniform] {
        let server = serve(view(form), taken(), None).await;
        server.inject(Faults { skip_frame: Some(17), ..Faults::default() });
        let mut sensor = sensor(&settings(&server));
        // Frames count from 1 on the wire.
        let wanted = fault(ScanFault::FrameGap { expected: 18, found: 19 });
        assert_eq!(scan(&mut sensor).await, Err(wanted.clone()));
        assert_eq!(sensor.receive().await, Err(wanted), "it stays ended");
        sensor.stop().await.expect("the laser goes off");
        assert!(!*server.running().borrow());
    }
}

#[tokio::test]
async fn drops_that_the_sensor_reports_end_the_scan_by_name() {
    for (id, wanted) in [
        (indicator::TRIGGER_DROPS, ScanFault::TriggerDrops { count: 2 }),
        (indicator::NETWORK_DROPS, ScanFault::NetworkDrops { count: 2 }),
        (indicator::PROCESSING_DROPS, ScanFault::ProcessingDrops { count: 2 }),
    ] {
        let server = serve(view(Form::PointCloud), taken(), None).await;
        let before = Faults { stall_at: Some(10), indicators: vec![(id, 5)], ..Faults::default() };
        server.inject(before.clone());
        let mut sensor = sensor(&settings(&server));
        sensor.connect().await.expect("there");
        sensor.start(PROFILES as u64).await.expect("started");
        collect(&mut sensor, 10).await.expect("earlier drops are not counted");
        server.inject(Faults { indicators: vec![(id, 7)], ..before });
        assert_eq!(sensor.receive().await, Err(fault(wanted.clone())));
        assert_eq!(sensor.stop().await, Err(fault(wanted)));
    }
}

#[tokio::test]
async fn drops_reported_after_the_last_profile_are_reported_at_the_stop() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    let mut sensor = sensor(&settings(&server));
    sensor.connect().await.expect("there");
    sensor.start(PROFILES as u64).await.expect("started");
    collect(&mut sensor, PROFILES).await.expect("whole");
    server.inject(Faults { indicators: vec![(indicator::NETWORK_DROPS, 1)], ..Faults::default() });
    assert_eq!(sensor.stop().await, Err(fault(ScanFault::NetworkDrops { count: 1 })));
}

#[tokio::test]
async fn the_health_message_of_the_stop_ends_the_scan() {
    // The sensor sends a health message when it stops, and then none for an hour.
    let source = Box::new(ScanSource::new(taken(), None));
    let server = serve_told(view(Form::PointCloud), source, Duration::from_secs(3_600)).await;
    let mut sensor = sensor(&settings(&server));
    for _ in 0..20 {
        scan(&mut sensor).await.expect("complete, and confirmed");
    }
}

#[tokio::test]
async fn a_sensor_that_disconnects_is_a_lost_link_at_once() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    server.inject(Faults { stall_at: Some(10), ..Faults::default() });
    let mut sensor = sensor(&settings(&server));
    sensor.connect().await.expect("there");
    sensor.start(PROFILES as u64).await.expect("started");
    collect(&mut sensor, 10).await.expect("ten");
    drop(server);
    let lost = tokio::time::timeout(Duration::from_secs(1), sensor.receive()).await.expect("well before its deadlines");
    assert!(matches!(lost, Err(DeviceError::LinkLost { .. })), "{lost:?}");
    assert!(matches!(sensor.stop().await, Err(DeviceError::LinkLost { .. })), "the laser is not confirmed to be off");
    assert!(matches!(sensor.connect().await, Err(DeviceError::LinkLost { .. })));
}

#[tokio::test]
async fn a_sensor_that_runs_and_sends_nothing_is_silent_and_one_that_stopped_is_incomplete() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    let mut sensor = sensor(&impatient(&server));
    let within = Duration::from_millis(200);
    for stall_at in [0, 10] {
        server.inject(Faults { stall_at: Some(stall_at), ..Faults::default() });
        assert_eq!(scan(&mut sensor).await, Err(DeviceError::Silent { device: "profiler".to_owned(), within }));
        sensor.stop().await.expect("the laser goes off");
    }
    server.inject(Faults { end_at: Some(10), ..Faults::default() });
    let wanted = ScanFault::Incomplete { received_count: 10, expected_count: PROFILES as u64 };
    assert_eq!(scan(&mut sensor).await, Err(fault(wanted)));
}

#[tokio::test]
async fn missing_health_messages_are_reported() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    let mut settings = settings(&server);
    settings.deadlines.health_ms = 200;
    let mut sensor = sensor(&settings);
    sensor.connect().await.expect("there");
    server.inject(Faults { stall_at: Some(1), health_silent: true, ..Faults::default() });
    sensor.start(PROFILES as u64).await.expect("started");
    collect(&mut sensor, 1).await.expect("one");
    let silent = DeviceError::Silent { device: "profiler".to_owned(), within: Duration::from_millis(200) };
    assert_eq!(sensor.receive().await, Err(silent));
}

#[tokio::test]
async fn a_refused_start_is_a_refusal_and_nothing_runs() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    server.inject(Faults { refuse_start: true, ..Faults::default() });
    let mut sensor = sensor(&settings(&server));
    sensor.connect().await.expect("there");
    let refused = DeviceError::Rejected { device: "profiler".to_owned(), code: 1000 };
    assert_eq!(sensor.start(PROFILES as u64).await, Err(refused));
    sensor.stop().await.expect("nothing runs");
    assert!(matches!(sensor.receive().await, Err(DeviceError::Unsupported { .. })));
    server.inject(Faults::default());
    sensor.start(1).await.expect("the link has stayed");
}

#[tokio::test]
async fn a_stop_during_a_scan_and_a_stop_without_a_scan_are_harmless() {
    let server = serve(view(Form::PointCloud), taken(), Some(2_000.0)).await;
    let mut sensor = sensor(&settings(&server));
    sensor.stop().await.expect("not even connected");
    sensor.connect().await.expect("there");
    for _ in 0..3 {
        sensor.start(PROFILES as u64).await.expect("started");
        collect(&mut sensor, 20).await.expect("some");
        sensor.stop().await.expect("stopped");
        sensor.stop().await.expect("stopped already");
        assert!(!*server.running().borrow());
    }
    assert_eq!(scan(&mut sensor).await.expect("a whole one after it").len(), PROFILES);
}

#[tokio::test]
async fn receiving_may_be_cancelled_and_continued() {
    let server = serve(view(Form::PointCloud), taken(), Some(4_000.0)).await;
    let mut sensor = sensor(&settings(&server));
    sensor.connect().await.expect("there");
    sensor.start(PROFILES as u64).await.expect("started");
    let mut profiles = Vec::new();
    let mut given_up_count = 0;
    while profiles.len() < PROFILES {
        match tokio::time::timeout(Duration::from_micros(500), sensor.receive()).await {
            Ok(received) => profiles.extend(received.expect("whole")),
            Err(_) => given_up_count += 1,
        }
    }
    assert!(given_up_count > 0, "never cancelled, so not tested");
    assert!(profiles.iter().enumerate().all(|(at, profile)| profile.index == at as u64));
}

#[tokio::test]
async fn another_sensor_than_the_configured_one_is_refused() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    let mut sensor = sensor(&Settings { serial: Some(SERIAL + 1), ..settings(&server) });
    let error = sensor.connect().await.expect_err("another");
    assert!(error.to_string().contains("40959, and 40960 is configured"), "{error}");
    assert!(matches!(sensor.read().await, Err(DeviceError::LinkLost { .. })), "it is not kept");
}

#[tokio::test]
async fn a_lost_connection_is_reported_and_made_again() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    let settings = settings(&server);
    let mut sensor = sensor(&settings);
    assert!(matches!(sensor.read().await, Err(DeviceError::LinkLost { .. })));
    assert!(matches!(sensor.start(1).await, Err(DeviceError::LinkLost { .. })));
    assert_eq!(scan(&mut sensor).await.expect("whole").len(), PROFILES);
    assert_eq!(scan(&mut sensor).await.expect("connects anew").len(), PROFILES);
}

/// The first frame of the manufacturer's client has the form of an older protocol; the bytes were recorded from that client.
#[tokio::test]
async fn the_makers_handshake_is_answered() {
    let server = serve(view(Form::PointCloud), taken(), None).await;
    let mut client = TcpStream::connect(("127.0.0.1", server.ports().control)).await.expect("there");
    client.write_all(&super::golden::bytes("10000000 00000000 0011000000000000")).await.expect("sent");
    let mut answer = [0; 10];
    client.read_exact(&mut answer).await.expect("answered");
    assert_eq!(Reply::decode(&answer).expect("a reply").status, Status::INVALID_COMMAND);
    client.write_all(&super::golden::bytes("06000000 1145")).await.expect("sent");
    let mut answer = [0; 12];
    client.read_exact(&mut answer).await.expect("answered");
    assert_eq!(answer.to_vec(), super::golden::bytes("0c000000 1145 01000000 65 04"));
}

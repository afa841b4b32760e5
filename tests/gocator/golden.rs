//! Bytes written by the manufacturer's library, and requests that it sent. They must never be edited to make a test pass.

use coaxis::device::gocator::codec::{
    Command, Generation, Health, INVALID, Indicator, Intensity, Message, Profiles, Reply, Request, Scale, Splitter,
    Stamp, Stamps, Status, Surface, decode, kind,
};

pub(crate) const POINT_CLOUD: &[u8] = include_bytes!("../data/gocator/gdp_stamp_profile_pointcloud.bin");
pub(crate) const UNIFORM: &[u8] = include_bytes!("../data/gocator/gdp_stamp_uniform_profile_intensity.bin");
/// Encoder at -12345 ticks, running.
const HEALTH: &str =
    "2e000000 0080 02000000 00 000000 eb030000 00000000 c7cfffffffffffff 204e0000 00000000 0100000000000000";

pub(crate) fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex.bytes().filter(u8::is_ascii_hexdigit).collect();
    digits.chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

pub(crate) fn health() -> Vec<u8> {
    bytes(HEALTH)
}

pub(crate) fn frames(stream: &[u8]) -> Vec<Vec<u8>> {
    let mut splitter = Splitter::new(1 << 20);
    splitter.room().extend_from_slice(stream);
    let mut frames = Vec::new();
    while let Some(frame) = splitter.next_frame().expect("golden") {
        frames.push(frame.to_vec());
    }
    frames
}

fn stamp(frame_index: u64) -> Stamp {
    Stamp {
        frame_index,
        timestamp: 1_000_000 + 1000 * frame_index,
        encoder: -12_345 + frame_index as i64,
        encoder_at_z: 77,
        status: 0x11,
        serial: 40_959,
    }
}

fn raw(numbers: &[i16]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn stamps(message: &Message<'_>) -> Vec<Stamp> {
    match message {
        Message::Stamps(stamps) => stamps.iter().collect(),
        other => panic!("no stamps: {other:?}"),
    }
}

#[test]
fn a_point_cloud_of_the_makers_library_is_read_and_written_byte_for_byte() {
    let frames = frames(POINT_CLOUD);
    let [first, second] = frames.as_slice() else { panic!("{} frames", frames.len()) };
    let (opened, shown) = (decode(first).unwrap(), decode(second).unwrap());
    assert_eq!((opened.last, stamps(&opened.message)), (false, vec![stamp(1)]));
    let numbers = [-20_000, 100, -10_000, 200, INVALID, INVALID, 10_000, 400, 20_000, -500];
    let values = raw(&numbers);
    let wanted = Profiles {
        count: 1,
        width: 5,
        x: Scale { scale_nm: 9_000, offset_um: -150 },
        z: Scale { scale_nm: 8_000, offset_um: 2_500 },
        source: 0,
        exposure_ns: 120_000,
        camera: 1,
        values: &values,
    };
    assert_eq!((shown.last, shown.message), (true, Message::PointClouds(wanted)));
    let points: Vec<[f64; 2]> = wanted
        .point_clouds()
        .flat_map(|row| row.filter(|point| point[1] != INVALID).collect::<Vec<_>>())
        .map(|[x, z]| [wanted.x.mm(x.into()), wanted.z.mm(z.into())])
        .collect();
    for (found, right) in points.iter().zip([[-180.15, 3.3], [-90.15, 4.1], [89.85, 5.7], [179.85, -1.5]]) {
        // Double precision represents 180 mm to 3e-14.
        assert!((found[0] - right[0]).abs() < 1e-12 && (found[1] - right[1]).abs() < 1e-12, "{found:?} {right:?}");
    }
    assert_eq!(points.len(), 4);

    let mut written = Vec::new();
    Stamps::encode(0, &[stamp(1)], false, &mut written);
    wanted.encode(kind::PROFILE_POINT_CLOUD, Generation::Base, true, &mut written);
    assert_eq!(written, POINT_CLOUD);
}

#[test]
fn a_uniform_profile_of_the_makers_library_is_read_and_written_byte_for_byte() {
    let frames = frames(UNIFORM);
    let [first, second, third] = frames.as_slice() else { panic!("{} frames", frames.len()) };
    assert_eq!(stamps(&decode(first).unwrap().message), [stamp(2)]);
    let (x, z) = (Scale { scale_nm: 250_000, offset_um: -60_000 }, Scale { scale_nm: 8_000, offset_um: -2_500 });
    let values = raw(&[INVALID, -1, 0, 1, i16::MAX, -i16::MAX]);
    let profiles = Profiles { count: 1, width: 6, x, z, source: 0, exposure_ns: 90_000, camera: 0, values: &values };
    let shown = decode(second).unwrap();
    assert_eq!((shown.last, shown.message), (false, Message::Uniform(profiles)));
    let intensity = Intensity {
        count: 1,
        width: 6,
        x,
        source: 0,
        exposure_ns: 90_000,
        camera: 0,
        values: &[0, 51, 102, 153, 204, 255],
    };
    let bright = decode(third).unwrap();
    assert_eq!((bright.last, bright.message), (true, Message::Intensity(intensity)));

    let mut written = Vec::new();
    Stamps::encode(0, &[stamp(2)], false, &mut written);
    profiles.encode(kind::UNIFORM_PROFILE, Generation::Base, false, &mut written);
    intensity.encode(Generation::Base, true, &mut written);
    assert_eq!(written, UNIFORM);
}

#[test]
fn health_of_the_makers_library_is_read_and_written_byte_for_byte() {
    let golden = health();
    let framed = decode(&golden).unwrap();
    let Message::Health(health) = framed.message else { panic!("{framed:?}") };
    let wanted = [Indicator { id: 1003, instance: 0, value: -12_345 }, Indicator { id: 20_000, instance: 0, value: 1 }];
    assert_eq!((framed.last, health.iter().collect::<Vec<_>>()), (true, wanted.to_vec()));
    let mut written = Vec::new();
    Health::encode(0, &wanted, &mut written);
    assert_eq!(written, golden);
}

/// Encoded by hand from the manual's table: only the values of the manufacturer's surface are known, not its bytes.
#[test]
fn a_surface_has_the_layout_of_the_manual() {
    let mut numbers: Vec<i16> = (0..3).flat_map(|r| (0..4).map(move |c| 100 * r + c)).collect();
    numbers[6] = INVALID;
    let values = raw(&numbers);
    let head = "4c000000 0880 2c00 03000000 04000000 90d00300 20a10700 401f0000 18fcffff d0070000 48f4ffff 00 70110100 \
                00000000 000000";
    let wanted = [bytes(head), values.clone()].concat();
    assert_eq!(wanted.len(), 76);
    let surface = Surface {
        rows_count: 3,
        width: 4,
        x: Scale { scale_nm: 250_000, offset_um: -1_000 },
        y: Scale { scale_nm: 500_000, offset_um: 2_000 },
        z: Scale { scale_nm: 8_000, offset_um: -3_000 },
        source: 0,
        exposure_ns: 70_000,
        values: &values,
    };
    let framed = decode(&wanted).unwrap();
    assert_eq!((framed.last, framed.message), (true, Message::Surface(surface)));
    let mut written = Vec::new();
    surface.encode(Generation::Base, true, &mut written);
    assert_eq!(written, wanted);
}

#[test]
fn additional_attributes_of_later_versions_are_skipped_in_every_message() {
    let values = raw(&[1, 2, 3, 4]);
    let scale = Scale { scale_nm: 1, offset_um: 0 };
    let profiles =
        Profiles { count: 1, width: 2, x: scale, z: scale, source: 1, exposure_ns: 2, camera: 3, values: &values };
    let surface =
        Surface { rows_count: 2, width: 2, x: scale, y: scale, z: scale, source: 1, exposure_ns: 2, values: &values };
    let sizes = [Generation::Base, Generation::StreamStep, Generation::Arrayed].map(|generation| {
        let (mut cloud, mut area) = (Vec::new(), Vec::new());
        profiles.encode(kind::PROFILE_POINT_CLOUD, generation, true, &mut cloud);
        surface.encode(generation, true, &mut area);
        assert_eq!(decode(&cloud).unwrap().message, Message::PointClouds(profiles), "{generation:?}");
        assert_eq!(decode(&area).unwrap().message, Message::Surface(surface), "{generation:?}");
        (u16::from_le_bytes([cloud[6], cloud[7]]), u16::from_le_bytes([area[6], area[7]]))
    });
    // The sizes in the manuals and the library for the three generations.
    assert_eq!(sizes, [(32, 44), (40, 52), (48, 60)]);
}

#[test]
fn longer_stamps_of_later_versions_are_skipped() {
    let mut message = Vec::new();
    Stamps::encode(0, &[stamp(1), stamp(2)], true, &mut message);
    // Eight more bytes per stamp: a network time.
    let mut grown = message[..14].to_vec();
    for old in message[14..].chunks(56) {
        grown.extend_from_slice(old);
        grown.extend_from_slice(&[0xEE; 8]);
    }
    let size = grown.len() as u32;
    grown[..4].copy_from_slice(&size.to_le_bytes());
    grown[10] = 64;
    assert_eq!(stamps(&decode(&grown).unwrap().message), [stamp(1), stamp(2)]);
}

#[test]
fn requests_equal_those_of_the_makers_client() {
    for (command, wanted) in [
        (Command::ProtocolVersion, "060000001145"),
        (Command::SystemInfo, "060000000240"),
        (Command::States, "060000002545"),
        (Command::Mode, "060000000510"),
        (Command::Timestamp, "060000000a10"),
        (Command::Encoder, "060000001c10"),
        (Command::Start, "060000000d10"),
        (Command::Stop, "060000000110"),
    ] {
        let mut written = Vec::new();
        let request = Request { id: command.id(), payload: &[] };
        request.encode(&mut written);
        assert_eq!(written, bytes(wanted), "{command:?}");
        assert_eq!(Request::decode(&written), Ok(request));
        assert_eq!(Command::from_id(request.id), Some(command));
    }
    // A scheduled start has a payload.
    let mut written = Vec::new();
    Request { id: 0x100F, payload: &123_456_u64.to_le_bytes() }.encode(&mut written);
    assert_eq!(written, bytes("0e0000000f1040e2010000000000"));
}

#[test]
fn a_refusal_may_be_ten_bytes_long() {
    let wanted = bytes("0a000000 0d10 18fcffff");
    let reply = Reply { id: Command::Start.id(), status: Status::INVALID_STATE, payload: &[] };
    assert_eq!(Reply::decode(&wanted), Ok(reply));
    let mut written = Vec::new();
    reply.encode(&mut written);
    assert_eq!(written, wanted);
    assert_eq!(reply.status.to_string(), "invalid state (-1000)");
}

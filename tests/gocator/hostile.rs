//! Arbitrary bytes in the decoder never cause a panic, and never more memory than the number of bytes.

use super::golden::{POINT_CLOUD, UNIFORM, health};
use coaxis::device::gocator::codec::{
    CodecError, Identity, Message, Reply, Request, SensorState, Splitter, Version, decode,
};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Decodes all values of a message; the result is their number.
fn read_all(frame: &[u8]) -> Result<usize, CodecError> {
    Ok(match decode(frame)?.message {
        Message::Health(health) => health.iter().count(),
        Message::Stamps(stamps) => stamps.iter().count(),
        Message::PointClouds(profiles) => profiles.point_clouds().map(Iterator::count).sum(),
        Message::Uniform(profiles) => profiles.uniform().map(Iterator::count).sum(),
        Message::Intensity(intensity) => intensity.values.len(),
        Message::Surface(surface) => surface.rows().map(Iterator::count).sum(),
        Message::Other { .. } => 0,
    })
}

/// Splits and decodes a stream; no message has more values than bytes.
fn digest(stream: &[u8], frame_bytes_max: usize) -> Result<usize, CodecError> {
    let mut splitter = Splitter::new(frame_bytes_max);
    splitter.room().extend_from_slice(stream);
    let mut frames_count = 0;
    while let Some(frame) = splitter.next_frame()? {
        if let Ok(values_count) = read_all(frame) {
            assert!(values_count <= frame.len(), "{values_count} values of {} bytes", frame.len());
        }
        frames_count += 1;
    }
    // The buffer of one read, and the received bytes.
    assert!(splitter.reserved_bytes() <= 2 * (256 * 1024 + stream.len()), "{} reserved", splitter.reserved_bytes());
    Ok(frames_count)
}

#[test]
fn a_hundred_thousand_damaged_messages_are_refused_or_decoded() {
    let mut chance = ChaCha8Rng::seed_from_u64(20);
    let originals = [POINT_CLOUD.to_vec(), UNIFORM.to_vec(), health()];
    let (mut whole_count, mut refused_count) = (0, 0);
    for round in 0..100_000 {
        let mut stream = originals[round % originals.len()].clone();
        for _ in 0..chance.random_range(1..5) {
            let at = chance.random_range(0..stream.len());
            stream[at] = match chance.random_range(0..4) {
                0 => 0,
                1 => 0xFF,
                2 => 0x7F,
                _ => chance.random(),
            };
        }
        if chance.random_bool(0.2) {
            stream.truncate(chance.random_range(0..stream.len()));
        }
        match digest(&stream, 1 << 20) {
            Ok(_) => whole_count += 1,
            Err(_) => refused_count += 1,
        }
    }
    // Both must occur, or the test is not effective.
    assert!(whole_count > 1_000 && refused_count > 1_000, "{whole_count} read, {refused_count} refused");
}

#[test]
fn a_size_beyond_the_limit_is_refused_before_a_byte_is_reserved_for_it() {
    let mut splitter = Splitter::new(1 << 20);
    splitter.room().extend_from_slice(&u32::MAX.to_le_bytes());
    let limit = 1 << 20;
    assert_eq!(splitter.next_frame(), Err(CodecError::FrameTooLong { size: u32::MAX.into(), limit }));
    assert!(splitter.reserved_bytes() < 1 << 20);
    let mut splitter = Splitter::new(1 << 20);
    splitter.room().extend_from_slice(&[5, 0, 0, 0, 1, 0]);
    assert_eq!(splitter.next_frame(), Err(CodecError::FrameTooShort { size: 5, least: 6 }));
}

#[test]
fn counts_that_exceed_the_bytes_are_refused() {
    // The counts of the point cloud's profile, after its stamp of 70 bytes.
    for (at, counts) in [(78, [u32::MAX, u32::MAX]), (78, [u32::MAX, 0]), (78, [2, 5]), (78, [1, 6])] {
        let mut frame = POINT_CLOUD[70..].to_vec();
        for (place, count) in [at - 70, at - 66].into_iter().zip(counts) {
            frame[place..place + 4].copy_from_slice(&count.to_le_bytes());
        }
        let [rows, columns] = counts;
        assert_eq!(decode(&frame), Err(CodecError::CountsTooLarge { kind: 5, rows, columns, found: 20 }), "{counts:?}");
    }
}

#[test]
fn frames_are_the_same_for_any_division_of_the_stream() {
    let stream = [POINT_CLOUD, UNIFORM, POINT_CLOUD].concat();
    let whole = super::golden::frames(&stream);
    assert_eq!(whole.len(), 7);
    for piece in 1..=stream.len() {
        let (mut splitter, mut found) = (Splitter::new(1 << 20), Vec::new());
        for bytes in stream.chunks(piece) {
            splitter.room().extend_from_slice(bytes);
            while let Some(frame) = splitter.next_frame().expect("golden") {
                found.push(frame.to_vec());
            }
        }
        assert_eq!(found, whole, "in pieces of {piece}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2_000) })]

    #[test]
    fn any_bytes_are_read_or_refused(stream in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = digest(&stream, 1 << 16);
        let _ = (Request::decode(&stream), Reply::decode(&stream), Version::decode(&stream));
        let _ = (Identity::decode_v1(&stream), Identity::decode_v2(&stream), SensorState::decode(&stream));
    }

    #[test]
    fn any_message_of_a_known_type_is_read_or_refused(kind in 0_u16..9, body in prop::collection::vec(any::<u8>(), 0..200)) {
        let size = (6 + body.len()) as u32;
        let frame = [&size.to_le_bytes()[..], &kind.to_le_bytes(), &body].concat();
        prop_assert!(read_all(&frame).is_ok_and(|count| count <= frame.len()) || read_all(&frame).is_err());
    }
}

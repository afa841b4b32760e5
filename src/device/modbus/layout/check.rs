//! Refuses an invalid register map: fields outside their block or overlapping, more registers than one request can carry, codes and
//! bits with two meanings.

use super::super::error::LayoutError;
use super::{CommandMap, Layout, StatusFunction, StatusMap};
use crate::motion::Axes;

/// Registers that one request can read (Modbus application protocol V1.1b3, 6.3 and 6.4).
const READ_MAX: u16 = 125;
/// Registers that one request can write (6.12).
const WRITE_MAX: u16 = 123;
/// Total number of registers.
const ALL_COUNT: u32 = 65_536;

/// A field: its name, its offset and its number of registers.
type Field = (String, u16, u16);

impl Layout {
    /// Checks the map with both blocks moved by `base`.
    ///
    /// # Errors
    /// The first [`LayoutError`] that is found.
    pub fn check(&self, base: u16) -> Result<(), LayoutError> {
        block("status", self.status.base, base, self.status.count, READ_MAX)?;
        block("command", self.command.base, base, self.command.count, WRITE_MAX)?;
        apart(&self.status.fields(), self.status.count)?;
        apart(&self.command.fields(), self.command.count)?;
        if self.status.snapshot.is_some() != self.status.snapshot_copy.is_some() {
            return Err(LayoutError::HalfSnapshot);
        }
        let behind = self.command.fields().into_iter().find(|(_, at, _)| *at > self.command.sequence);
        if let Some((field, _, _)) = behind {
            return Err(LayoutError::SequenceNotLast { field });
        }
        self.blocks_apart()?;
        self.bits()?;
        self.codes.check()?;
        self.numbers.check()
    }

    fn blocks_apart(&self) -> Result<(), LayoutError> {
        let (status, command) = (&self.status, &self.command);
        let from = |base: u16, count: u16| (u32::from(base), u32::from(base) + u32::from(count));
        let ((a, a_end), (b, b_end)) = (from(status.base, status.count), from(command.base, command.count));
        // Input and holding registers have separate addresses.
        let same_kind = status.function == StatusFunction::Holding;
        if same_kind && a < b_end && b < a_end { Err(LayoutError::BlocksOverlap) } else { Ok(()) }
    }

    fn bits(&self) -> Result<(), LayoutError> {
        let (safety, axis) = (&self.status.safety_bits, &self.status.axis_bits);
        let safety = [
            ("emergency_stop_ok", safety.emergency_stop_ok),
            ("guard_closed", safety.guard_closed),
            ("drives_ready", safety.drives_ready),
            ("remote_enabled", safety.remote_enabled),
        ];
        different_bits("status.safety_bits", safety.map(|(name, bit)| (name.to_owned(), bit)))?;
        let groups = [
            ("homed", axis.homed),
            ("in_position", axis.in_position),
            ("fault", axis.fault),
            ("limit_hit", axis.limit_hit),
        ];
        different_bits("status.axis_bits", groups.iter().flat_map(|(name, bits)| named(name, *bits)))?;
        different_bits("command.axis_bits", named("axis", self.command.axis_bits))?;
        different_bits("command.armed_bit", [("armed_bit".to_owned(), self.command.armed_bit)])
    }
}

impl StatusMap {
    fn fields(&self) -> Vec<Field> {
        let single = [
            ("magic", self.magic, 1),
            ("heartbeat", Some(self.heartbeat), 1),
            ("heartbeat_echo", self.heartbeat_echo, 1),
            ("mode", Some(self.mode), 1),
            ("safety", Some(self.safety), 1),
            ("state", Some(self.state), 1),
            ("sequence", Some(self.sequence), 1),
            ("result", Some(self.result), 1),
            ("fault_code", Some(self.fault_code), 2),
            ("axis_flags", Some(self.axis_flags), 1),
            ("uptime", self.uptime, 2),
            ("snapshot", self.snapshot, 1),
            ("snapshot_copy", self.snapshot_copy, 1),
        ];
        let each = [
            ("axis_states", self.axis_states, 1),
            ("actual", self.actual, 2),
            ("commanded", self.commanded, 2),
            ("lower", self.lower, 2),
            ("upper", self.upper, 2),
            ("speed", self.speed, 2),
        ];
        fields("status", &single, &each)
    }
}

impl CommandMap {
    fn fields(&self) -> Vec<Field> {
        let single = [
            ("heartbeat", Some(self.heartbeat), 1),
            ("command", Some(self.command), 1),
            ("axis_mask", Some(self.axis_mask), 1),
            ("flags", self.flags, 1),
            ("watchdog_ms", self.watchdog_ms, 1),
            ("crc", self.crc, 1),
            ("fence", self.fence, 1),
            ("sequence", Some(self.sequence), 1),
        ];
        fields("command", &single, &[("targets", self.targets, 2), ("speeds", self.speeds, 2)])
    }
}

fn fields(block: &str, single: &[(&str, Option<u16>, u16)], each: &[(&str, Axes<u16>, u16)]) -> Vec<Field> {
    let single = single.iter().filter_map(|(name, at, width)| Some((format!("{block}.{name}"), (*at)?, *width)));
    let each = each.iter().flat_map(|(name, places, width)| {
        let field = |axis: &str, at: u16| (format!("{block}.{name}.{axis}"), at, *width);
        [field("x", places.x), field("y", places.y), field("z", places.z), field("c", places.c)]
    });
    single.chain(each).collect()
}

fn block(name: &'static str, own: u16, base: u16, count: u16, most: u16) -> Result<(), LayoutError> {
    if count == 0 || count > most {
        return Err(LayoutError::Count { block: name, count, most });
    }
    let from = u32::from(own) + u32::from(base);
    let fits = from + u32::from(count) <= ALL_COUNT;
    if fits { Ok(()) } else { Err(LayoutError::BeyondLast { block: name, from, count }) }
}

/// Checks that every field is within its block and that no two fields overlap.
fn apart(fields: &[Field], count: u16) -> Result<(), LayoutError> {
    let mut owners: Vec<Option<&str>> = vec![None; usize::from(count)];
    for (name, at, width) in fields {
        for register in 0..*width {
            let offset = at.saturating_add(register);
            let outside = || LayoutError::Outside { field: name.clone(), at: *at, count };
            let owner = owners.get_mut(usize::from(offset)).ok_or_else(outside)?;
            if let Some(first) = owner.replace(name) {
                return Err(LayoutError::Overlap { first: first.to_owned(), second: name.clone(), at: offset });
            }
        }
    }
    Ok(())
}

fn named(group: &str, bits: Axes<u8>) -> [(String, u8); 4] {
    [("x", bits.x), ("y", bits.y), ("z", bits.z), ("c", bits.c)].map(|(axis, bit)| (format!("{group}.{axis}"), bit))
}

fn different_bits(table: &'static str, bits: impl IntoIterator<Item = (String, u8)>) -> Result<(), LayoutError> {
    let mut seen: Vec<(String, u8)> = Vec::new();
    for (field, bit) in bits {
        if bit > 15 {
            return Err(LayoutError::BitOutside { table, field, bit });
        }
        if let Some((first, _)) = seen.iter().find(|(_, known)| *known == bit) {
            return Err(LayoutError::SameBit { table, first: first.clone(), second: field, bit });
        }
        seen.push((field, bit));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changed(change: impl FnOnce(&mut Layout)) -> Result<(), LayoutError> {
        let mut layout = Layout::default();
        change(&mut layout);
        layout.check(0)
    }

    #[test]
    fn map_v1_fits_at_every_base_up_to_the_last_register() {
        // Its last register is 128 + 23 = 151, so 65535 - 151 is the last base.
        assert_eq!(Layout::default().check(65_384), Ok(()));
        let beyond = LayoutError::BeyondLast { block: "command", from: 65_513, count: 24 };
        assert_eq!(Layout::default().check(65_385), Err(beyond));
    }

    #[test]
    fn more_registers_than_one_request_can_carry_are_refused() {
        let count = |block, count, most| Err(LayoutError::Count { block, count, most });
        assert_eq!(changed(|map| map.status.count = 126), count("status", 126, 125));
        assert_eq!(changed(|map| map.status.count = 125), Ok(()));
        assert_eq!(changed(|map| map.command.count = 124), count("command", 124, 123));
        assert_eq!(changed(|map| map.command.count = 0), count("command", 0, 123));
    }

    #[test]
    fn overlapping_fields_and_fields_outside_the_block_are_refused_by_name() {
        let overlap = |first: &str, second: &str, at| {
            Err(LayoutError::Overlap { first: first.to_owned(), second: second.to_owned(), at })
        };
        assert_eq!(changed(|map| map.status.mode = 9), overlap("status.mode", "status.fault_code", 9));
        assert_eq!(changed(|map| map.status.lower.x = 31), overlap("status.commanded.c", "status.lower.x", 31));
        let outside = LayoutError::Outside { field: "status.actual.x".to_owned(), at: 63, count: 64 };
        let half_out = |map: &mut Layout| {
            (map.status.snapshot, map.status.snapshot_copy) = (None, None);
            map.status.actual.x = 63;
        };
        assert_eq!(changed(half_out), Err(outside));
        assert!(matches!(changed(|map| map.status.mode = u16::MAX), Err(LayoutError::Outside { .. })));
    }

    #[test]
    fn the_sequence_number_is_the_last_register() {
        let swapped = |map: &mut Layout| (map.command.sequence, map.command.fence) = (22, Some(23));
        assert_eq!(changed(swapped), Err(LayoutError::SequenceNotLast { field: "command.fence".to_owned() }));
    }

    #[test]
    fn blocks_may_share_addresses_only_in_different_kinds_of_registers() {
        assert_eq!(changed(|map| map.command.base = 10), Ok(()));
        let same = |map: &mut Layout| (map.status.function, map.command.base) = (StatusFunction::Holding, 63);
        assert_eq!(changed(same), Err(LayoutError::BlocksOverlap));
        assert_eq!(changed(|map| map.status.function = StatusFunction::Holding), Ok(()));
    }

    #[test]
    fn a_bit_with_two_meanings_is_refused() {
        let twice = changed(|map| map.status.axis_bits.homed.x = 15);
        let same = |first: &str, second: &str, bit| {
            Err(LayoutError::SameBit {
                table: "status.axis_bits",
                first: first.to_owned(),
                second: second.to_owned(),
                bit,
            })
        };
        assert_eq!(twice, same("homed.x", "limit_hit.c", 15));
        assert!(matches!(changed(|map| map.status.safety_bits.guard_closed = 16), Err(LayoutError::BitOutside { .. })));
    }

    #[test]
    fn a_single_snapshot_counter_is_refused() {
        assert_eq!(changed(|map| map.status.snapshot_copy = None), Err(LayoutError::HalfSnapshot));
        assert_eq!(changed(|map| (map.status.snapshot, map.status.snapshot_copy) = (None, None)), Ok(()));
    }

    #[test]
    fn a_custom_map_is_parsed_and_written_without_loss() {
        let text = r#"
            word_order = "cdab"
            numbers = { i32 = { mm = 0.0001 } }
            [status]
            function = "holding"
            count = 40
            magic = "none"
            uptime = "none"
            snapshot = "none"
            snapshot_copy = "none"
            actual = { x = 16, y = 24, z = 32, c = 38 }
            commanded = { x = 18, y = 26, z = 34, c = 36 }
            [codes]
            states = "codesys"
        "#;
        let layout: Layout = toml::from_str(text).expect("a layout");
        assert_eq!((layout.status.magic, layout.status.actual.y), (None, 24));
        assert_eq!(layout.codes.states.codes().standstill, 3);
        let again: Layout = toml::from_str(&toml::to_string(&layout).expect("text")).expect("a layout");
        assert_eq!(again, layout);
        assert!(toml::from_str::<Layout>("[status]\nactaul = 3").is_err());
        assert!(toml::from_str::<Layout>("[status]\nmagic = \"nowhere\"").is_err());
    }
}

//! Encodes a [`Command`] as the registers of the command block, and decodes it for the simulated device. Angles are in radians
//! inside and in degrees in the registers; values that the registers cannot represent are refused before anything is sent. Pure.

use super::error::MapError;
use super::layout::{CommandMap, Layout};
use super::status::is_set;
use super::words::crc16;
use crate::device::manipulator::{Action, Command};
use crate::motion::{Axes, Axis, Position};
use std::time::Duration;

/// All registers of the block for a command.
pub(super) fn encode(layout: &Layout, command: &Command, heartbeat: u16) -> Result<Vec<u16>, MapError> {
    if command.sequence == 0 {
        return Err(MapError::NoSequence);
    }
    let map = &layout.command;
    let mut image = Image { layout, registers: vec![0; usize::from(map.count)] };
    image.put(map.command, code(layout, &command.action));
    image.put(map.axis_mask, mask(map, &axes_of(&command.action)));
    if let Action::MoveTo { targets, speeds, .. } = &command.action {
        image.numbers("target", map.targets, targets)?;
        image.numbers("speed", map.speeds, speeds)?;
    }
    if let Some(at) = map.flags {
        image.put(at, u16::from(may_move(&command.action)).checked_shl(u32::from(map.armed_bit)).unwrap_or(0));
    }
    if let Some(at) = map.watchdog_ms {
        image.put(at, watchdog_ms(command.watchdog)?);
    }
    // The heartbeat is also written by itself, so the CRC must not depend on it.
    if let Some(at) = map.crc {
        image.put(at, crc_of(map, &image.registers));
    }
    image.put(map.heartbeat, heartbeat);
    if let Some(at) = map.fence {
        image.put(at, (command.fence & 0xFFFF) as u16);
    }
    image.put(map.sequence, command.sequence);
    Ok(image.registers)
}

/// Decodes a command, with as many bits of the fencing token as the registers have.
///
/// The watchdog is `default_watchdog` if the map has no register for it.
pub(super) fn decode(layout: &Layout, registers: &[u16], default_watchdog: Duration) -> Result<Command, MapError> {
    let map = &layout.command;
    let word = |at: u16| registers.get(usize::from(at)).copied().ok_or(MapError::Missing { at });
    if let Some(at) = map.crc {
        let (found, expected) = (word(at)?, crc_of(map, registers));
        if found != 0 && found != expected {
            return Err(MapError::Crc { found, expected });
        }
    }
    let sequence = word(map.sequence)?;
    if sequence == 0 {
        return Err(MapError::NoSequence);
    }
    let mask = word(map.axis_mask)?;
    let axes = map.axis_bits.map(|_, bit| is_set(mask, *bit));
    let code = word(map.command)?;
    let codes = &layout.codes.commands;
    let action = match code {
        code if code == codes.enable => Action::Enable,
        code if code == codes.disable => Action::Disable,
        code if code == codes.reset => Action::Reset,
        code if code == codes.halt => Action::Halt,
        code if code == codes.home => Action::Home { axes },
        code if code == codes.move_to => Action::MoveTo {
            axes,
            targets: numbers(layout, registers, "target", map.targets)?,
            speeds: numbers(layout, registers, "speed", map.speeds)?,
        },
        code => return Err(MapError::Code { what: "command", code }),
    };
    let watchdog = match map.watchdog_ms {
        Some(at) => Duration::from_millis(word(at)?.into()),
        None => default_watchdog,
    };
    let fence = map.fence.map_or(Ok(0), word)?.into();
    Ok(Command { sequence, fence, watchdog, action })
}

struct Image<'a> {
    layout: &'a Layout,
    registers: Vec<u16>,
}

impl Image<'_> {
    fn put(&mut self, at: u16, word: u16) {
        if let Some(register) = self.registers.get_mut(usize::from(at)) {
            *register = word;
        }
    }

    fn numbers(&mut self, what: &'static str, places: Axes<u16>, values: &Position) -> Result<(), MapError> {
        for (axis, value) in values.iter() {
            let value = axis.outside(*value);
            let bits = self.layout.numbers.bits(axis, value).ok_or(MapError::Unfit { axis, what, value })?;
            let [first, second] = self.layout.word_order.registers(bits);
            let at = *places.get(axis);
            self.put(at, first);
            self.put(at.saturating_add(1), second);
        }
        Ok(())
    }
}

fn numbers(layout: &Layout, registers: &[u16], what: &'static str, places: Axes<u16>) -> Result<Position, MapError> {
    let word = |at: u16| registers.get(usize::from(at)).copied().ok_or(MapError::Missing { at });
    let mut values = Position::default();
    for axis in Axis::ALL {
        let at = *places.get(axis);
        let bits = layout.word_order.bits([word(at)?, word(at.saturating_add(1))?]);
        let value = layout.numbers.value(axis, bits);
        if !value.is_finite() {
            return Err(MapError::Value { axis, what, value });
        }
        *values.get_mut(axis) = axis.inside(value);
    }
    Ok(values)
}

/// The CRC of the registers before it, with 0 in place of the heartbeat.
fn crc_of(map: &CommandMap, registers: &[u16]) -> u16 {
    let upto = usize::from(map.crc.unwrap_or(0));
    let heartbeat = usize::from(map.heartbeat);
    crc16(registers.iter().take(upto).enumerate().map(|(at, word)| if at == heartbeat { 0 } else { *word }))
}

const fn code(layout: &Layout, action: &Action) -> u16 {
    let codes = &layout.codes.commands;
    match action {
        Action::Enable => codes.enable,
        Action::Disable => codes.disable,
        Action::Reset => codes.reset,
        Action::Home { .. } => codes.home,
        Action::MoveTo { .. } => codes.move_to,
        Action::Halt => codes.halt,
    }
}

const fn axes_of(action: &Action) -> Axes<bool> {
    match action {
        Action::Home { axes } | Action::MoveTo { axes, .. } => *axes,
        Action::Enable | Action::Disable | Action::Reset | Action::Halt => Axes { x: true, y: true, z: true, c: true },
    }
}

/// Whether the action needs an armed device, because it moves or enables the device.
const fn may_move(action: &Action) -> bool {
    match action {
        Action::Enable | Action::Home { .. } | Action::MoveTo { .. } => true,
        Action::Disable | Action::Reset | Action::Halt => false,
    }
}

fn mask(map: &CommandMap, axes: &Axes<bool>) -> u16 {
    map.axis_bits
        .iter()
        .filter(|(axis, _)| *axes.get(*axis))
        .fold(0, |mask, (_, bit)| mask | 1_u16.checked_shl(u32::from(*bit)).unwrap_or(0))
}

fn watchdog_ms(watchdog: Duration) -> Result<u16, MapError> {
    let ms = watchdog.as_millis();
    u16::try_from(ms).ok().filter(|ms| *ms > 0).ok_or(MapError::Watchdog { ms })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::modbus::{Numbers, Scales, WordOrder};
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    const WATCHDOG: Duration = Duration::from_millis(500);

    fn command(action: Action) -> Command {
        Command { sequence: 7, fence: 0x1_0002, watchdog: WATCHDOG, action }
    }

    fn to_x_and_c() -> Action {
        Action::MoveTo {
            axes: Axes { x: true, y: false, z: false, c: true },
            targets: Axes { x: 12.5, y: 0.0, z: -1.0, c: FRAC_PI_2 },
            speeds: Axes { x: 25.0, y: 0.0, z: 0.0, c: FRAC_PI_2 / 9.0 },
        }
    }

    /// 12.5 = 0x41480000, -1 = 0xBF800000, 90 = 1.40625 * 2^6 = 0x42B40000, 25 = 0x41C80000, 10 = 0x41200000; the mask of x and c
    /// is 1001b; 500 = 0x1F4. The CRC was calculated independently with pymodbus 3.16.1 (FramerRTU.compute_CRC, bytes swapped) over
    /// the 42 bytes of registers 0 to 20 with 0 as heartbeat.
    #[test]
    fn a_move_is_encoded_in_the_registers_of_map_v1() {
        let registers = encode(&Layout::default(), &command(to_x_and_c()), 99).expect("fits");
        let (targets, speeds) = ([0x4148, 0, 0, 0, 0xBF80, 0, 0x42B4, 0], [0x41C8, 0, 0, 0, 0, 0, 0x4120, 0]);
        assert_eq!(registers[0..4], [99, 5, 9, 1]);
        assert_eq!(registers[4..12], targets);
        assert_eq!(registers[12..20], speeds);
        assert_eq!(registers[20], 500);
        assert_eq!(registers[22..], [2, 7]);
        assert_eq!(registers[21], CRC_BY_PYMODBUS);
    }
    const CRC_BY_PYMODBUS: u16 = 0xA9CE;

    #[test]
    fn only_commands_that_move_or_enable_are_armed() {
        for (action, code, flags) in
            [(Action::Enable, 1, 1), (Action::Disable, 2, 0), (Action::Reset, 3, 0), (Action::Halt, 6, 0)]
        {
            let registers = encode(&Layout::default(), &command(action), 0).expect("fits");
            assert_eq!(registers[1..4], [code, 15, flags]);
        }
    }

    #[test]
    fn a_value_that_does_not_fit_into_the_registers_is_refused() {
        let refused = |change: fn(&mut Command)| {
            let mut command = command(to_x_and_c());
            change(&mut command);
            encode(&Layout::default(), &command, 0).expect_err("does not fit")
        };
        assert_eq!(refused(|command| command.sequence = 0), MapError::NoSequence);
        assert_eq!(refused(|command| command.watchdog = Duration::ZERO), MapError::Watchdog { ms: 0 });
        assert_eq!(refused(|command| command.watchdog = Duration::from_secs(66)), MapError::Watchdog { ms: 66_000 });
        let infinite = refused(|command| {
            command.action = Action::MoveTo {
                axes: Axes::default(),
                targets: Axes { y: f64::INFINITY, ..Axes::default() },
                speeds: Axes::default(),
            };
        });
        assert_eq!(infinite, MapError::Unfit { axis: Axis::Y, what: "target", value: f64::INFINITY });
    }

    #[test]
    fn the_crc_detects_a_changed_register_and_ignores_the_heartbeat() {
        let layout = Layout::default();
        let whole = encode(&layout, &command(to_x_and_c()), 1).expect("fits");
        for at in 1..=20 {
            let mut changed = whole.clone();
            changed[at] ^= 0x0100;
            assert!(matches!(decode(&layout, &changed, WATCHDOG), Err(MapError::Crc { .. })), "register {at}");
        }
        let mut beaten = whole;
        beaten[0] = 2;
        assert!(decode(&layout, &beaten, WATCHDOG).is_ok());
    }

    fn any_layout() -> impl Strategy<Value = Layout> {
        let orders = prop::sample::select(WordOrder::ALL.to_vec());
        let numbers = prop::sample::select(vec![Numbers::F32, Numbers::I32(Scales::default())]);
        (orders, numbers).prop_map(|(word_order, numbers)| Layout { word_order, numbers, ..Layout::default() })
    }

    proptest! {
        /// Half a unit of single precision at 500 is 1.6e-5, half a count is 5e-4 mm or 5e-5 degrees.
        #[test]
        fn commands_are_recovered_from_their_registers(
            layout in any_layout(), sequence in 1_u16.., fence: u16, ms in 1_u16..,
            bits in 0_u8..16, targets: [i16; 4], speeds: [u16; 4],
        ) {
            let axes = Axes::from_fn(|axis| bits >> (axis as u8) & 1 == 1);
            let scaled = |values: [f64; 4]| {
                let [x, y, z, c] = values;
                Axes { x: x / 64.0, y: y / 64.0, z: z / 64.0, c: (c / 64.0).to_radians() }
            };
            let (targets, speeds) = (scaled(targets.map(f64::from)), scaled(speeds.map(f64::from)));
            let watchdog = Duration::from_millis(ms.into());
            let sent = Command { sequence, fence: fence.into(), watchdog, action: Action::MoveTo { axes, targets, speeds } };
            let registers = encode(&layout, &sent, 3).expect("fits");
            let back = decode(&layout, &registers, WATCHDOG).expect("complete");
            prop_assert_eq!((back.sequence, back.fence, back.watchdog), (sequence, fence.into(), watchdog));
            let Action::MoveTo { axes: came, targets: to, speeds: at } = back.action else { panic!("a move") };
            prop_assert_eq!(came, axes);
            for axis in Axis::ALL {
                prop_assert!((to.get(axis) - targets.get(axis)).abs() < 6e-4);
                prop_assert!((at.get(axis) - speeds.get(axis)).abs() < 6e-4);
            }
        }

        #[test]
        fn any_registers_decode_to_a_finite_command_or_an_error(
            layout in any_layout(), registers in prop::collection::vec(any::<u16>(), 0..40), crc: bool,
        ) {
            let mut layout = layout;
            layout.command.crc = layout.command.crc.filter(|_| crc);
            if let Ok(Command { action: Action::MoveTo { targets, speeds, .. }, .. }) = decode(&layout, &registers, WATCHDOG) {
                prop_assert!(targets.iter().chain(speeds.iter()).all(|(_, value)| value.is_finite()));
            }
        }
    }
}

//! CRC-16/MODBUS over registers, high byte first: polynomial 0x8005 reflected, start 0xFFFF (Modbus over serial line,
//! specification V1.02, 6.2.2).

/// The CRC of registers.
pub(super) fn crc16(registers: impl IntoIterator<Item = u16>) -> u16 {
    registers.into_iter().flat_map(u16::to_be_bytes).fold(0xFFFF, |crc, byte| {
        (0..8).fold(crc ^ u16::from(byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xA001 } else { crc >> 1 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_frame_has_its_crc() {
        // Modbus over serial line, V1.02, example: the frame 02 07 ends with 41 12, low byte first.
        assert_eq!(crc16([0x0207]), 0x1241);
    }

    #[test]
    fn one_changed_bit_changes_it() {
        let registers = [0_u16, 5, 0xF, 1, 0x4148, 0];
        let whole = crc16(registers);
        for bit in 0..registers.len() * 16 {
            let mut changed = registers;
            changed[bit / 16] ^= 1 << (bit % 16);
            assert_ne!(crc16(changed), whole, "bit {bit}");
        }
    }
}

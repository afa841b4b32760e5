//! Decides which command is newer: by the sequence number of the command (1 to 65535, then 1 again; 0 means none), and by the
//! fencing token of its lease. Every adaptor keeps a [`FenceGate`] for its lifetime, across reconnects, so that a command with the
//! fencing token of an older lease is not sent.

use super::error::DeviceError;

/// The number of sequence numbers.
const CIRCLE: u32 = u16::MAX as u32;

/// The number after `last`; 1 after none (0).
#[must_use]
pub const fn next(last: u16) -> u16 {
    last % u16::MAX + 1
}

/// Whether `one` was assigned after `other`: half of all numbers are newer than a given number, and half are older. Every number is
/// newer than none (0), and none is newer than nothing.
#[must_use]
pub const fn is_newer(one: u16, other: u16) -> bool {
    if one == 0 || other == 0 {
        return one != 0;
    }
    let ahead = (one as u32 + CIRCLE - other as u32) % CIRCLE;
    ahead != 0 && ahead <= CIRCLE / 2
}

/// The newest fencing token that was sent to a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FenceGate {
    newest: u64,
}

impl FenceGate {
    /// Admits a command whose fencing token is not older than any before. It must be called before the command is sent.
    ///
    /// # Errors
    /// [`DeviceError::Fenced`] if an earlier command had a newer token.
    pub fn admit(&mut self, device: &str, fence: u64) -> Result<(), DeviceError> {
        if fence < self.newest {
            return Err(DeviceError::Fenced { device: device.to_owned(), fence, newest: self.newest });
        }
        self.newest = fence;
        Ok(())
    }

    /// The newest fencing token; 0 before the first command.
    #[must_use]
    pub const fn newest(&self) -> u64 {
        self.newest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_after_the_last_is_one_and_zero_is_never_used() {
        assert_eq!([0, 1, 65_534, 65_535].map(next), [1, 2, 65_535, 1]);
    }

    #[test]
    fn half_of_all_numbers_are_newer_also_across_the_wrap_around() {
        for (one, other, newer) in [
            (1, 0, true),
            (0, 0, false),
            (0, 9, false),
            (9, 9, false),
            (10, 9, true),
            (8, 9, false),
            (1, 65_535, true),
            (65_535, 1, false),
            (32_768, 1, true),
            (32_769, 1, false),
            (32_768, 65_535, false),
            (32_767, 65_535, true),
        ] {
            assert_eq!(is_newer(one, other), newer, "{one} after {other}");
        }
    }

    #[test]
    fn exactly_one_of_two_different_numbers_is_newer_and_the_next_always_is() {
        for one in 1..=u16::MAX {
            assert!(is_newer(next(one), one), "{one}");
            // About a hundred others, distributed over the whole range.
            for other in (1..=u16::MAX).step_by(613).filter(|other| *other != one) {
                assert_ne!(is_newer(one, other), is_newer(other, one), "{one} and {other}");
            }
        }
    }
}

#[cfg(test)]
mod fence_tests {
    use super::*;

    #[test]
    fn an_older_fencing_token_is_refused_and_the_newest_is_admitted() {
        let mut gate = FenceGate::default();
        assert!(gate.admit("m1", 7).is_ok() && gate.admit("m1", 7).is_ok() && gate.admit("m1", 9).is_ok());
        let refused = gate.admit("m1", 8);
        assert_eq!(refused, Err(DeviceError::Fenced { device: "m1".to_owned(), fence: 8, newest: 9 }));
        assert_eq!(gate.newest(), 9);
    }
}

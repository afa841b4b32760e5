//! Which command is newer: by the sequence number of the command (1 to 65535, then 1 again; 0 is no number), and by the fencing
//! token of its lease. Every adaptor keeps a [`FenceGate`] for as long as it lives, across reconnects: a command with the fencing
//! token of an older lease is not sent.

use super::error::DeviceError;

/// How many numbers there are.
const CIRCLE: u32 = u16::MAX as u32;

/// The number after `last`; 1 where there was none yet (0).
#[must_use]
pub const fn next(last: u16) -> u16 {
    last % u16::MAX + 1
}

/// Whether `one` was given out after `other`: half of the circle lies ahead of a number, and half of it behind. Anything is newer
/// than none, and none (0) is newer than nothing.
#[must_use]
pub const fn is_newer(one: u16, other: u16) -> bool {
    if one == 0 || other == 0 {
        return one != 0;
    }
    let ahead = (one as u32 + CIRCLE - other as u32) % CIRCLE;
    ahead != 0 && ahead <= CIRCLE / 2
}

/// The newest fencing token with which a device was commanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FenceGate {
    newest: u64,
}

impl FenceGate {
    /// Admits a command whose fencing token is not older than any before; to be called before it is sent.
    ///
    /// # Errors
    /// [`DeviceError::Fenced`] if there was a command with a newer one.
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
    fn the_number_after_the_last_is_one_and_none_is_given_out() {
        assert_eq!([0, 1, 65_534, 65_535].map(next), [1, 2, 65_535, 1]);
    }

    #[test]
    fn half_of_the_circle_lies_ahead_also_where_the_numbers_begin_again() {
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
    fn of_two_numbers_that_differ_exactly_one_is_newer_and_the_next_always_is() {
        for one in 1..=u16::MAX {
            assert!(is_newer(next(one), one), "{one}");
            // Some hundred others, all around the circle.
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
    fn an_older_fence_is_refused_and_the_newest_may_go_on() {
        let mut gate = FenceGate::default();
        assert!(gate.admit("m1", 7).is_ok() && gate.admit("m1", 7).is_ok() && gate.admit("m1", 9).is_ok());
        let refused = gate.admit("m1", 8);
        assert_eq!(refused, Err(DeviceError::Fenced { device: "m1".to_owned(), fence: 8, newest: 9 }));
        assert_eq!(gate.newest(), 9);
    }
}

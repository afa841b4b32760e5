//! The fence: a command that carries an older lease's number goes nowhere. Every adaptor holds one, for as long as it lives,
//! across reconnects.

use super::error::DeviceError;

/// The newest fence that a device was commanded with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FenceGate {
    newest: u64,
}

impl FenceGate {
    /// Lets a command pass whose fence is not older than any before; to be asked before a byte is sent.
    ///
    /// # Errors
    /// [`DeviceError::Fenced`] where a newer one has commanded.
    pub fn admit(&mut self, device: &str, fence: u64) -> Result<(), DeviceError> {
        if fence < self.newest {
            return Err(DeviceError::Fenced { device: device.to_owned(), fence, newest: self.newest });
        }
        self.newest = fence;
        Ok(())
    }

    /// The newest fence so far; 0 where there was none.
    #[must_use]
    pub const fn newest(&self) -> u64 {
        self.newest
    }
}

#[cfg(test)]
mod tests {
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

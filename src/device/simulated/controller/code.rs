//! The codes of a made controller, in [`crate::device::Reading::fault_code`]: below 100 faults, which a reset acknowledges;
//! from 100 on why the newest command was refused, until there is a newer one.

/// Nobody was heard for the watchdog's time while it moved.
pub const WATCHDOG: u32 = 1;
/// An axis ran onto its limit switch.
pub const LIMIT_SWITCH: u32 = 2;
/// The safety functions took the motion away.
pub const SAFETY: u32 = 3;
/// A target is outside of the limits, or not finite.
pub const OUT_OF_LIMITS: u32 = 101;
/// A speed is zero, too great or not finite.
pub const SPEED: u32 = 102;
/// The drives are not enabled.
pub const NOT_ENABLED: u32 = 103;
/// An axis has no reference.
pub const NOT_HOMED: u32 = 104;
/// A fault is latched.
pub const FAULTED: u32 = 105;
/// It is not in automatic mode.
pub const NOT_REMOTE: u32 = 106;
/// The safety functions do not allow motion.
pub const SAFETY_OPEN: u32 = 107;
/// No axis was named.
pub const NO_AXIS: u32 = 108;

//! The states of the cell and their transitions; `machine` decides by them.
//!
//! ```text
//!            both manipulators read          start_move, home
//!  offline ------------------------> idle ----------------------> moving ---+
//!                                    ^ ^ \----- start_scan -----> scanning -+
//!                                    | |                             |   |  |
//!                                    | +---------- finished ---------+---+  | stop, lease expired or released,
//!                                    |                                      | failed without a fault
//!                                    +-- all read at rest -- stopping <-----+   (from idle too: stop)
//!                                    |
//!                                    +-- reset with the lease, and every device read at rest -- faulted
//!
//!  any --- a link lost (not while offline), a fault, an unknown outcome ---> faulted (every device is halted)
//! ```
//!
//! The usual sequence is offline, idle, moving, idle. States ending in -ing are transient; only a reset leaves `faulted`.

/// The state of the cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// A manipulator has not been reached yet.
    Offline,
    /// Every device is at rest; a job may begin.
    Idle,
    /// A scan is being taken.
    Scanning,
    /// A move or a homing is being executed.
    Moving,
    /// A halt was sent to every device; not all of them have been read at rest yet.
    Stopping,
    /// A fault is latched; nothing moves until a reset.
    Faulted,
}

impl State {
    /// The name in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Offline => "offline",
            Self::Idle => "idle",
            Self::Scanning => "scanning",
            Self::Moving => "moving",
            Self::Stopping => "stopping",
            Self::Faulted => "faulted",
        }
    }
}

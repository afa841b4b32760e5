//! The drivers: one task for each device. A driver owns its adaptor, reads the device periodically, executes one command at a time
//! with a deadline, and checks the halt flag before anything else. It reports a lost link and reconnects, but sends no command
//! again. `device_driver` is the loop that all of them share; read it first.

pub(super) mod context;
pub(super) mod device_driver;
pub(super) mod manipulator;
pub(super) mod messages;
pub(super) mod sensor;
pub(super) mod stage;

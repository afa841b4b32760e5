//! The drivers: a task for each device, which owns its adaptor, reads it periodically, executes one command at a time with a
//! deadline, and looks at the halt flag before anything else. A lost link is reported and connected again; no command is sent
//! again. In: commands, and the halt flag. Out: reports. `device_driver` is the loop that all of them share; read it first.

pub(super) mod context;
pub(super) mod device_driver;
pub(super) mod manipulator;
pub(super) mod messages;
pub(super) mod sensor;
pub(super) mod stage;

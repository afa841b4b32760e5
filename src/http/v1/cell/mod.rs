//! The cell as a whole: its state, the lease, stop and reset.

pub(in crate::http) mod lease;
pub(in crate::http) mod live;
pub(in crate::http) mod plc;

pub(in crate::http) use lease::{
    __path_get_lease, __path_release_lease, __path_take_lease, get_lease, release_lease, take_lease,
};
pub(in crate::http) use lease::{__path_reset_cell, __path_stop_cell, TakenDocument, reset_cell, stop_cell};
pub(in crate::http) use live::{__path_get_cell, get_cell};

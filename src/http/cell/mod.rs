//! The cell as a whole: how it is, who may move, stop and reset.

mod lease;
mod live;
mod plc;
mod stop;

pub(super) use lease::{
    __path_get_lease, __path_release_lease, __path_take_lease, get_lease, release_lease, take_lease,
};
pub(super) use live::{__path_get_cell, get_cell};
pub(super) use plc::permille;
pub(super) use stop::{__path_reset_cell, __path_stop_cell, TakenDocument, reset_cell, stop_cell};

//! Many moves with faults by chance.

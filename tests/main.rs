//! All integration tests, in one binary, so that only one program is linked. Each file is a module; the enclosing modules are
//! the groups of `tests/run`.

mod made;
mod measured;
mod real;

mod api;

/// From files and points to poses: exact data, reference sets, measured files, damaged files.
#[path = "."]
mod calculation {
    mod detect;
    mod field;
    mod form;
    mod hostile;
    mod instruments;
    mod laws;
    mod least_squares;
    mod measured_files;
    mod parts;
    mod scan_files;
}

/// Errors and stated uncertainties over many seeds. `tests/run long` uses more seeds than the default.
#[path = "."]
mod statistics {
    mod coverage;
    mod cylinder;
    mod end_face;
    mod field_kinds;
    mod published;
    mod random_scenes;
    mod slicing;
    mod type_b;
}

/// Simulated devices, with paused time.
#[path = "."]
mod devices {
    mod simulated_cell;
}

/// The program as a command, and the rules of the project.
#[path = "."]
mod project {
    mod api_policy;
    mod architecture;
    mod command;
    mod cycles;
    mod files;
    mod licences;
}

/// Tests with deadlines of some hundred milliseconds on the real clock, which a busy machine exceeds. They run one at a time, after
/// the others.
#[path = "."]
mod timed {
    #[path = "api/cell/mod.rs"]
    pub(crate) mod cell;
    mod gocator;
    mod plc_modbus;
    mod plc_opcua;
}

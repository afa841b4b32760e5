#![no_main]

use coaxis_fuzz::devices;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| devices::gocator_data(data));

#![no_main]

use coaxis_fuzz::scans;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| scans::matrix(data));

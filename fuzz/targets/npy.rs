#![no_main]

use coaxis::scan::decode::Format;
use coaxis_fuzz::scans;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| scans::file(Format::Npy, data));

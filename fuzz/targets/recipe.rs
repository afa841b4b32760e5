#![no_main]

use coaxis_fuzz::settings;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| settings::recipe(data));

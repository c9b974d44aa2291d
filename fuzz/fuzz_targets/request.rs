#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fgs_fuzz::request(bytes));

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| crazyflie_server::fuzzed::run("options", bytes));

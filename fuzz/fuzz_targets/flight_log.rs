#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| crazyflie_server::fuzzed::run("flight_log", bytes));

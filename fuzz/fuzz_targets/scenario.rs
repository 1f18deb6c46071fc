#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    crazyflie_bench::fuzzed::scenario(bytes);
});

#![no_main]
#[allow(dead_code, reason = "each target runs one body")]
#[path = "../../tests/fuzz/bodies.rs"]
mod bodies;
use presight_testkit as common;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    bodies::messages(bytes);
});

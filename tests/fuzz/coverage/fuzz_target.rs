//! The target that has the name of the program.
#![no_main]

#[path = "../targets/mod.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| targets::target(env!("CARGO_BIN_NAME"))(bytes));

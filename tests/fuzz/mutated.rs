//! A bounded number of mutated inputs, the same in every run: what coverage-guided runs find in hours, these would find in part.

use crate::corpora::inputs_of;
use crate::support::draw::Draw;
use crate::targets::TARGETS;
use std::panic::catch_unwind;

/// Words that parsers care for.
const WORDS: [&[u8]; 24] = [
    b"nan",
    b"inf",
    b"1e999",
    b"-1",
    b"0",
    b"4294967295",
    b"4294967296",
    b"18446744073709551616",
    b"1e-400",
    b"\0",
    b"\xff\xff\xff\xff",
    b"\x7f\xff\xff\xff",
    b"\xc3\x28",
    b"\n",
    b" ",
    b"\"",
    b"{}",
    b"[]",
    b"null",
    b"f 1 1 1\n",
    b"v 0 0 0\n",
    b"true",
    b"/",
    b"../x",
];

/// An input that differs from those of the corpus in a few places.
fn mutated(inputs: &[Vec<u8>], draw: &mut Draw) -> Vec<u8> {
    let mut input = inputs[draw.below(inputs.len())].clone();
    for _ in 0..1 + draw.below(6) {
        let at = draw.below(input.len() + 1);
        match draw.below(8) {
            0 => input.truncate(at),
            1 => input.insert(at, draw.bits() as u8),
            2 => drop(input.splice(at..at, WORDS[draw.below(WORDS.len())].iter().copied())),
            3 => {
                let end = (at + 1 + draw.below(16)).min(input.len());
                drop(input.drain(at..end));
            }
            4 => {
                let other = &inputs[draw.below(inputs.len())];
                let (from, length) = (draw.below(other.len() + 1), 1 + draw.below(64));
                let piece = other[from..(from + length).min(other.len())].to_vec();
                drop(input.splice(at..at, piece));
            }
            5 => {
                let end = (at + 1 + draw.below(32)).min(input.len());
                let piece = input[at..end].to_vec();
                drop(input.splice(at..at, piece));
            }
            _ if input.is_empty() => {}
            _ => {
                let at = at.min(input.len() - 1);
                input[at] ^= 1 << draw.below(8);
            }
        }
    }
    input
}

/// How often each target is run. Those that deform or write models take longer.
fn rounds(name: &str) -> usize {
    match name {
        "jobs" | "edits" | "soups" => 150,
        "glb" | "gltf" | "fbx" | "any_model" | "decoders" => 1500,
        _ => 4000,
    }
}

/// A number that a variable of the environment gives.
fn number_from(variable: &str, otherwise: u64) -> u64 {
    std::env::var(variable).map_or(otherwise, |text| text.parse().expect("a whole number"))
}

/// `PLIANT_FUZZ_TIMES` runs so many times the rounds, `PLIANT_FUZZ_SEED` draws other inputs.
#[test]
fn no_mutated_input_upsets_a_target() {
    let times = number_from("PLIANT_FUZZ_TIMES", 1) as usize;
    let seed = number_from("PLIANT_FUZZ_SEED", 0x706c_6961_6e74);
    std::thread::scope(|scope| {
        for (name, target) in TARGETS {
            scope.spawn(move || {
                let inputs = inputs_of(name);
                assert!(!inputs.is_empty(), "{name} has no inputs to begin with");
                let mut draw = Draw(seed);
                for round in 0..times * rounds(name) {
                    let input = mutated(&inputs, &mut draw);
                    let outcome = catch_unwind(|| target(&input));
                    assert!(
                        outcome.is_ok(),
                        "{name}, round {round}: keep this input in tests/fuzz/found/{name}: {}",
                        input.escape_ascii().to_string().chars().take(4000).collect::<String>()
                    );
                }
                println!("{name}: {} executions", times * rounds(name));
            });
        }
    });
}

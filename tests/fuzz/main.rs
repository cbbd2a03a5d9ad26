//! Every parser and every message under arbitrary bytes: inputs that once were trouble, and a bounded number of mutated ones.
//! Long runs that coverage guides are in `coverage`; see its README.

mod corpora;
#[path = "../support/mod.rs"]
mod support;
mod targets;

use crate::corpora::inputs_of;
use crate::support::draw::Draw;
use crate::support::packed_models::{embedded_zeros, fbx_of_zeros, meshopt_of_zeros, placed_often};
use crate::support::peak_memory::{PeakAllocator, peak_of};
use crate::targets::TARGETS;
use crate::targets::files::{SmallLedger, read_within};
use pliant::asset::Limits;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

/// The stored inputs of a target.
pub fn found_inputs(name: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fuzz/found")
        .join(name);
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("a readable entry").path()).collect();
    files.sort();
    files
}

#[test]
fn what_once_was_trouble_is_none_any_more() {
    for (name, target) in TARGETS {
        for path in found_inputs(name) {
            let input = std::fs::read(&path).expect("a readable file");
            eprintln!("{}", path.display());
            target(&input);
        }
    }
}

#[test]
fn every_folder_of_found_inputs_belongs_to_a_target() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/found");
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let name = entry.expect("a readable entry").file_name();
        assert!(
            TARGETS.iter().any(|(target, _)| name == *target),
            "{} is not a target",
            name.display()
        );
    }
}

#[test]
fn every_target_is_a_target_of_the_coverage_guided_runs() {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/coverage/Cargo.toml");
    let manifest = std::fs::read_to_string(manifest).expect("its manifest");
    for (name, _) in TARGETS {
        let wanted = format!("name = \"{name}\"\npath = \"fuzz_target.rs\"");
        assert!(manifest.contains(&wanted), "{name} is not in its manifest");
    }
}

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

#[global_allocator]
static ALLOCATOR: PeakAllocator = PeakAllocator;

/// What is not counted: texts of errors, tables of names, and the files of companions.
const UNCOUNTED: u64 = 1 << 20;

fn unpacked_models() -> [(&'static str, Vec<u8>); 6] {
    let text = "v 0.5 1 2\nv 1 0 0\nv 0 1 0\nf -1 -2 -3\n".repeat(60_000);
    let corners = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{}", "f 1 2 3 1 2 3 1 2 3\n".repeat(60_000));
    [
        ("fbx", fbx_of_zeros(6_000_000)),
        ("meshopt", meshopt_of_zeros(600_000)),
        ("nodes", placed_often(100, 9_999)),
        ("data uri", embedded_zeros(30_000_000)),
        ("obj", text.into_bytes()),
        ("polygons", corners.into_bytes()),
    ]
}

#[test]
fn reading_holds_no_more_than_it_has_reserved() {
    for (name, file) in unpacked_models() {
        let ledger = SmallLedger::new(u64::MAX);
        let (_, peak) = peak_of(|| drop(read_within(&file, &Limits::default(), &ledger)));
        let allowed = ledger.allowed();
        println!("{name}: {peak} bytes of {allowed} that were reserved");
        assert!(peak > 8 << 20, "{name}: only {peak} bytes were taken");
        assert!(
            peak <= allowed + UNCOUNTED,
            "{name}: {peak} bytes were taken, {allowed} reserved"
        );
    }
}

#[test]
fn reading_is_refused_before_it_takes_what_a_ledger_does_not_have() {
    for (name, file) in unpacked_models() {
        let budget = file.len() as u64 + (4 << 20);
        let ledger = SmallLedger::new(budget);
        let (read, peak) = peak_of(|| read_within(&file, &Limits::default(), &ledger).map(drop));
        assert!(read.is_err() && ledger.asked() > budget, "{name}: {read:?}");
        assert!(
            peak <= budget + UNCOUNTED,
            "{name}: {peak} bytes were taken, {budget} allowed"
        );
    }
}

//! What reading a model takes of memory, against what it has reserved.

use crate::support::packed_models::{embedded_zeros, fbx_of_zeros, meshopt_of_zeros, placed_often};
use crate::support::peak_memory::{PeakAllocator, peak_of};
use crate::targets::decoders::{SmallLedger, read_within};
use pliant::asset::Limits;

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

//! Files that unpack to much are refused by what their headers say, before any of it is unpacked.

use crate::support::packed_models::{draco_of_faces, embedded_zeros, fbx_of_zeros, meshopt_of_zeros, placed_often};
use pliant::asset::{Error, FileSet, Limits, Model};
use pliant::progress::Progress;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Allows so many bytes, and counts how often it did not.
struct Ledger {
    budget: u64,
    refused: AtomicU64,
}

impl Progress for Ledger {
    fn may_hold(&self, bytes: u64) -> bool {
        let is_allowed = bytes <= self.budget;
        if !is_allowed {
            self.refused.fetch_max(bytes, Relaxed);
        }
        is_allowed
    }
}

#[test]
fn files_that_unpack_to_much_are_refused_by_their_headers() {
    const BUDGET: u64 = 24 << 20;
    let files = [
        ("fbx", fbx_of_zeros(10_000_000)),
        ("meshopt", meshopt_of_zeros(2_000_000)),
        ("draco", draco_of_faces(5_000_000)),
        ("nodes", placed_often(1000, 300)),
        ("data uri", embedded_zeros(20_000_000)),
    ];
    for (name, file) in files {
        let ledger = Ledger {
            budget: BUDGET,
            refused: AtomicU64::new(0),
        };
        let files = FileSet::single("model", file);
        let read = Model::read_watched(files, None, &Limits::default(), &ledger);
        let Err(Error::TooLarge { seen, .. }) = read else {
            panic!("{name}: {:?}", read.map(|model| model.positions.len()));
        };
        assert!(seen > BUDGET && ledger.refused.load(Relaxed) > BUDGET, "{name}: {seen}");
    }
}

#[test]
fn a_count_above_the_limits_is_refused_as_that() {
    let limits = Limits {
        vertices: 1000,
        ..Limits::default()
    };
    let ledger = Ledger {
        budget: 24 << 20,
        refused: AtomicU64::new(0),
    };
    let files = FileSet::single("model.glb", meshopt_of_zeros(2_000_000));
    let refused = Model::read_watched(files, None, &limits, &ledger).expect_err("too many vertices");
    assert_eq!(refused.to_string(), "vertices is 2000000, at most 1000 is allowed");
}

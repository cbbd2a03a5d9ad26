//! Files of models read within a small ledger of memory.

use super::models::{LIMITS, companions};
use pliant::asset::{Error, FileSet, Limits, Model};
use pliant::progress::Progress;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Allows so many bytes, and notes what was asked for.
#[derive(Debug, Default)]
pub struct SmallLedger {
    budget: u64,
    /// The most bytes that were asked for, and that were allowed.
    asked: AtomicU64,
    allowed: AtomicU64,
}

impl SmallLedger {
    pub fn new(budget: u64) -> Self {
        Self {
            budget,
            ..Self::default()
        }
    }

    pub fn asked(&self) -> u64 {
        self.asked.load(Relaxed)
    }

    pub fn allowed(&self) -> u64 {
        self.allowed.load(Relaxed)
    }
}

impl Progress for SmallLedger {
    fn may_hold(&self, bytes: u64) -> bool {
        self.asked.fetch_max(bytes, Relaxed);
        let is_allowed = bytes <= self.budget;
        if is_allowed {
            self.allowed.fetch_max(bytes, Relaxed);
        }
        is_allowed
    }
}

/// Reads a file of any format within a ledger.
pub fn read_within(bytes: &[u8], limits: &Limits, ledger: &SmallLedger) -> Result<Model, Error> {
    let files = FileSet {
        name: "model".into(),
        main: bytes.to_vec().into(),
        companions: companions(),
    };
    Model::read_watched(files, None, limits, ledger)
}

/// The first byte says how much may be held, the rest is a file: it is read as with enough memory, or refused for the want of it.
pub fn decoders(bytes: &[u8]) {
    let Some((&choice, file)) = bytes.split_first() else {
        return;
    };
    let small = SmallLedger::new(1 << (10 + choice % 16));
    let read = read_within(file, &LIMITS, &small);
    let enough = SmallLedger::new(u64::MAX);
    let wanted = read_within(file, &LIMITS, &enough);
    if small.asked() <= small.budget {
        assert_eq!(
            read.map(|m| m.geometry),
            wanted.map(|m| m.geometry),
            "both have what they ask for"
        );
        return;
    }
    assert!(small.allowed() <= small.budget);
    match read {
        // It asked for more ahead than it needed.
        Ok(model) => assert_eq!(Ok(model.geometry), wanted.map(|m| m.geometry)),
        Err(Error::TooLarge { .. }) => {}
        Err(refused) => assert_eq!(Err(refused), wanted.map(|m| m.geometry)),
    }
}

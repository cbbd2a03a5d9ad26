//! What goes wrong on the way.

use crate::random::Random;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::SeqCst;
use std::time::Duration;

/// Of a thousand questions so many get lost, and as many answers: another number in each run, so that each kind of fault also comes
/// alone.
const LOST: [u64; 4] = [0, 5, 15, 40];
/// Of a thousand questions so many take seconds.
const LATE: [u64; 4] = [0, 0, 5, 40];

/// Draws what happens to questions.
#[derive(Debug, Clone)]
pub struct Faults {
    random: Random,
    lost: u64,
    late: u64,
    /// Whether anything goes wrong at present.
    active: Arc<AtomicBool>,
    /// How often something did.
    injected: Arc<AtomicU64>,
}

/// What happens to one question.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fate {
    /// How long it waits.
    pub before: Duration,
    /// Whether it gets lost.
    pub loses_question: bool,
    /// How long its answer waits.
    pub after: Duration,
    /// Whether its answer gets lost.
    pub loses_answer: bool,
}

impl Faults {
    /// Faults that follow from random numbers.
    pub fn of(random: Random) -> Self {
        let one_of = |rates: [u64; 4]| rates[random.below(0..4) as usize];
        Self {
            lost: one_of(LOST),
            late: one_of(LATE),
            random,
            active: Arc::new(AtomicBool::new(true)),
            injected: Arc::default(),
        }
    }

    /// The same for another host.
    #[must_use]
    pub fn split(&self) -> Self {
        Self {
            random: self.random.split(),
            ..self.clone()
        }
    }

    /// Nothing goes wrong any more.
    pub fn end(&self) {
        self.active.store(false, SeqCst);
    }

    /// Whether anything goes wrong.
    pub fn are_active(&self) -> bool {
        self.active.load(SeqCst)
    }

    /// Counts one that was injected elsewhere.
    pub fn count(&self) {
        self.injected.fetch_add(1, SeqCst);
    }

    /// How many were injected.
    pub fn injected(&self) -> u64 {
        self.injected.load(SeqCst)
    }

    /// Whether something goes wrong that does so many times of a thousand.
    pub fn happens(&self, per_mille: u64) -> bool {
        let happens = self.are_active() && self.random.happens(per_mille);
        if happens {
            self.count();
        }
        happens
    }

    /// What happens to the next question.
    pub fn fate(&self) -> Fate {
        let quick = Fate {
            before: self.random.span(0..4),
            after: self.random.span(0..2),
            ..Fate::default()
        };
        if self.happens(self.late) {
            return Fate {
                before: self.random.span(500..12_000),
                ..quick
            };
        }
        Fate {
            loses_question: self.happens(self.lost),
            loses_answer: self.happens(self.lost),
            ..quick
        }
    }
}

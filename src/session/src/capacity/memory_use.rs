//! What memory is held for, in one list for the ledger and for those who watch it.

/// What bytes are held for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MemoryUse {
    /// Sessions, and work on them.
    Sessions,
    /// Uploads that have not become sessions yet.
    Uploads,
    /// Answers that their readers have not taken yet.
    Answers,
    /// Answers kept by idempotency key.
    KeptAnswers,
}

impl MemoryUse {
    /// All of them, in the order in which they are shown.
    pub const ALL: [Self; 4] = [Self::Sessions, Self::Uploads, Self::Answers, Self::KeptAnswers];

    /// The name by which operators know it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sessions => "sessions",
            Self::Uploads => "uploads",
            Self::Answers => "answers",
            Self::KeptAnswers => "kept_answers",
        }
    }
}

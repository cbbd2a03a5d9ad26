//! Why a clip cannot be read.

/// Why a clip cannot be read. Lines count from 1.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The text is not a clip of this format.
    #[error("line {line}: {problem}")]
    Malformed {
        /// Where.
        line: usize,
        /// What is wrong, and what is allowed.
        problem: String,
    },
    /// There is more of something than is allowed.
    #[error("the clip has {seen} {what}, at most {limit} are allowed")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many.
        seen: u64,
        /// The limit.
        limit: u64,
    },
    /// There is nothing.
    #[error("the clip is empty; a BVH file begins with HIERARCHY")]
    Empty,
}

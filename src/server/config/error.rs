//! Why a configuration cannot be used.

/// The configuration cannot be used: the file, or the value of a key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read configuration file {path}: {problem}")]
    File {
        /// As given.
        path: String,
        /// What the operating system said.
        problem: String,
    },
    /// An environment variable is called as keys are, and there is no such key.
    #[error("environment variable {name} is not a key of the configuration; {hint}")]
    Variable {
        /// Its name.
        name: String,
        /// What may have been meant.
        hint: String,
    },
    /// A key has a value that is not allowed, or does not exist.
    #[error("{key}: {problem} ({place})")]
    Value {
        /// The key.
        key: String,
        /// Where the value came from.
        place: String,
        /// What was seen and what is allowed.
        problem: String,
    },
}

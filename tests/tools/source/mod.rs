//! The source itself, held in shape by tests: names that stand once, short functions, no files that import in a circle.
//!
//! Needs nothing but the standard library, so that `.ci/counts` compiles it alone, in seconds.

mod counts;
mod functions;
mod guards;
mod imports;
mod modules;
mod plain_english;
pub mod tokens;
mod types;

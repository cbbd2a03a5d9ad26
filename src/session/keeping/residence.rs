//! How an idle session leaves memory: in steps.

/// How much of an idle session is in memory still.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(in crate::session) enum Residence {
    /// All of it.
    #[default]
    Whole,
    /// Without shapes that can be solved again and what is derived from the engine.
    Lean,
}

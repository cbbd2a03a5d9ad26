//! Spans of pieces of work, for those who follow a call through the server.

use tracing::Span;
use tracing::field::Empty;

/// The target of every span: off in logs unless asked for, and what is exported.
pub const SPANS: &str = "pliant_spans";

/// A piece of work as operators see it: its kind, and its span.
#[derive(Debug)]
pub(in crate::session) struct WorkSpan {
    /// What it is called and counted under.
    pub what: &'static str,
    /// From its asking for a slot to its result.
    pub span: Span,
}

impl WorkSpan {
    /// Of work that is called `what`, for a session, if it has an id yet; part of `call`, the span of whoever asked for it.
    pub fn new(what: &'static str, session: &str, call: &Span) -> Self {
        let span = tracing::info_span!(
            target: SPANS,
            parent: call,
            "work",
            otel.name = what,
            session.id = session,
            queue_ms = Empty,
            cycles = Empty,
            residual = Empty,
            vertices = Empty,
        );
        Self { what, span }
    }
}

/// Tells the span of the work under way what a solve came to.
pub(in crate::session) fn tell_solve(cycles: u32, residual: f64, vertices: usize) {
    let span = Span::current();
    // Collectors know no unsigned numbers.
    span.record("cycles", i64::from(cycles));
    span.record("residual", residual);
    tell_vertices(vertices);
}

/// Tells the span of the work under way how large the model is.
pub(in crate::session) fn tell_vertices(vertices: usize) {
    Span::current().record("vertices", i64::try_from(vertices).unwrap_or(i64::MAX));
}

//! Spans of pieces of work, to trace a call through the server.

use tracing::Span;
use tracing::field::Empty;

/// The target of every span: off in logs unless asked for, and what is exported.
pub const SPANS: &str = "pliant_spans";

macro_rules! work_kinds {
    ($($(#[$doc:meta])* $kind:ident $name:literal,)*) => {
        /// A kind of work on the compute pool: its name is that of its spans, and the label of its time in the metrics.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum WorkKind {
            $($(#[$doc])* $kind,)*
        }

        impl WorkKind {
            /// Every kind.
            pub const ALL: &[Self] = &[$(Self::$kind,)*];

            /// What its spans are called.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)*
                }
            }
        }
    };
}

work_kinds! {
    /// A model is opened.
    Build "build",
    /// A session comes back from its store.
    Replay "replay",
    /// Handles are set, changed or removed.
    Handles "handles",
    /// A pose is committed.
    Solve "solve",
    /// A pose of a stream is solved that is not committed.
    Drag "drag",
    /// A stream works ahead after a frame of a drag.
    Settle "settle",
    /// The topology is edited.
    Edit "edit",
    /// A commit is undone or redone.
    History "history",
    /// The answer of an earlier commit is computed again.
    Recall "recall",
    /// The model is written.
    Export "export",
    /// Points or another model are carried along with the shape.
    Carry "carry",
    /// An animation is prepared.
    Animate "animate",
    /// A frame of an animation is solved.
    Frame "frame",
    /// The frames of an animation become one file.
    Clip "clip",
}

/// A piece of work as operators see it: its kind, and its span.
#[derive(Debug)]
pub(in crate::session) struct WorkSpan {
    /// What it is called and counted under.
    pub kind: WorkKind,
    /// From its request for a slot to its result.
    pub span: Span,
}

impl WorkSpan {
    /// A span of work of a kind for a session, if it has an id yet; a child of `call`.
    pub fn new(kind: WorkKind, session: &str, call: &Span) -> Self {
        let span = tracing::info_span!(
            target: SPANS,
            parent: call,
            "work",
            otel.name = kind.name(),
            session.id = session,
            queue_ms = Empty,
            cycles = Empty,
            residual = Empty,
            vertices = Empty,
        );
        Self { kind, span }
    }
}

/// Records the result of a solve in the current span.
pub(in crate::session) fn tell_solve(cycles: u32, residual: f64, vertices: usize) {
    let span = Span::current();
    // Collectors know no unsigned numbers.
    span.record("cycles", i64::from(cycles));
    span.record("residual", residual);
    tell_vertices(vertices);
}

/// Records the size of the model in the current span.
pub(in crate::session) fn tell_vertices(vertices: usize) {
    Span::current().record("vertices", i64::try_from(vertices).unwrap_or(i64::MAX));
}

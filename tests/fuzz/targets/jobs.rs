//! Whole jobs on a small model: messages, what they mean, and the engine.

use glam::DVec3;
use pliant::asset::{FileSet, Limits, shapes};
use pliant::engine::DeformerLimits;
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::{batch, wire::pb};
use prost::Message;
use std::fmt::Write as _;

/// A box as text.
pub fn box_file() -> FileSet {
    box_of_cells([2, 4, 2])
}

/// A box as text, cut into so many cells along each side.
pub fn box_of_cells(cells: [usize; 3]) -> FileSet {
    let (points, faces) = shapes::box_with_cells(DVec3::new(1.0, 2.0, 1.0), cells);
    let mut text = String::new();
    for p in &points {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for [a, b, c] in &faces {
        let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
    }
    FileSet::single("box.obj", text)
}

/// Few enough that no job takes long.
pub const LIMITS: DeformerLimits = DeformerLimits {
    model: Limits {
        vertices: 4000,
        triangles: 8000,
        decoded_bytes: 32 << 20,
        document_bytes: 32 << 20,
    },
    memory_bytes: 256 << 20,
    graph_bytes: None,
    handles: 16,
};

pub fn jobs(bytes: &[u8]) {
    let Ok(mut job) = pb::Job::decode(bytes) else { return };
    // Longer jobs tell nothing more.
    job.steps.truncate(4);
    if let Some(options) = &mut job.options {
        options.tolerance = options.tolerance.max(1e-3);
        options.refine = options.refine.map(|refine| refine.min(2));
    }
    let pool = Pool::new(1).expect("one thread");
    let exec = Exec::new(&pool, &Silent);
    match batch::run(box_file(), &job, None, &LIMITS, &exec, &|| 0.0) {
        Ok(outcome) => assert!(!outcome.written.main.is_empty()),
        Err(refused) => assert!(!refused.to_string().is_empty()),
    }
}

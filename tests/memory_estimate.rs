//! What a session is reckoned to take, beside what it takes at its most: of opening, handles, a drag and a commit.

use peak_memory::{PeakAllocator, peak_of_all};
use pliant::asset::{FileSet, shapes};
use pliant::engine::{Deformer, DeformerLimits, SolveMode, SolveSettings};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::pb::create_options::volume_graph::Kind;
use pliant::wire::{self, pb};

#[path = "support/peak_memory.rs"]
mod peak_memory;

#[global_allocator]
static ALLOCATOR: PeakAllocator = PeakAllocator;

/// The handle of all that is further along an axis than this.
fn end(id: &str, normal: [f64; 3], offset: f64) -> pb::Handle {
    let half = pb::region::HalfSpace {
        normal: normal.to_vec(),
        offset,
    };
    pb::Handle {
        id: id.into(),
        region: Some(pb::Region {
            region: Some(pb::region::Region::HalfSpace(half)),
        }),
        ..Default::default()
    }
}

/// A ball as a file.
fn ball() -> FileSet {
    let (positions, triangles) = shapes::icosphere(1.0, 6);
    let mut text = String::new();
    for p in &positions {
        text += &format!("v {} {} {}\n", p.x, p.y, p.z);
    }
    for [a, b, c] in triangles.iter().map(|t| t.map(|v| v + 1)) {
        text += &format!("f {a} {b} {c}\n");
    }
    text.shrink_to_fit();
    FileSet::single("ball.obj", text.into_bytes())
}

/// Opens a ball with an inside of this kind, drags it and bends it; returns the estimate.
fn estimate_and_bend(kind: Kind) -> u64 {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let create = pb::CreateOptions {
        volume_graph: Some(pb::create_options::VolumeGraph {
            kind: kind.into(),
            ..Default::default()
        }),
        ..Default::default()
    };
    let options = wire::open_options(&create).expect("options");
    let mut deformer = Deformer::open(ball(), &options, &DeformerLimits::default(), &exec).expect("a ball");
    let estimate = deformer.estimate();
    let handles = pb::SetHandlesRequest {
        handles: vec![end("low", [0.0, -1.0, 0.0], 0.8), end("high", [0.0, 1.0, 0.0], 0.8)],
        ..Default::default()
    };
    let handles = wire::handle_set(&handles).expect("handles");
    deformer.set_handles(handles, &exec).expect("handles");
    let settings = SolveSettings::default();
    let mut poses = deformer.initial_poses();
    for (mode, turn) in [
        (SolveMode::Drag, 0.2),
        (SolveMode::Drag, 0.4),
        (SolveMode::Drag, 0.6),
        (SolveMode::Commit, 0.8),
    ] {
        let pose = pb::HandlePose {
            rotation_vector: vec![turn, 0.0, 0.0],
            ..Default::default()
        };
        let pose = pb::Pose {
            handles: vec![pb::pose::Entry {
                id: "high".into(),
                pose: Some(pose),
            }],
            ..Default::default()
        };
        poses = wire::change_poses(&deformer, &poses, &pose).expect("a pose");
        deformer
            .solve(&poses, &settings, mode, &exec, &mut |_| true)
            .expect("a shape");
    }
    estimate
}

// One test, so that nothing else in the process allocates meanwhile.
#[test]
fn a_session_is_reckoned_to_take_what_it_takes_at_its_most() {
    for kind in [Kind::Shape, Kind::Paper] {
        let (estimate, most) = peak_of_all(|| estimate_and_bend(kind));
        println!("{kind:?}: {estimate} bytes reckoned, {most} held at most");
        assert!(
            most <= estimate,
            "{kind:?}: {most} bytes are held, {estimate} were reckoned"
        );
        assert!(
            estimate <= most / 2 * 3,
            "{kind:?}: {most} bytes are held, {estimate} were reckoned"
        );
    }
}

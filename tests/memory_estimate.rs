//! What a session is reckoned to take, beside what it takes at its most: of opening, handles, a drag and a commit.

#![allow(unsafe_code)]

use pliant::asset::{FileSet, shapes};
use pliant::engine::{Deformer, DeformerLimits, SolveMode, SolveSettings};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::pb::create_options::volume_graph::Kind;
use pliant::wire::{self, pb};
use std::alloc::{GlobalAlloc, Layout, System};
use std::fmt::Write as _;
use std::sync::atomic::{AtomicI64, Ordering::Relaxed};

/// Hands everything to the system's allocator, and knows what is held and what was held at most, by all threads.
struct HeldBytes;

static HELD: AtomicI64 = AtomicI64::new(0);
static MOST: AtomicI64 = AtomicI64::new(0);

fn count(bytes: i64) {
    let held = HELD.fetch_add(bytes, Relaxed) + bytes;
    MOST.fetch_max(held, Relaxed);
}

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for HeldBytes {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as i64);
        // SAFETY: by the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as i64);
        // SAFETY: by the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Where the block moves, both are held for a moment.
        count(size as i64);
        // SAFETY: by the caller's promise.
        let moved = unsafe { System.realloc(pointer, layout, size) };
        count(-(layout.size() as i64));
        moved
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as i64));
        // SAFETY: by the caller's promise.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: HeldBytes = HeldBytes;

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

/// The estimate of a ball with an inside of this kind, and the bytes that are held at most while it is opened, dragged and bent.
fn estimate_and_most(kind: Kind) -> (u64, u64) {
    let (positions, triangles) = shapes::icosphere(1.0, 6);
    let mut text = String::new();
    for p in &positions {
        writeln!(text, "v {} {} {}", p.x, p.y, p.z).expect("fits");
    }
    for [a, b, c] in triangles.iter().map(|t| t.map(|v| v + 1)) {
        writeln!(text, "f {a} {b} {c}").expect("fits");
    }
    drop((positions, triangles));
    let before = HELD.load(Relaxed);
    MOST.store(before, Relaxed);
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
    let files = FileSet::single("ball.obj", text.into_bytes());
    let mut deformer = Deformer::open(files, &options, &DeformerLimits::default(), &exec).expect("a ball");
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
    let most = MOST.load(Relaxed) - before;
    (estimate, u64::try_from(most).expect("more is held than before"))
}

// One test, so that nothing else in the process allocates meanwhile.
#[test]
fn a_session_is_reckoned_to_take_what_it_takes_at_its_most() {
    for kind in [Kind::Shape, Kind::Paper] {
        let (estimate, most) = estimate_and_most(kind);
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

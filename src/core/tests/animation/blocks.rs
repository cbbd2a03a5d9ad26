//! Frames are the same whatever range is asked for, however many blocks and threads there are.

use crate::arm::{animate, arm_rig, clip_text, frames, open_arm};
use pliant_core::engine::{AnimationRefinement, BLOCK_FRAMES, digest};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::{Progress, Silent};
use std::sync::atomic::{AtomicUsize, Ordering};

fn wave(count: usize) -> Vec<[f64; 2]> {
    (0..count)
        .map(|k| [40.0 * (k as f64 * 0.1).sin(), 60.0 * (k as f64 * 0.07).cos()])
        .collect()
}

#[test]
fn bits_depend_neither_on_threads_nor_on_the_range() {
    let (one, three) = (Pool::new(1).expect("a thread"), Pool::new(3).expect("threads"));
    let text = clip_text(0.0, &wave(BLOCK_FRAMES + 20));
    let told = |pool: &Pool, range: std::ops::Range<usize>, at_once: usize| -> Vec<(usize, String)> {
        let exec = Exec::new(pool, &Silent);
        let deformer = open_arm(&exec);
        let animation = animate(&deformer, &text, arm_rig(3), AnimationRefinement::Carried, &exec);
        let frames = frames(&animation, range, at_once, &exec);
        frames.iter().map(|f| (f.index, digest(&f.positions))).collect()
    };
    let whole = told(&one, 0..usize::MAX, 1);
    assert_eq!(whole.len(), BLOCK_FRAMES + 20);
    assert_eq!(whole, told(&three, 0..usize::MAX, 4));
    let from = BLOCK_FRAMES + 3;
    assert_eq!(whole[from..from + 4], told(&three, from..from + 4, 2)[..]);
    assert_eq!(whole[60..70], told(&one, 60..70, 2)[..]);
}

/// Gives up after so many questions.
struct Impatient(AtomicUsize);

impl Progress for Impatient {
    fn report(&self, _: &'static str, _: f32) {}

    fn cancelled(&self) -> bool {
        self.0.fetch_sub(1, Ordering::Relaxed) <= 1
    }
}

#[test]
fn an_animation_ends_when_nobody_wants_it() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = open_arm(&exec);
    let animation = animate(
        &deformer,
        &clip_text(0.0, &wave(30)),
        arm_rig(1),
        AnimationRefinement::Steps(0),
        &exec,
    );
    let mut taken = 0;
    let enough = animation.solve(0..30, 1, &exec, &mut |_| {
        taken += 1;
        taken < 5
    });
    assert!(enough.is_ok() && taken == 5);
    let impatient = Impatient(AtomicUsize::new(40));
    let mut seen = 0;
    let cancelled = animation.solve(0..30, 1, &Exec::new(&pool, &impatient), &mut |_| {
        seen += 1;
        true
    });
    assert!(cancelled.is_err() && seen < 30, "{seen} frames");
}

//! Frames are the same whatever range is asked for, however many blocks and threads there are.

use super::arm::{animate, arm_rig, clip_text, frames, open_arm};
use pliant_core::engine::{BLOCK_FRAMES, digest};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::{Progress, Silent};
use std::sync::Mutex;
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
    let reported = |pool: &Pool, range: std::ops::Range<usize>, at_once: usize| -> Vec<(usize, String)> {
        let exec = Exec::new(pool, &Silent);
        let deformer = open_arm(&exec);
        let animation = animate(&deformer, &text, arm_rig(3), None, &exec);
        let frames = frames(&animation, range, at_once, &exec);
        frames.iter().map(|f| (f.index, digest(&f.positions))).collect()
    };
    let whole = reported(&one, 0..usize::MAX, 1);
    assert_eq!(whole.len(), BLOCK_FRAMES + 20);
    assert_eq!(whole, reported(&three, 0..usize::MAX, 4));
    let from = BLOCK_FRAMES + 3;
    assert_eq!(whole[from..from + 4], reported(&three, from..from + 4, 2)[..]);
    assert_eq!(whole[60..70], reported(&one, 60..70, 2)[..]);
}

#[test]
fn one_frame_at_a_time_gives_the_same_frames_as_blocks() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = open_arm(&exec);
    let text = clip_text(0.0, &wave(2 * BLOCK_FRAMES + 3));
    for refinement in [None, Some(1)] {
        let animation = animate(&deformer, &text, arm_rig(1), refinement, &exec);
        for range in [0..usize::MAX, 40..2 * BLOCK_FRAMES, 70..71] {
            let mut one_by_one = Vec::new();
            let mut cursor = animation.cursor(range.clone());
            let mut led = 0.0;
            while cursor.next_index().is_some() {
                if let Some(progress) = cursor.lead_progress() {
                    assert!((0.0..1.0).contains(&progress), "{progress}");
                    led = progress.max(led);
                }
                let frame = animation.solve_next(&mut cursor, &exec).expect("a frame");
                one_by_one.extend(frame.map(|f| (f.index, digest(&f.positions))));
            }
            let blocks: Vec<(usize, String)> = (frames(&animation, range.clone(), 2, &exec).iter())
                .map(|f| (f.index, digest(&f.positions)))
                .collect();
            assert_eq!(one_by_one, blocks, "{range:?}");
            assert_eq!(blocks.first().map(|f| f.0), Some(range.start));
            assert!(range.start == 0 || led > 0.5, "frames led to {range:?}: {led}");
        }
    }
}

#[test]
fn no_frame_shows_where_a_block_begins() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = open_arm(&exec);
    let poses = wave(BLOCK_FRAMES + 1);
    let of = |poses: &[[f64; 2]], frame: usize| {
        let text = clip_text(0.0, poses);
        let animation = animate(&deformer, &text, arm_rig(1), None, &exec);
        frames(&animation, frame..frame + 1, 1, &exec).remove(0).positions
    };
    let begun = of(&poses, BLOCK_FRAMES);
    // The same pose as the last of a block, which came to it through 63 others.
    let carried = of(&poses[1..], BLOCK_FRAMES - 1);
    let off = begun
        .iter()
        .zip(&carried)
        .map(|(a, b)| a.distance(*b))
        .fold(0.0, f64::max);
    assert!(off < 2e-4 * deformer.diagonal(), "{}", off / deformer.diagonal());
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
fn an_animation_ends_when_cancelled() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = open_arm(&exec);
    let animation = animate(&deformer, &clip_text(0.0, &wave(30)), arm_rig(1), Some(0), &exec);
    let all = 0..30;
    let mut taken = 0;
    let enough = animation.solve(std::slice::from_ref(&all), 1, &|| 0.0, &exec, &mut |_, _| {
        taken += 1;
        taken < 5
    });
    assert!(enough.is_ok() && taken == 5);
    let impatient = Impatient(AtomicUsize::new(40));
    let mut seen = 0;
    let cancelled = animation.solve(
        std::slice::from_ref(&all),
        1,
        &|| 0.0,
        &Exec::new(&pool, &impatient),
        &mut |_, _| {
            seen += 1;
            true
        },
    );
    assert!(cancelled.is_err() && seen < 30, "{seen} frames");
}

/// Remembers how far the work was said to be, and gives it up after so many looks at its clock.
struct Follower {
    until: usize,
    looks: AtomicUsize,
    reported: Mutex<Vec<f32>>,
}

impl Progress for Follower {
    fn report(&self, stage: &'static str, fraction: f32) {
        assert_eq!(stage, "frames");
        self.reported.lock().expect("no panic").push(fraction);
    }

    fn cancelled(&self) -> bool {
        self.looks.load(Ordering::Relaxed) >= self.until
    }
}

#[test]
fn frames_of_blocks_come_as_they_are_solved_and_none_is_lost_when_the_work_is_given_up() {
    let pool = Pool::new(2).expect("threads");
    let quiet = Exec::new(&pool, &Silent);
    let deformer = open_arm(&quiet);
    let text = clip_text(0.0, &wave(2 * BLOCK_FRAMES));
    let animation = animate(&deformer, &text, arm_rig(1), None, &quiet);
    let solve = |ranges: &[std::ops::Range<usize>], until: usize| {
        let follower = Follower {
            until,
            looks: AtomicUsize::default(),
            reported: Mutex::default(),
        };
        let millis = || follower.looks.fetch_add(1, Ordering::Relaxed) as f64;
        let mut taken = Vec::new();
        let solved = animation.solve(ranges, 2, &millis, &Exec::new(&pool, &follower), &mut |frame, ms| {
            assert!(ms > 0.0);
            taken.push((frame.index, digest(&frame.positions)));
            true
        });
        (solved.is_ok(), taken, follower.reported.into_inner().expect("no panic"))
    };
    let all = 0..2 * BLOCK_FRAMES;
    let (done, mut whole, reported) = solve(std::slice::from_ref(&all), usize::MAX);
    assert!(
        done && reported.is_sorted() && reported.last() == Some(&1.0),
        "{reported:?}"
    );
    // Counted are frames too that only lead to the second block.
    let steps = reported.len();
    assert!(steps > 2 * BLOCK_FRAMES, "{steps}");
    whole.sort();
    let indices: Vec<usize> = whole.iter().map(|(index, _)| *index).collect();
    assert_eq!(indices, (0..2 * BLOCK_FRAMES).collect::<Vec<_>>());
    // Given up once more is done than either block has, where the clock is looked at twice a frame and two are under way.
    let until = 2 * (steps - BLOCK_FRAMES + 2) + 2;
    let (done, mut kept, reported) = solve(std::slice::from_ref(&all), until);
    assert!(!done && kept.len() < 2 * BLOCK_FRAMES && reported.len() < steps);
    let count =
        |frames: &[(usize, String)], block: usize| frames.iter().filter(|f| f.0 / BLOCK_FRAMES == block).count();
    let [first, second] = [0, 1].map(|block| count(&kept, block));
    assert!(first > 0 && second > 0, "{first} and {second}");
    // What is missing makes up the rest.
    let missing = [first..BLOCK_FRAMES, BLOCK_FRAMES + second..2 * BLOCK_FRAMES];
    kept.extend(solve(&missing, usize::MAX).1);
    kept.sort();
    assert_eq!(kept, whole);
}

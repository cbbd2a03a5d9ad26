//! Frames a second, and seconds a frame at the size of the paper's figure 7.

use super::ballet::{BALLET, RATE};
use super::figure::MotionFigure;
use super::stage::{MotionFolders, failed, solve};
use crate::failure::LoadtestFailure;
use crate::shared::timing::time_once;
use pliant::engine::AnimationRefinement;
use pliant::pool::Pool;

/// Frames that are timed at the paper's size, after one that is not: a first frame has no other to go on from.
const LARGE_FRAMES: usize = 8;

fn pool_of(threads: usize) -> Result<Pool, LoadtestFailure> {
    Pool::new(threads).map_err(failed)
}

/// Row 5: the dance on two threads.
pub(super) fn measure_rates(folders: &MotionFolders<'_>, most: usize) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let pool = pool_of(2)?;
    let stage = folders.stage(BALLET, 0, &pool)?;
    let times = stage.times(RATE, most);
    let mut figures = Vec::new();
    for (refinement, what, bounds) in [
        (
            AnimationRefinement::Carried,
            "two threads, carried: frames a second",
            [Some(8.0), Some(15.0)],
        ),
        (
            AnimationRefinement::Steps(0),
            "two threads, refine 0: frames a second",
            [Some(15.0), Some(25.0)],
        ),
    ] {
        let animation = stage.animation(times, refinement, &pool)?;
        let (solved, seconds) = time_once(|| solve(&animation, 0..times.count, &pool, &mut |_| {}));
        solved?;
        figures.push(MotionFigure::above(5, what, (times.count as f64 / seconds, ""), bounds));
    }
    Ok(figures)
}

/// Row 6: the armadillo with four times its triangles, on one thread.
pub(super) fn measure_large(folders: &MotionFolders<'_>) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let pool = pool_of(1)?;
    let stage = folders.stage(BALLET, 1, &pool)?;
    let times = stage.times(RATE, LARGE_FRAMES + 1);
    let (animation, prepared) = time_once(|| stage.animation(times, AnimationRefinement::Steps(0), &pool));
    let animation = animation?;
    let clock = std::time::Instant::now();
    let mut ends = Vec::new();
    solve(&animation, 0..times.count, &pool, &mut |_| {
        ends.push(clock.elapsed().as_secs_f64())
    })?;
    let seconds = match ends[..] {
        [first, .., last] => (last - first) / (ends.len() - 1) as f64,
        _ => clock.elapsed().as_secs_f64(),
    };
    let nodes = stage.deformer.body().nodes();
    Ok(vec![
        MotionFigure::below(
            6,
            format!("{nodes} nodes, 1 thread, refine 0: seconds a frame"),
            (seconds, " s"),
            [Some(0.6), Some(0.3)],
        ),
        MotionFigure::told(6, "handles and fields, once", (prepared, " s")),
    ])
}

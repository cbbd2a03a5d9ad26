//! Which frames become shapes, where there are more frames than shapes: those between are blended along straight lines.

use crate::engine::animation::frames::FrameSource;
use glam::Vec3;

/// How many vertices are looked at while frames are chosen; all of them are in the end.
const LOOKED_AT: usize = 2048;
/// How often all chosen frames are moved at most.
const ROUNDS: usize = 8;

/// Chosen frames.
pub(super) struct KeyFrames {
    /// Their numbers, rising, the first and the last frame among them.
    pub(super) chosen: Vec<usize>,
    /// Their shapes.
    pub(super) shapes: Vec<Vec<Vec3>>,
    /// How far a vertex is off at most in a frame that is blended, in model units.
    pub(super) error: f64,
    /// The root of the mean square over vertices and all frames.
    pub(super) rms: f64,
}

/// Chooses up to `most` frames, at least two: again and again the frame that is farthest from what those chosen so far blend to.
/// Then each is moved between its neighbours to where the worst of both sides is least, until none moves. `own`: the vertices
/// that matter.
pub(super) fn choose_key_frames<F: FrameSource>(
    frames: &mut F,
    own: &[usize],
    most: usize,
) -> Result<KeyFrames, F::Failure> {
    let count = frames.count();
    let mut chosen: Vec<usize> = (0..count).collect();
    if count > most {
        let mut looks = Vec::with_capacity(count);
        for frame in 0..count {
            let all = frames.positions(frame)?;
            let step = own.len().div_ceil(LOOKED_AT).max(1);
            looks.push(own.iter().step_by(step).map(|v| all[*v]).collect::<Vec<Vec3>>());
        }
        chosen = choose(&looks, most);
    }
    let mut shapes = Vec::with_capacity(chosen.len());
    for frame in &chosen {
        shapes.push(frames.positions(*frame)?);
    }
    let (mut error, mut squares): (f32, f64) = (0.0, 0.0);
    for (ends, pair) in chosen.windows(2).zip(shapes.windows(2)) {
        for frame in ends[0] + 1..ends[1] {
            let here = frames.positions(frame)?;
            let share = share(frame, ends);
            let off = |v: &usize| here[*v].distance_squared(pair[0][*v].lerp(pair[1][*v], share));
            for off in own.iter().map(off) {
                error = error.max(off);
                squares += f64::from(off);
            }
        }
    }
    Ok(KeyFrames {
        chosen,
        shapes,
        error: error.sqrt().into(),
        rms: (squares / (count * own.len()).max(1) as f64).sqrt(),
    })
}

/// The run between two chosen frames: its ends, and the frame that is farthest from the blend of theirs.
struct BlendedRun {
    ends: [usize; 2],
    worst: usize,
    error: f32,
}

impl BlendedRun {
    fn between(frames: &[Vec<Vec3>], ends: [usize; 2]) -> Self {
        let mut run = Self {
            ends,
            worst: ends[0],
            error: 0.0,
        };
        for frame in ends[0] + 1..ends[1] {
            let error = distance(
                &frames[frame],
                [&frames[ends[0]], &frames[ends[1]]],
                share(frame, &ends),
            );
            if error > run.error {
                (run.worst, run.error) = (frame, error);
            }
        }
        run
    }
}

fn choose(frames: &[Vec<Vec3>], most: usize) -> Vec<usize> {
    let mut chosen = vec![0, frames.len() - 1];
    let mut runs = vec![BlendedRun::between(frames, [0, frames.len() - 1])];
    while chosen.len() < most {
        let farthest = (0..runs.len()).max_by(|a, b| runs[*a].error.total_cmp(&runs[*b].error));
        let Some(worst) = farthest.filter(|k| runs[*k].error > 0.0) else {
            break;
        };
        let BlendedRun { ends, worst: frame, .. } = runs.swap_remove(worst);
        chosen.push(frame);
        runs.push(BlendedRun::between(frames, [ends[0], frame]));
        runs.push(BlendedRun::between(frames, [frame, ends[1]]));
    }
    chosen.sort_unstable();
    settle(frames, &mut chosen);
    chosen
}

/// Moves chosen frames between their neighbours to where the blends on both sides are best.
fn settle(frames: &[Vec<Vec3>], chosen: &mut [usize]) {
    for _ in 0..ROUNDS {
        let mut has_moved = false;
        for k in 1..chosen.len() - 1 {
            let (before, after) = (chosen[k - 1], chosen[k + 1]);
            let error = |frame: usize| {
                let sides = [[before, frame], [frame, after]].map(|ends| BlendedRun::between(frames, ends).error);
                sides[0].max(sides[1])
            };
            let (mut best, mut least) = (chosen[k], error(chosen[k]));
            for frame in before + 1..after {
                let error = error(frame);
                if error < least {
                    (best, least) = (frame, error);
                }
            }
            has_moved |= best != chosen[k];
            chosen[k] = best;
        }
        if !has_moved {
            break;
        }
    }
}

/// How much of the second end a frame has.
fn share(frame: usize, ends: &[usize]) -> f32 {
    (frame - ends[0]) as f32 / (ends[1] - ends[0]) as f32
}

/// The farthest that a vertex is from the blend of two shapes.
fn distance(here: &[Vec3], ends: [&[Vec3]; 2], share: f32) -> f32 {
    let off = here.iter().zip(ends[0].iter().zip(ends[1]));
    let off = off.map(|(p, (a, b))| p.distance_squared(a.lerp(*b, share)));
    off.fold(0.0, f32::max).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frames_where_a_path_turns_are_chosen() {
        // Blends at halves and quarters are exact.
        let heights = [0.0, 1.0, 2.0, 3.0, 4.0, 2.0, 0.0, 0.0, 0.0];
        let frames: Vec<Vec<Vec3>> = heights
            .iter()
            .map(|h| vec![Vec3::new(0.0, *h, 0.0), Vec3::ZERO])
            .collect();
        assert_eq!(choose(&frames, 4), [0, 4, 6, 8]);
        assert_eq!(choose(&frames, 9), [0, 4, 6, 8], "more change nothing");
        let mut moved = [0, 4, 8];
        settle(&frames, &mut moved);
        assert_eq!(moved, [0, 3, 8], "off by 1.6 there, and by 2 at the turn");
        let coarse = BlendedRun::between(&frames, [0, 6]);
        assert_eq!((coarse.worst, coarse.error), (4, 4.0));
    }
}

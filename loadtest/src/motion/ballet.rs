//! A dancing armadillo: volume, flips, stretch, edges, steadiness over time, seams between blocks, and what is made of its frames.

use super::stage::{MotionFigure, MotionFolders, MotionStage, bind, figure, skinned, solve};
use crate::failure::LoadtestFailure;
use glam::{DQuat, DVec3};
use pliant::engine::{BLOCK_FRAMES, FrameTimes, QualityReport};
use pliant::exec::Exec;
use pliant::motion::decomposition::{DecompositionOptions, ShapeSequence, decompose};
use pliant::motion::{JointCurves, JointPose, SkeletonJoint};
use pliant::pool::Pool;
use pliant::progress::Silent;

/// Its model, rig and clip.
pub(super) const BALLET: [&str; 3] = ["armadillo.obj", "rig_armadillo_cmu.json", "cmu_05_02.bvh"];
/// Files of it.
pub(super) const BALLET_DATA: [&str; 2] = ["meshes/armadillo.obj", "bvh/cmu_05_02.bvh"];
/// Frames a second.
pub(super) const RATE: f64 = 30.0;
/// Frames that a decomposition gets.
const DECOMPOSED: usize = 57;
/// Edges and flips of Blender's bone heat over six frames of dance.
const BONE_HEAT_EDGES: f64 = 0.135;

const CARRIED: Option<u32> = None;

/// Rows 1, 2, 3 and 12.
pub(super) fn measure_dance(
    folders: &MotionFolders<'_>,
    rows: &[u8],
    most: usize,
    pool: &Pool,
) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let stage = folders.stage(BALLET, 0, pool)?;
    let times = stage.times(RATE, most);
    let animation = stage.animation(times, CARRIED, pool)?;
    let step = times.count.div_ceil(DECOMPOSED).max(1);
    let mut sequence = ShapeSequence::new(stage.deformer.rest())?;
    let mut reported: Vec<QualityReport> = Vec::new();
    let mut refused = None;
    solve(&animation, 0..times.count, pool, &mut |frame| {
        reported.push(stage.deformer.quality(&frame.positions, pool));
        if rows.contains(&12) && frame.index % step == 0 {
            refused = refused.take().or(sequence.push(&frame.positions).err());
        }
    })?;
    if let Some(e) = refused {
        return Err(e.into());
    }
    let count = reported.len() as f64;
    let mean = |of: &dyn Fn(&QualityReport) -> f64| reported.iter().map(of).sum::<f64>() / count;
    let worst = |of: &dyn Fn(&QualityReport) -> f64| {
        reported
            .iter()
            .map(of)
            .fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a })
    };
    let mut figures = Vec::new();
    if rows.contains(&1) {
        let volume = |q: &QualityReport| 100.0 * q.volume_change;
        figures.push(
            figure(
                1,
                format!("dance, {} frames: volume, mean", reported.len()),
                mean(&volume),
                " %",
            )
            .at_most(2.5, 1.5),
        );
        figures.push(figure(1, "volume, worst", worst(&volume), " %").at_most(5.0, 3.0));
    }
    if rows.contains(&2) {
        let flips = |q: &QualityReport| f64::from(q.flipped_triangles);
        figures.push(figure(2, "dance: flipped triangles a frame, mean", mean(&flips), "").at_most(5.0, 1.0));
        figures.push(figure(2, "stretch, worst", worst(&|q| q.max_stretch), "").at_most(3.5, 2.5));
    }
    if rows.contains(&3) {
        figures.push(figure(3, "dance: edges, root mean square", mean(&|q| q.edge_rms), "").at_most(0.095, 0.085));
        figures.push(
            figure(
                3,
                "second difference over that of blend skinning",
                second_difference(&stage, pool)?,
                "",
            )
            .at_most(1.05, 1.01),
        );
    }
    if rows.contains(&12) {
        let exec = Exec::new(pool, &Silent);
        let skin = decompose(&sequence, &DecompositionOptions::default(), &exec)?;
        let percent = 100.0 / stage.deformer.diagonal();
        let what = format!(
            "40 bones for {} frames of dance: rms of the diagonal",
            sequence.frames()
        );
        figures.push(figure(12, what, percent * skin.rms, " %").at_most(0.15, 0.10));
        figures.push(figure(12, "worst", percent * skin.max, " %"));
    }
    Ok(figures)
}

/// How unsteady recorded frames are, over how unsteady blend skinning is: root mean squares of second differences, over 40 frames
/// from the beginnings of eight blocks spread over the clip.
fn second_difference(stage: &MotionStage, pool: &Pool) -> Result<f64, LoadtestFailure> {
    const STRETCHES: usize = 8;
    const LENGTH: usize = 42;
    let rate = stage.clip.recorded.map_or(120.0, |r| 1.0 / r.interval);
    let times = stage.times(rate, usize::MAX);
    let animation = stage.animation(times, CARRIED, pool)?;
    let influences = bind(stage, pool)?;
    let rest = stage.deformer.rest();
    let blocks = times.count.saturating_sub(LENGTH) / BLOCK_FRAMES + 1;
    let (mut solved, mut blended) = (Unsteadiness::default(), Unsteadiness::default());
    for k in 0..STRETCHES.min(blocks) {
        let first = k * blocks / STRETCHES.min(blocks) * BLOCK_FRAMES;
        solved.last.clear();
        blended.last.clear();
        solve(
            &animation,
            first..(first + LENGTH).min(times.count),
            pool,
            &mut |frame| {
                let pose = animation.driver().pose_at(frame.seconds);
                blended.take(skinned(rest, &influences, &pose.bones));
                solved.take(frame.positions);
            },
        )?;
    }
    Ok((solved.squares / blended.squares).sqrt())
}

/// The sum of squared second differences of shapes that follow each other.
#[derive(Default)]
struct Unsteadiness {
    last: Vec<Vec<DVec3>>,
    squares: f64,
}

impl Unsteadiness {
    fn take(&mut self, shape: Vec<DVec3>) {
        if let [before, middle] = &self.last[..] {
            let vertices = before.iter().zip(middle).zip(&shape);
            self.squares += vertices
                .map(|((a, b), c)| (*a - *b * 2.0 + *c).length_squared())
                .sum::<f64>();
            self.last.remove(0);
        }
        self.last.push(shape);
    }
}

/// Row 4: the first frames of blocks, against the same frames at the ends of blocks that begin one frame later.
pub(super) fn measure_seams(
    folders: &MotionFolders<'_>,
    most: usize,
    pool: &Pool,
) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let stage = folders.stage(BALLET, 0, pool)?;
    let times = stage.times(RATE, most);
    let borders: Vec<usize> = (1..)
        .map(|k| k * BLOCK_FRAMES)
        .take_while(|b| *b < times.count)
        .collect();
    if borders.is_empty() {
        return Ok(Vec::new());
    }
    let begun = stage.animation(times, CARRIED, pool)?;
    // The root is where it is in the model when the clip starts, which shapes do not depend on.
    let shifted = FrameTimes {
        start: times.at(1),
        count: times.count - 1,
        ..times
    };
    let carried = stage.animation(shifted, CARRIED, pool)?;
    let mut uninterrupted = Vec::new();
    solve(&carried, 0..borders[borders.len() - 1], pool, &mut |frame| {
        if (frame.index + 1) % BLOCK_FRAMES == 0 {
            uninterrupted.push(frame.positions);
        }
    })?;
    let (mut squares, mut farthest, mut count) = (0.0, 0.0f64, 0usize);
    for (border, there) in borders.iter().zip(&uninterrupted) {
        let mut here = Vec::new();
        solve(&begun, *border..border + 1, pool, &mut |frame| here = frame.positions)?;
        for (a, b) in here.iter().zip(there) {
            let off = a.distance_squared(*b);
            (squares, farthest, count) = (squares + off, farthest.max(off), count + 1);
        }
    }
    let percent = 100.0 / stage.deformer.diagonal();
    let rms = percent * (squares / count.max(1) as f64).sqrt();
    Ok(vec![
        figure(
            4,
            format!("{} borders of blocks: rms of the diagonal", borders.len()),
            rms,
            " %",
        )
        .at_most(0.1, 0.03),
        figure(4, "largest", percent * farthest.sqrt(), " %").at_most(1.0, 0.3),
    ])
}

/// Row 14: skin weights, blended over six frames.
pub(super) fn measure_weights(folders: &MotionFolders<'_>, pool: &Pool) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let stage = folders.stage(BALLET, 0, pool)?;
    let times = stage.times(RATE, usize::MAX);
    let animation = stage.animation(times, CARRIED, pool)?;
    let influences = bind(&stage, pool)?;
    let (mut edges, mut flips) = (0.0, 0.0);
    for k in 0..6 {
        let pose = animation.driver().pose_at(times.at(k * (times.count - 1) / 5));
        let shape = skinned(stage.deformer.rest(), &influences, &pose.bones);
        let quality = stage.deformer.quality(&shape, pool);
        edges += quality.edge_rms / 6.0;
        flips += f64::from(quality.flipped_triangles);
    }
    Ok(vec![
        figure(
            14,
            "weights, six frames of dance: edges over bone heat's .135",
            edges / BONE_HEAT_EDGES,
            "",
        )
        .at_most(1.0, 0.85),
        figure(14, "flipped triangles of all six", flips, "").at_most(60.0, 38.0),
    ])
}

/// Row 16: a clip that is turned around the vertical.
pub(super) fn measure_heading(
    folders: &MotionFolders<'_>,
    most: usize,
    pool: &Pool,
) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let mut stage = folders.stage(BALLET, 0, pool)?;
    let times = stage.times(RATE, most.min(16));
    let mut shapes = [Vec::new(), Vec::new()];
    for shapes in &mut shapes {
        let animation = stage.animation(times, CARRIED, pool)?;
        solve(&animation, 0..times.count, pool, &mut |frame| {
            shapes.push(frame.positions)
        })?;
        turn_around(&mut stage);
    }
    let pairs = shapes[0].iter().zip(&shapes[1]).flat_map(|(a, b)| a.iter().zip(b));
    let off = pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max) / stage.deformer.diagonal();
    Ok(vec![
        figure(16, "a clip turned by 180 degrees: off by, of the diagonal", off, "").at_most(1e-5, None),
    ])
}

/// Hangs a clip on a joint that is turned half around the vertical.
fn turn_around(stage: &mut MotionStage) {
    let joints = &mut stage.clip.skeleton.joints;
    for joint in joints.iter_mut() {
        joint.parent = Some(joint.parent.map_or(0, |p| p + 1));
    }
    let turned = SkeletonJoint {
        name: "turned".into(),
        parent: None,
        rest: JointPose {
            rotation: DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0),
            ..JointPose::at(DVec3::ZERO)
        },
    };
    joints.insert(0, turned);
    stage.clip.curves.insert(0, JointCurves::default());
}

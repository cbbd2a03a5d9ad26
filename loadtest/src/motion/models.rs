//! Other models: a skinned one with its own clip, a man of many parts, a horse that boxes, and weights for soups.

use super::figure::MotionFigure;
use super::stage::{MotionFolders, failed, open, solve};
use crate::failure::LoadtestFailure;
use crate::shared::input_files::read_model_file;
use crate::shared::timing::time_once;
use glam::DVec3;
use pliant::asset::{Limits, Model};
use pliant::engine::{
    Animation, AnimationLimits, AnimationRefinement, AnimationSettings, ClipRequest, ClipSource, Deformer, FrameChoice,
    QualityReport, bind_model,
};
use pliant::exec::Exec;
use pliant::motion::bvh::ClipLimits;
use pliant::motion::rig::{MotionRig, RigidMotion, rig_of_skin};
use pliant::motion::{MotionClip, NodeOrder, clip_of_scene};
use pliant::pool::Pool;
use pliant::progress::Silent;

/// Frames a second.
const RATE: f64 = 30.0;
/// A joint is followed where its vertices are so near to where blend skinning has them, in shares of the diagonal.
const FOLLOWED: f64 = 0.02;

/// Rows 10 and 11: a model, a rig and a recording.
pub(super) fn measure_recorded(
    row: u8,
    folders: &MotionFolders<'_>,
    most: usize,
    pool: &Pool,
) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let stage = folders.stage(
        match row {
            10 => ["doorman.obj", "rig_doorman_cmu.json", "cmu_02_01.bvh"],
            _ => ["horse.ply", "rig_horse_boxing.json", "boxing_toes.bvh"],
        },
        0,
        pool,
    )?;
    let times = stage.times(RATE, most);
    let animation = stage.animation(times, AnimationRefinement::Carried, pool)?;
    let mut told: Vec<QualityReport> = Vec::new();
    let mut volumes: Vec<f64> = Vec::new();
    let triangles = &stage.deformer.model().triangles;
    let at_rest = volume(stage.deformer.rest(), triangles);
    solve(&animation, 0..times.count, pool, &mut |frame| {
        volumes.push(volume(&frame.positions, triangles) / at_rest - 1.0);
        told.push(stage.deformer.quality(&frame.positions, pool));
    })?;
    let flips = told.iter().map(|q| f64::from(q.flipped_triangles));
    let mean = flips.clone().sum::<f64>() / told.len() as f64;
    let worst = flips.fold(0.0, f64::max);
    let volume = volumes
        .into_iter()
        .map(|v| 100.0 * v)
        .fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    let (name, flips, volumes) = match row {
        10 => ("doorman, a walk", [Some(10.0), None], [Some(4.0), None]),
        _ => ("horse, boxing", [Some(60.0), Some(10.0)], [Some(6.0), None]),
    };
    Ok(vec![
        MotionFigure::below(
            row,
            format!("{name}, {} frames: flipped triangles, mean", told.len()),
            (mean, ""),
            flips,
        ),
        MotionFigure::told(row, "flipped triangles, worst", (worst, "")),
        MotionFigure::below(row, "volume, worst", (volume, " %"), volumes),
    ])
}

/// Six times the signed volume between triangles and the mean of all positions; works for open surfaces too.
fn volume(positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    let middle = positions.iter().sum::<DVec3>() / positions.len().max(1) as f64;
    let at = |v: u32| positions[v as usize] - middle;
    triangles.iter().map(|[a, b, c]| at(*a).dot(at(*b).cross(at(*c)))).sum()
}

/// Row 9: a skinned model's own clip.
pub(super) fn measure_own_clip(
    folders: &MotionFolders<'_>,
    most: usize,
    pool: &Pool,
) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let exec = Exec::new(pool, &Silent);
    let deformer = open(read_model_file(&folders.data.join("gltf/CesiumMan.glb"))?, pool)?;
    let request = ClipRequest {
        clip: ClipSource::OfModel("0".into()),
        rig: None,
        frames: FrameChoice {
            fps: Some(RATE),
            count: Some(most),
            ..Default::default()
        },
        scale: None,
        settings: AnimationSettings::default(),
    };
    let limits = AnimationLimits {
        clip: ClipLimits::default(),
        frames: usize::MAX,
        vertices: u64::MAX,
    };
    let animation = Animation::prepare(&deformer, &request, &limits, &exec).map_err(failed)?;
    let (rig, clip) = (animation.moving_rig(), animation.driver().clip());
    let skin = OwnSkin::of(&deformer, rig, clip)?;
    let (mut volumes, mut blended_volume) = ([0.0f64; 2], 0.0);
    let (mut edges, mut blended_edges, mut count) = (0.0, 0.0, 0usize);
    let mut off = vec![0.0f64; rig.bones.len()];
    solve(&animation, animation.range().clone(), pool, &mut |frame| {
        let pose = animation.driver().pose_at(frame.seconds);
        let blended = skin.blend(deformer.rest(), &pose.bones);
        let quality = deformer.quality(&frame.positions, pool);
        volumes[0] += 100.0 * quality.volume_change;
        if quality.volume_change.abs() > volumes[1].abs() / 100.0 {
            volumes[1] = 100.0 * quality.volume_change;
        }
        edges += quality.edge_rms;
        let beside = deformer.quality(&blended, pool);
        blended_edges += beside.edge_rms;
        blended_volume += 100.0 * beside.volume_change;
        for (off, here) in off.iter_mut().zip(skin.distances(&frame.positions, &blended)) {
            *off = off.max(here / deformer.diagonal());
        }
        count += 1;
    })?;
    let followed = off.iter().filter(|off| **off < FOLLOWED).count();
    Ok(vec![
        MotionFigure::below(
            9,
            format!("CesiumMan's clip, {count} frames: volume, worst"),
            (volumes[1], " %"),
            [Some(2.0), None],
        ),
        MotionFigure::told(9, "volume, mean", (volumes[0] / count as f64, " %")),
        MotionFigure::told(9, "blend skinning: volume, mean", (blended_volume / count as f64, " %")),
        MotionFigure::below(
            9,
            "edges over those of blend skinning",
            (edges / blended_edges, ""),
            [Some(0.75), None],
        ),
        MotionFigure::above(
            9,
            format!("joints followed, of {}", off.len()),
            (followed as f64, ""),
            [Some(off.len() as f64), None],
        ),
        MotionFigure::told(
            9,
            "farthest joint, of the diagonal",
            (100.0 * off.iter().copied().fold(0.0, f64::max), " %"),
        ),
    ])
}

/// Which bones of its own rig hold the vertices of a skinned model.
struct OwnSkin(Vec<Vec<(usize, f64)>>);

impl OwnSkin {
    fn of(deformer: &Deformer, rig: &MotionRig, clip: &MotionClip) -> Result<Self, LoadtestFailure> {
        let scene = deformer.model().moving_scene().map_err(failed)?.unwrap_or_default();
        let order = NodeOrder::of(&scene);
        let bone_of = |node: u32| {
            let name = &clip.skeleton.joints[order.joints[node as usize]].name;
            rig.bones.iter().position(|bone| bone.joint == *name)
        };
        let bones: Vec<Option<usize>> = (0..scene.nodes.len() as u32).map(bone_of).collect();
        let of_vertex = |vertex: usize| {
            let held = scene.influences.of(vertex).iter();
            held.filter_map(|(node, weight)| Some((bones[*node as usize]?, f64::from(*weight))))
                .collect()
        };
        Ok(Self((0..deformer.rest().len()).map(of_vertex).collect()))
    }

    fn blend(&self, rest: &[DVec3], bones: &[RigidMotion]) -> Vec<DVec3> {
        let place = |(p, held): (&DVec3, &Vec<(usize, f64)>)| {
            let parts = held.iter().map(|(bone, weight)| bones[*bone].place(*p) * *weight);
            if held.is_empty() { *p } else { parts.sum() }
        };
        rest.iter().zip(&self.0).map(place).collect()
    }

    /// By bone, how far the vertices that it holds most are off: root mean squares.
    fn distances(&self, solved: &[DVec3], blended: &[DVec3]) -> Vec<f64> {
        let bones = self.0.iter().flatten().map(|(bone, _)| bone + 1).max().unwrap_or(0);
        let mut sums = vec![(0.0, 0usize); bones];
        for ((a, b), held) in solved.iter().zip(blended).zip(&self.0) {
            let heaviest = held.iter().max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((bone, _)) = heaviest {
                sums[*bone].0 += a.distance_squared(*b);
                sums[*bone].1 += 1;
            }
        }
        sums.iter()
            .map(|(sum, count)| (sum / (*count).max(1) as f64).sqrt())
            .collect()
    }
}

/// Row 13: weights for models of many parts.
pub(super) fn measure_soups(folders: &MotionFolders<'_>, pool: &Pool) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let mut figures = Vec::new();
    for (name, rig) in [
        ("meshes/doorman.obj", Some("rig_doorman_cmu.json")),
        ("gltf/BrainStem.glb", None),
    ] {
        if let Some(missing) = folders.missing(&[name], rig.as_slice()) {
            eprintln!("row 13: {missing}");
            continue;
        }
        let model =
            Model::read(read_model_file(&folders.data.join(name))?, None, &Limits::default()).map_err(failed)?;
        let rig = match rig {
            Some(rig) => folders.rig(rig)?,
            None => own_rig(&model)?,
        };
        let exec = Exec::new(pool, &Silent);
        let (bound, seconds) = time_once(|| bind_model(&model, &rig, 4, &exec));
        let influences = bound.map_err(failed)?.influences;
        let unweighted = influences.iter().filter(|own| own.iter().next().is_none()).count();
        figures.push(MotionFigure::below(
            13,
            format!("{name}: unweighted vertices"),
            (unweighted as f64, ""),
            [Some(0.0), None],
        ));
        figures.push(MotionFigure::below(13, "seconds", (seconds, " s"), [Some(3.0), None]));
    }
    Ok(figures)
}

fn own_rig(model: &Model) -> Result<MotionRig, LoadtestFailure> {
    let scene = model.moving_scene().map_err(failed)?.unwrap_or_default();
    let order = NodeOrder::of(&scene);
    let skeleton = clip_of_scene(&scene, &order, None);
    rig_of_skin(&scene, &order, &skeleton, &model.positions).map_err(failed)
}

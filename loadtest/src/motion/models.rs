//! Other models: a skinned one with its own clip, a man of many parts, a horse that boxes, and weights for soups.

use super::ballet::BALLET;
use super::stage::{MotionFigure, MotionFolders, MotionStage, bind, figure, open, skinned, solve};
use crate::failure::LoadtestFailure;
use crate::measurements::time_once;
use crate::models::read_model_file;
use glam::{DQuat, DVec3};
use pliant::asset::{Limits, Model};
use pliant::engine::{
    ANIMATION_QUALITY, Animation, AnimationLimits, ClipRequest, ClipSource, Deformer, FrameChoice, FrameTimes,
    QualityReport, bind_model,
};
use pliant::exec::Exec;
use pliant::motion::bvh::ClipLimits;
use pliant::motion::rig::{MotionRig, ReferencePose, RestAttitude, RigidMotion, rig_of_skin};
use pliant::motion::{
    Interpolation, JointCurves, JointPose, KeyedCurve, MotionClip, NodeOrder, RecordedFrames, Skeleton, SkeletonJoint,
    clip_of_scene,
};
use pliant::pool::Pool;
use pliant::progress::Silent;

/// Frames a second.
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
    let animation = stage.animation(times, None, pool)?;
    let mut reported: Vec<QualityReport> = Vec::new();
    let mut volumes: Vec<f64> = Vec::new();
    let triangles = &stage.deformer.model().triangles;
    let at_rest = volume(stage.deformer.rest(), triangles);
    solve(&animation, 0..times.count, pool, &mut |frame| {
        volumes.push(volume(&frame.positions, triangles) / at_rest - 1.0);
        reported.push(stage.deformer.quality(&frame.positions, pool));
    })?;
    let flips = reported.iter().map(|q| f64::from(q.flipped_triangles));
    let mean = flips.clone().sum::<f64>() / reported.len() as f64;
    let worst = flips.fold(0.0, f64::max);
    let volume = volumes
        .into_iter()
        .map(|v| 100.0 * v)
        .fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    let (name, flips, volumes) = match row {
        10 => ("doorman, a walk", (10.0, None), (4.0, None)),
        _ => ("horse, boxing", (60.0, Some(10.0)), (6.0, None)),
    };
    Ok(vec![
        figure(
            row,
            format!("{name}, {} frames: flipped triangles, mean", reported.len()),
            mean,
            "",
        )
        .at_most(flips.0, flips.1),
        figure(row, "flipped triangles, worst", worst, ""),
        figure(row, "volume, worst", volume, " %").at_most(volumes.0, volumes.1),
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
        plant_feet: None,
        quality: ANIMATION_QUALITY,
        counts_crossings: false,
        contact: Default::default(),
    };
    let limits = AnimationLimits {
        clip: ClipLimits::default(),
        frames: usize::MAX,
        vertices: u64::MAX,
    };
    let animation = Animation::prepare(&deformer, &request, &limits, &exec)?;
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
        figure(
            9,
            format!("CesiumMan's clip, {count} frames: volume, worst"),
            volumes[1],
            " %",
        )
        .at_most(2.0, None),
        figure(9, "volume, mean", volumes[0] / count as f64, " %"),
        figure(9, "blend skinning: volume, mean", blended_volume / count as f64, " %"),
        figure(9, "edges over those of blend skinning", edges / blended_edges, "").at_most(0.75, None),
        figure(9, format!("joints followed, of {}", off.len()), followed as f64, "").at_least(off.len() as f64, None),
        figure(
            9,
            "farthest joint, of the diagonal",
            100.0 * off.iter().copied().fold(0.0, f64::max),
            " %",
        ),
    ])
}

/// Which bones of its own rig hold the vertices of a skinned model.
struct OwnSkin(Vec<Vec<(usize, f64)>>);

impl OwnSkin {
    fn of(deformer: &Deformer, rig: &MotionRig, clip: &MotionClip) -> Result<Self, LoadtestFailure> {
        let scene = deformer.model().moving_scene()?.unwrap_or_default();
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
        let model = Model::read(read_model_file(&folders.data.join(name))?, None, &Limits::default())?;
        let rig = match rig {
            Some(rig) => folders.rig(rig)?,
            None => own_rig(&model)?,
        };
        let exec = Exec::new(pool, &Silent);
        let (bound, seconds) = time_once(|| bind_model(&model, &rig, 4, &exec));
        let influences = bound?.influences;
        let unweighted = influences.iter().filter(|own| own.iter().next().is_none()).count();
        figures.push(figure(13, format!("{name}: unweighted vertices"), unweighted as f64, "").at_most(0.0, None));
        figures.push(figure(13, "seconds", seconds, " s").at_most(3.0, None));
    }
    Ok(figures)
}

fn own_rig(model: &Model) -> Result<MotionRig, LoadtestFailure> {
    let scene = model.moving_scene()?.unwrap_or_default();
    let order = NodeOrder::of(&scene);
    let skeleton = clip_of_scene(&scene, &order, None);
    Ok(rig_of_skin(&scene, &order, &skeleton, &model.positions)?)
}

/// By how much it is turned, in degrees.
const TURN: f64 = 150.0;
/// Frames on the way, one in a 30th of a second.
const FRAMES: usize = 31;
const RATE: f64 = 30.0;
/// The hand, which is turned about the axis of the bone that it hangs on.
const HAND: &str = "lHand";
/// How far around the wrist volume counts, in radii of the hand.
const AROUND: f64 = 1.5;

/// Row 8.
pub(super) fn measure_wrist(folders: &MotionFolders<'_>, pool: &Pool) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let mut stage = folders.stage(BALLET, 0, pool)?;
    let Some(hand) = stage.rig.bones.iter().position(|bone| bone.id == HAND) else {
        return Err(LoadtestFailure::Server(format!("the rig has no bone \"{HAND}\"")));
    };
    turn_hand(&mut stage, hand);
    let times = FrameTimes {
        start: 0.0,
        rate: RATE,
        count: FRAMES,
    };
    let animation = stage.animation(times, None, pool)?;
    let mut last = Vec::new();
    solve(&animation, 0..FRAMES, pool, &mut |frame| last = frame.positions)?;
    let pose = animation.driver().pose_at(times.at(FRAMES - 1));
    let blended = skinned(stage.deformer.rest(), &bind(&stage, pool)?, &pose.bones);
    let patch = WristPatch::find(&stage, hand);
    let rest = patch.volume(stage.deformer.rest());
    let change = |shape: &[DVec3]| 100.0 * (patch.volume(shape) / rest - 1.0);
    let flips = |shape: &[DVec3]| f64::from(stage.deformer.quality(shape, pool).flipped_triangles);
    Ok(vec![
        figure(8, "wrist by 150 degrees: volume around it", change(&last), " %").at_most(12.0, 5.0),
        figure(8, "flipped triangles", flips(&last), "").at_most(0.0, None),
        figure(8, "blend skinning: volume around it", change(&blended), " %"),
        figure(8, "blend skinning: flipped triangles", flips(&blended), ""),
    ])
}

/// Gives a stage a clip of its own rig's joints in which the hand is turned, and nothing else.
fn turn_hand(stage: &mut MotionStage, hand: usize) {
    let bones = &mut stage.rig.bones;
    let starts: Vec<DVec3> = bones.iter().map(|bone| bone.from).collect();
    let mut clip = MotionClip {
        curves: vec![JointCurves::default(); bones.len()],
        duration: (FRAMES - 1) as f64 / RATE,
        recorded: Some(RecordedFrames {
            count: FRAMES,
            interval: 1.0 / RATE,
        }),
        ..Default::default()
    };
    let mut joints = Vec::with_capacity(bones.len());
    for bone in bones.iter_mut() {
        bone.joint.clone_from(&bone.id);
        bone.aim = None;
        bone.rest = RestAttitude::Orientation;
        let above = bone.parent.map_or(DVec3::ZERO, |p| starts[p]);
        joints.push(SkeletonJoint {
            name: bone.id.clone(),
            parent: bone.parent,
            rest: JointPose::at(bone.from - above),
        });
    }
    let arm = bones[hand]
        .parent
        .and_then(|p| bones[p].direction())
        .unwrap_or(DVec3::X);
    let times: Vec<f64> = (0..FRAMES).map(|k| k as f64 / RATE).collect();
    let turn = |k: usize| DQuat::from_axis_angle(arm, (TURN * k as f64 / (FRAMES - 1) as f64).to_radians());
    let turns: Vec<DQuat> = (0..FRAMES).map(turn).collect();
    clip.curves[hand].rotation = KeyedCurve::through(times.into(), turns, Interpolation::Linear);
    clip.skeleton = Skeleton { joints };
    stage.clip = clip;
    stage.rig.reference = ReferencePose::Rest;
    stage.rig.scale = Some(1.0);
}

/// The surface around a wrist.
struct WristPatch {
    wrist: DVec3,
    triangles: Vec<[usize; 3]>,
}

impl WristPatch {
    /// Triangles near the wrist, and nearer to the hand and the forearm than to any other bone.
    fn find(stage: &MotionStage, hand: usize) -> Self {
        let bones = &stage.rig.bones;
        let wrist = bones[hand].from;
        let reach = AROUND * bones[hand].radius;
        let rest = stage.deformer.rest();
        let is_own = |p: DVec3| {
            let distance = |bone: &pliant::motion::rig::RigBone| {
                let along = bone.to - bone.from;
                let share = (p - bone.from).dot(along) / along.length_squared().max(f64::MIN_POSITIVE);
                p.distance(bone.from + along * share.clamp(0.0, 1.0))
            };
            let nearest = (0..bones.len()).min_by(|a, b| distance(&bones[*a]).total_cmp(&distance(&bones[*b])));
            nearest == Some(hand) || nearest == bones[hand].parent
        };
        let is_near = |v: &usize| rest[*v].distance(wrist) < reach && is_own(rest[*v]);
        let triangles = stage.deformer.geometry().triangles.iter();
        let triangles = triangles
            .map(|t| t.map(|v| v as usize))
            .filter(|t| t.iter().all(is_near));
        Self {
            wrist,
            triangles: triangles.collect(),
        }
    }

    /// The volume between the wrist, which stays where it is, and the surface.
    fn volume(&self, shape: &[DVec3]) -> f64 {
        let cone = |t: &[usize; 3]| {
            let [a, b, c] = t.map(|v| shape[v] - self.wrist);
            a.dot(b.cross(c)) / 6.0
        };
        self.triangles.iter().map(cone).sum()
    }
}

//! Handles with any region and any options: they are refused with a reason or solved, and hold the same whenever they are set.

use super::byte_draw::ByteDraw;
use super::edits::{LIMITS, edit, region, small_box};
use glam::DVec3;
use pliant::engine::{
    Deformer, Error, Falloff, FalloffCurve, Handle, HandleConstrains, HandlePose, HandleScale, HandleSet, Plane,
    Region, SolveSettings, digest,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;

pub fn handles(bytes: &[u8]) {
    let mut draw = ByteDraw(bytes);
    let pool = Pool::new(1).expect("one thread");
    let exec = Exec::new(&pool, &Silent);
    let (file, options) = small_box(&mut draw);
    let opened = Deformer::open(file, &options, &LIMITS, &exec);
    let mut deformer = opened.expect("the box opens");
    let vertices = deformer.rest().len();
    let count = 1 + draw.below(3);
    let set = HandleSet {
        handles: (0..count).map(|k| handle(&mut draw, k, vertices)).collect(),
        symmetry_plane: (draw.below(4) == 0).then(|| Plane::new([1.0, 0.0, 0.0], 0.5)),
        region_of_interest: (draw.below(4) == 0).then(|| any_region(&mut draw, vertices)),
    };
    if let Err(refused) = deformer.set_handles(&set, &exec) {
        require_reason(&refused, &set);
        return;
    }
    let settings = SolveSettings {
        tolerance: Some(1e-2),
        refine: Some(draw.below(3) as u32),
        spatial_rbf: draw.below(8) == 0,
        ..SolveSettings::default()
    };
    let poses: Vec<(String, HandlePose)> = (set.handles.iter())
        .map(|handle| (handle.id.clone(), pose(&mut draw)))
        .collect();
    let commit = |deformer: &mut Deformer| {
        let known = deformer.handles().clone();
        let poses = poses.iter().filter(|(id, _)| known.handles.iter().any(|h| h.id == *id));
        match deformer.commit(poses.map(|(id, pose)| (id.as_str(), *pose)), &settings, &exec) {
            Ok(shape) => {
                assert!(shape.positions.iter().all(|p| p.is_finite()), "{set:?}: no number");
                Some(digest(&shape.positions))
            }
            Err(refused) => {
                require_reason(&refused, &known);
                None
            }
        }
    };
    commit(&mut deformer);
    if deformer.edit_rest(&edit(&mut draw), &exec).is_err() {
        return;
    }
    let before = commit(&mut deformer);
    let carried = deformer.handles().clone();
    deformer.set_handles(HandleSet::default(), &exec).expect("no handles");
    deformer
        .set_handles(&carried, &exec)
        .expect("the handles that were carried");
    assert_eq!(before, commit(&mut deformer), "{set:?}: set afresh they are others");
}

fn require_reason(refused: &Error, set: &HandleSet) {
    assert!(!matches!(refused, Error::Internal(_)), "{refused}: {set:?}");
}

/// A number that a user might give.
fn plain(draw: &mut ByteDraw<'_>) -> f64 {
    draw.number().clamp(-2.0, 2.0)
}

fn plain_vector(draw: &mut ByteDraw<'_>) -> DVec3 {
    DVec3::new(plain(draw), plain(draw), plain(draw))
}

fn any_region(draw: &mut ByteDraw<'_>, vertices: usize) -> Region {
    match draw.below(6) {
        0 => Region::capsule(draw.vector(), draw.vector(), draw.number().abs()),
        1 => Region::Tube {
            points: (0..1 + draw.below(4)).map(|_| draw.vector()).collect(),
            radius: draw.number().abs(),
        },
        2 => Region::Component(draw.below(2) as u32),
        3 => Region::Primitive(draw.below(2) as u32),
        4 => Region::Weights((0..vertices).map(|_| f32::from(draw.byte()) / 255.0).collect()),
        _ => region(draw),
    }
}

fn handle(draw: &mut ByteDraw<'_>, number: usize, vertices: usize) -> Handle {
    let kinds = draw.below(8);
    Handle {
        constrains: HandleConstrains {
            position: kinds & 1 == 0,
            rotation: kinds & 2 == 0,
            scale: kinds & 4 == 0,
        },
        stiffness: draw.flag().then(|| [1e-3, 0.5, 3.0, 1e4][draw.below(4)]),
        rigid: draw.flag(),
        falloff: (draw.below(3) == 0).then(|| Falloff {
            radius: 0.05 + plain(draw).abs(),
            curve: [FalloffCurve::Linear, FalloffCurve::Smooth][draw.below(2)],
        }),
        pose: (draw.below(4) == 0).then(|| pose(draw)),
        ..Handle::new(format!("h{number}"), any_region(draw, vertices))
    }
}

fn pose(draw: &mut ByteDraw<'_>) -> HandlePose {
    let mut pose = HandlePose::default();
    if draw.flag() {
        pose.translation = Some(plain_vector(draw));
    }
    if draw.flag() {
        pose = pose.rotated(plain_vector(draw) * 3.0);
    }
    if draw.below(3) == 0 {
        pose.scale = Some(HandleScale::PerAxis(plain_vector(draw).abs() + DVec3::splat(0.1)));
    }
    if draw.below(3) == 0 {
        pose = pose.about(plain_vector(draw));
    }
    pose
}

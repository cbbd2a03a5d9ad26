//! Whole jobs on a small model; sequences of edits and poses; handles with any region and any options.

use super::ByteDraw;
use glam::DVec3;
use pliant::asset::{FileSet, Limits, shapes};
use pliant::deform::VolumeMode;
use pliant::edit::{KeptSide, SubdivisionScheme};
use pliant::engine::{
    CutLine, DefaultPivot, Deformer, DeformerLimits, Edit, Error, Falloff, FalloffCurve, Handle, HandleConstrains,
    HandlePose, HandleScale, HandleSet, MergeJoin, Method, ModelMerge, OpenOptions, OtherModel, Plane, Quality, Region,
    RemeshCommand, SmoothCommand, SmoothKind, SolveSettings, Stiff, UnintersectCommand, digest,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::{batch, wire::pb};
use prost::Message;
use std::fmt::Write as _;

/// A box as text.
pub fn box_file() -> FileSet {
    box_of_cells([2, 4, 2])
}

/// A box as text, cut into so many cells along each side.
pub fn box_of_cells(cells: [usize; 3]) -> FileSet {
    let (points, faces) = shapes::box_with_cells(DVec3::new(1.0, 2.0, 1.0), cells);
    let mut text = String::new();
    for p in &points {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for [a, b, c] in &faces {
        let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
    }
    FileSet::single("box.obj", text)
}

/// Few enough that no job takes long.
pub const JOB_LIMITS: DeformerLimits = DeformerLimits {
    model: Limits {
        apart: None,
        cage_triangles: 500,
        vertices: 4000,
        triangles: 8000,
        decoded_bytes: 32 << 20,
        document_bytes: 32 << 20,
        points_and_lines: true,
    },
    memory_bytes: 256 << 20,
    graph_bytes: None,
    handles: 16,
};

pub fn jobs(bytes: &[u8]) {
    let Ok(mut job) = pb::Job::decode(bytes) else { return };
    // Longer jobs show nothing more.
    job.steps.truncate(4);
    if let Some(options) = &mut job.options {
        options.tolerance = options.tolerance.max(1e-3);
        options.refine = options.refine.map(|refine| refine.min(2));
    }
    let pool = Pool::new(1).expect("one thread");
    let exec = Exec::new(&pool, &Silent);
    match batch::run(box_file(), &job, None, &JOB_LIMITS, &exec, &|| 0.0) {
        Ok(outcome) => assert!(!outcome.written.main.is_empty()),
        Err(refused) => assert!(!refused.to_string().is_empty()),
    }
}

/// Small enough that an input takes milliseconds: most of what goes wrong in an edit goes wrong among a few triangles.
const LIMITS: DeformerLimits = DeformerLimits {
    model: Limits {
        apart: None,
        cage_triangles: 500,
        vertices: 400,
        triangles: 800,
        decoded_bytes: 1 << 20,
        document_bytes: 1 << 20,
        points_and_lines: true,
    },
    memory_bytes: 64 << 20,
    graph_bytes: None,
    handles: 16,
};

/// A box of few triangles, most of the time without nodes inside.
fn small_box(draw: &mut ByteDraw<'_>, exec: &Exec<'_>) -> Deformer {
    let mut options = OpenOptions::default();
    let choice = draw.below(16);
    if choice != 0 {
        options.body.volume = VolumeMode::Off;
    }
    let file = box_of_cells(if choice < 2 { [2, 4, 2] } else { [1, 2, 1] });
    Deformer::open(file, &options, &LIMITS, exec).expect("the box opens")
}

/// Edits and poses in turn: after each the model is sound, and the way back leads to the bits before it.
pub fn edits(bytes: &[u8]) {
    let mut draw = ByteDraw(bytes);
    let pool = Pool::new(1).expect("one thread");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = small_box(&mut draw, &exec);
    for _ in 0..4 {
        if draw.is_done() {
            return;
        }
        let (state, before) = (deformer.topology_state(), digest(deformer.rest()));
        if draw.below(3) == 0 {
            pose(&mut deformer, &mut draw, &exec);
        }
        let edit = edit(&mut draw);
        if deformer.edit_rest(&edit, &exec).is_err() {
            assert_eq!(
                digest(deformer.rest()),
                before,
                "{edit:?} was refused and has changed the model"
            );
            continue;
        }
        check(&deformer);
        if draw.flag() {
            let (edited, after) = (deformer.topology_state(), digest(deformer.rest()));
            deformer.restore_topology(&state, &exec).expect("the way back");
            assert_eq!(
                digest(deformer.rest()),
                before,
                "{edit:?}: the way back leads elsewhere"
            );
            deformer.restore_topology(&edited, &exec).expect("forth again");
            assert_eq!(digest(deformer.rest()), after, "{edit:?}: forth again leads elsewhere");
        }
    }
}

fn check(deformer: &Deformer) {
    let vertices = deformer.rest().len();
    assert!(
        deformer.rest().iter().all(|p| p.is_finite()),
        "a position that is not a number"
    );
    assert!(!deformer.geometry().triangles.is_empty(), "no triangle is left");
    let inside = |v: &u32| (*v as usize) < vertices;
    assert!(
        deformer.geometry().triangles.iter().flatten().all(inside),
        "a vertex that is not there"
    );
}

fn pose(deformer: &mut Deformer, draw: &mut ByteDraw<'_>, exec: &Exec<'_>) {
    let handles = [
        Handle::new("a", Region::sphere(draw.vector(), draw.number().abs())),
        Handle::new("b", Region::half_space(draw.vector(), draw.number())),
    ];
    if deformer.set_handles(handles, exec).is_err() {
        return;
    }
    let settings = SolveSettings::from(Quality {
        tolerance: Some(1e-2),
        refine: Some(1),
        ..Quality::default()
    });
    let moved = HandlePose::rotation(draw.vector());
    if let Ok(shape) = deformer.commit([("b", moved)], &settings, exec) {
        assert!(
            shape.positions.iter().all(|p| p.is_finite()),
            "a pose leads to what is not a number"
        );
    }
}

fn region(draw: &mut ByteDraw<'_>) -> Region {
    match draw.below(4) {
        0 => Region::sphere(draw.vector(), draw.number().abs()),
        1 => Region::half_space(draw.vector(), draw.number()),
        2 => Region::axis_aligned_box(draw.vector(), draw.vector()),
        _ => {
            let count = draw.below(6);
            Region::vertices((0..count).map(|_| u32::from(draw.byte())).collect::<Vec<u32>>())
        }
    }
}

fn somewhere(draw: &mut ByteDraw<'_>) -> Option<Region> {
    draw.flag().then(|| region(draw))
}

fn kept_side(draw: &mut ByteDraw<'_>) -> KeptSide {
    [KeptSide::Above, KeptSide::Below, KeptSide::Both][draw.below(3)]
}

fn points(draw: &mut ByteDraw<'_>) -> Vec<DVec3> {
    (0..draw.below(6)).map(|_| draw.vector()).collect()
}

/// Any operation.
pub(super) fn edit(draw: &mut ByteDraw<'_>) -> Edit {
    match draw.below(14) {
        0 => Edit::Cut {
            along: CutLine::Plane(Plane::new(draw.vector(), draw.number())),
            keep: kept_side(draw),
            fill: draw.flag(),
            cap: None,
        },
        1 => Edit::Cut {
            along: CutLine::Polyline {
                points: points(draw),
                closed: draw.flag(),
            },
            keep: kept_side(draw),
            fill: draw.flag(),
            cap: None,
        },
        2 => Edit::Cut {
            along: CutLine::Path {
                vertices: (0..draw.below(6)).map(|_| u32::from(draw.byte())).collect(),
                closed: draw.flag(),
            },
            keep: kept_side(draw),
            fill: draw.flag(),
            cap: None,
        },
        3 => Edit::Subdivide {
            region: somewhere(draw),
            scheme: [SubdivisionScheme::Midpoint, SubdivisionScheme::Loop][draw.below(2)],
            creases: Default::default(),
        },
        4 => Edit::SubdivideForPose {
            region: somewhere(draw),
        },
        5 => Edit::Decimate {
            region: somewhere(draw),
            ratio: draw.number(),
        },
        6 => Edit::Delete {
            region: region(draw),
            fill: draw.flag(),
        },
        7 => Edit::Fill {
            region: somewhere(draw),
            cap: None,
        },
        8 => Edit::Remesh(RemeshCommand {
            region: somewhere(draw),
            edge_length: draw.flag().then(|| draw.number()),
            max_deviation: draw.flag().then(|| draw.number()),
            sharp_degrees: draw.flag().then(|| draw.number()),
        }),
        12 => Edit::Smooth(SmoothCommand {
            region: somewhere(draw),
            kind: [SmoothKind::Smooth, SmoothKind::Relax][draw.below(2)],
            iterations: draw.flag().then(|| u32::from(draw.byte())),
            strength: draw.flag().then(|| draw.number()),
            sharp_degrees: draw.flag().then(|| draw.number()),
        }),
        13 => Edit::Unintersect(UnintersectCommand {
            fixed: somewhere(draw),
            clearance: draw.flag().then(|| draw.number()),
        }),
        9 => Edit::Merge(Box::new(merge(draw))),
        10 => Edit::InsertCurve {
            points: points(draw),
            closed: draw.flag(),
        },
        _ => Edit::Weld {
            tolerance: draw.number(),
        },
    }
}

fn merge(draw: &mut ByteDraw<'_>) -> ModelMerge {
    let axes = [0; 3].map(|_| draw.vector());
    let [x, y, z] = axes.map(|axis| if draw.flag() { axis } else { DVec3::ONE * 0.25 });
    let own_from_other = glam::DMat4::from_cols(
        (DVec3::X * x).extend(0.0),
        (DVec3::Y * y).extend(0.0),
        (DVec3::Z * z).extend(0.0),
        draw.vector().extend(1.0),
    );
    ModelMerge {
        other: OtherModel {
            files: if draw.flag() {
                box_of_cells([1, 2, 1])
            } else {
                FileSet::single("odd.off", draw.0.to_vec())
            },
            ..OtherModel::default()
        },
        own_from_other,
        join: [MergeJoin::Loose, MergeJoin::Weld, MergeJoin::Stitch][draw.below(3)],
        tolerance: draw.flag().then(|| draw.number()),
    }
}

/// Handles are refused with a reason or solved, and hold the same whenever they are set.
pub fn handles(bytes: &[u8]) {
    let mut draw = ByteDraw(bytes);
    let pool = Pool::new(1).expect("one thread");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = small_box(&mut draw, &exec);
    let vertices = deformer.rest().len();
    let count = 1 + draw.below(3);
    let set = HandleSet {
        handles: (0..count).map(|k| handle(&mut draw, k, vertices)).collect(),
        symmetry_plane: (draw.below(4) == 0).then(|| Plane::new([1.0, 0.0, 0.0], 0.5)),
        region_of_interest: (draw.below(4) == 0).then(|| any_region(&mut draw, vertices)),
        stiff: (draw.below(4) == 0).then(|| Stiff {
            all: true,
            ..Stiff::default()
        }),
        default_pivot: if draw.below(4) == 0 {
            DefaultPivot::Middle
        } else {
            DefaultPivot::Joint
        },
    };
    if let Err(refused) = deformer.set_handles(&set, &exec) {
        require_reason(&refused, &set);
        return;
    }
    let settings = SolveSettings {
        quality: Quality {
            tolerance: Some(1e-2),
            refine: Some(draw.below(3) as u32),
            ..Quality::default()
        },
        method: match draw.below(8) {
            0 => Method::SpatialRbf,
            _ => Method::Harmonic,
        },
        ..SolveSettings::default()
    };
    let poses: Vec<(String, HandlePose)> = (set.handles.iter())
        .map(|handle| (handle.id.clone(), any_pose(&mut draw)))
        .collect();
    let commit = |deformer: &mut Deformer| {
        let known = deformer.handles().clone();
        let poses = poses.iter().filter(|(id, _)| known.handles.iter().any(|h| h.id == *id));
        match deformer.commit(poses.map(|(id, pose)| (id.as_str(), pose.clone())), &settings, &exec) {
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
    assert_eq!(before, commit(&mut deformer), "{set:?}: set again they are others");
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
        pose: (draw.below(4) == 0).then(|| any_pose(draw)),
        ..Handle::new(format!("h{number}"), any_region(draw, vertices))
    }
}

fn any_pose(draw: &mut ByteDraw<'_>) -> HandlePose {
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
    if draw.below(8) == 0 {
        pose = pose.turning_freely();
    }
    pose
}

//! Sequences of edits and poses: after each the model is sound, and the way back leads to the bits before it.

use super::byte_draw::ByteDraw;
use super::jobs::box_of_cells;
use glam::DVec3;
use pliant::asset::{FileSet, Limits};
use pliant::deform::VolumeMode;
use pliant::edit::{KeptSide, SubdivisionScheme};
use pliant::engine::{
    CutLine, Deformer, DeformerLimits, Edit, Handle, HandlePose, MergeJoin, ModelMerge, OpenOptions, Plane, Region,
    RemeshCommand, SolveSettings, digest,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;

/// Small enough that an input takes milliseconds: most of what goes wrong in an edit goes wrong among a few triangles.
pub(super) const LIMITS: DeformerLimits = DeformerLimits {
    model: Limits {
        vertices: 400,
        triangles: 800,
        decoded_bytes: 1 << 20,
        document_bytes: 1 << 20,
    },
    memory_bytes: 64 << 20,
    graph_bytes: None,
    handles: 16,
};

/// A box of few triangles, most of the time without nodes inside.
pub(super) fn small_box(draw: &mut ByteDraw<'_>) -> (FileSet, OpenOptions) {
    let mut options = OpenOptions::default();
    let choice = draw.below(16);
    if choice != 0 {
        options.body.volume = VolumeMode::Off;
    }
    (box_of_cells(if choice < 2 { [2, 4, 2] } else { [1, 2, 1] }), options)
}

pub fn edits(bytes: &[u8]) {
    let mut draw = ByteDraw(bytes);
    let pool = Pool::new(1).expect("one thread");
    let exec = Exec::new(&pool, &Silent);
    let (file, options) = small_box(&mut draw);
    let opened = Deformer::open(file, &options, &LIMITS, &exec);
    let mut deformer = opened.expect("the box opens");
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
    let settings = SolveSettings {
        tolerance: Some(1e-2),
        refine: Some(1),
        ..SolveSettings::default()
    };
    let moved = HandlePose::rotation(draw.vector());
    if let Ok(shape) = deformer.commit([("b", moved)], &settings, exec) {
        assert!(
            shape.positions.iter().all(|p| p.is_finite()),
            "a pose leads to what is not a number"
        );
    }
}

pub(super) fn region(draw: &mut ByteDraw<'_>) -> Region {
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

fn points(draw: &mut ByteDraw<'_>) -> Vec<DVec3> {
    (0..draw.below(6)).map(|_| draw.vector()).collect()
}

/// Any operation.
pub(super) fn edit(draw: &mut ByteDraw<'_>) -> Edit {
    match draw.below(12) {
        0 => Edit::Cut {
            along: CutLine::Plane(Plane::new(draw.vector(), draw.number())),
            keep: [KeptSide::Above, KeptSide::Below, KeptSide::Both][draw.below(3)],
            fill: draw.flag(),
        },
        1 => Edit::Cut {
            along: CutLine::Polyline {
                points: points(draw),
                closed: draw.flag(),
            },
            keep: [KeptSide::Above, KeptSide::Below, KeptSide::Both][draw.below(3)],
            fill: draw.flag(),
        },
        2 => Edit::Cut {
            along: CutLine::Path {
                vertices: (0..draw.below(6)).map(|_| u32::from(draw.byte())).collect(),
                closed: draw.flag(),
            },
            keep: [KeptSide::Above, KeptSide::Below, KeptSide::Both][draw.below(3)],
            fill: draw.flag(),
        },
        3 => Edit::Subdivide {
            region: somewhere(draw),
            scheme: [SubdivisionScheme::Midpoint, SubdivisionScheme::Loop][draw.below(2)],
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
        },
        8 => Edit::Remesh(RemeshCommand {
            region: somewhere(draw),
            edge_length: draw.flag().then(|| draw.number()),
            max_deviation: draw.flag().then(|| draw.number()),
            sharp_degrees: draw.flag().then(|| draw.number()),
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
        files: if draw.flag() {
            box_of_cells([1, 2, 1])
        } else {
            FileSet::single("odd.off", draw.0.to_vec())
        },
        from_session: false,
        format: None,
        own_from_other,
        join: [MergeJoin::Loose, MergeJoin::Weld, MergeJoin::Stitch][draw.below(3)],
        tolerance: draw.flag().then(|| draw.number()),
    }
}

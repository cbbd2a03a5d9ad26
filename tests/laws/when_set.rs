//! What a handle holds, and so the shape, does not depend on when it was set: before an edit or after it.

use crate::support::bench;
use glam::{DMat4, DVec3};
use pliant::asset::{FileSet, Format, Limits, Model, shapes};
use pliant::batch;
use pliant::edit::{KeptSide, SubdivisionScheme};
use pliant::engine::{
    CutLine, Deformer, DeformerLimits, Edit, EditCommand, EditOutcome, EditedShape, Handle, HandlePose, HandleSet,
    MergeJoin, ModelMerge, ModelShape, OtherModel, Plane, Region, RemeshCommand, SmoothCommand, SmoothKind,
    SolveSettings, UnintersectCommand,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{json, pb};

/// A bar along z, 4 long.
fn bar() -> bench::Shape {
    shapes::box_with_cells(DVec3::new(1.0, 1.0, 4.0), [3, 3, 10])
}

fn bits(points: &[DVec3]) -> Vec<[u64; 3]> {
    points.iter().map(|p| p.to_array().map(f64::to_bits)).collect()
}

/// The operation that moves the rest shape.
const PARTED: &str = "merge what crosses, and part it";

/// The operation that depends on the handles.
const FOR_POSE: &str = "divide for the pose";

/// Every operation, alone or with what makes it possible.
fn operations() -> Vec<(&'static str, Vec<Edit>)> {
    let side = || Region::sphere([1.0, 0.5, 2.0], 0.5);
    let cut = |keep, fill| Edit::Cut {
        along: CutLine::Plane(Plane::new([0.0, 0.3, 1.0], 1.3)),
        keep,
        fill,
        cap: None,
    };
    let merge = |height| ModelMerge {
        other: OtherModel {
            files: bench::obj(&shapes::box_with_cells(DVec3::splat(0.5), [1; 3])),
            ..OtherModel::default()
        },
        own_from_other: DMat4::from_translation(DVec3::new(0.25, 0.25, height)),
        join: MergeJoin::Loose,
        tolerance: None,
    };
    let remesh = |region, edge_length| {
        Edit::Remesh(RemeshCommand {
            region,
            edge_length: Some(edge_length),
            ..RemeshCommand::default()
        })
    };
    let subdivide = |region, scheme| Edit::Subdivide {
        region,
        scheme,
        creases: Default::default(),
    };
    vec![
        ("cut", vec![cut(KeptSide::Above, true)]),
        ("cut in two", vec![cut(KeptSide::Both, false)]),
        ("subdivide", vec![subdivide(None, SubdivisionScheme::Midpoint)]),
        (
            "subdivide a part",
            vec![subdivide(Some(side()), SubdivisionScheme::Loop)],
        ),
        (
            "decimate",
            vec![Edit::Decimate {
                region: None,
                ratio: 0.5,
            }],
        ),
        (
            "delete and fill",
            vec![
                Edit::Delete {
                    region: side(),
                    fill: false,
                },
                Edit::Fill {
                    region: None,
                    cap: None,
                },
            ],
        ),
        ("remesh", vec![remesh(None, 0.2)]),
        ("smooth", vec![Edit::Smooth(SmoothCommand::default())]),
        (
            "relax a part",
            vec![Edit::Smooth(SmoothCommand {
                region: Some(side()),
                kind: SmoothKind::Relax,
                ..SmoothCommand::default()
            })],
        ),
        ("remesh a part", vec![remesh(Some(side()), 0.15)]),
        ("merge", vec![Edit::Merge(Box::new(merge(4.05)))]),
        (
            PARTED,
            vec![
                Edit::Merge(Box::new(merge(3.9))),
                Edit::Unintersect(UnintersectCommand::default()),
            ],
        ),
        (
            "insert a curve",
            vec![Edit::InsertCurve {
                points: [0.6, 1.9, 3.8].map(|z| DVec3::new(1.0, 0.4, z)).to_vec(),
                closed: false,
            }],
        ),
        ("weld", vec![Edit::Weld { tolerance: 0.35 }]),
        (FOR_POSE, vec![Edit::SubdivideForPose { region: None }]),
    ]
}

/// Every kind of region, as one that holds the upper end; those that hold nothing but places first.
fn regions() -> Vec<(&'static str, Region)> {
    let rest = bar().0;
    let upper = (0u32..).zip(&rest).filter(|(_, p)| p.z > 3.5).map(|(v, _)| v);
    let (middle, top) = (DVec3::new(0.5, 0.5, 3.7), DVec3::new(0.5, 0.5, 4.0));
    vec![
        ("half-space", Region::half_space([0.0, 0.0, 1.0], 3.7)),
        ("sphere", Region::sphere([0.5, 0.5, 4.0], 0.8)),
        ("box", Region::axis_aligned_box([-0.1, -0.1, 3.5], [1.1, 1.1, 4.1])),
        ("capsule", Region::capsule(middle, top, 0.75)),
        (
            "tube",
            Region::Tube {
                points: vec![middle, top],
                radius: 0.75,
            },
        ),
        ("inside", Region::sphere([0.5, 0.5, 3.3], 0.3)),
        ("list", Region::vertices(upper)),
        ("component", Region::Component(0)),
        ("primitive", Region::Primitive(0)),
        (
            "weights",
            Region::Weights(rest.iter().map(|p| (p.z as f32 - 3.0).clamp(0.0, 1.0)).collect()),
        ),
    ]
}

fn handles(region: &Region) -> HandleSet {
    let top = Handle::new("top", region.clone());
    let top = match region {
        Region::Weights(_) => top.soft(3.0),
        _ => top,
    };
    // The last handle holds what several do.
    HandleSet::from([top, Handle::new("base", Region::half_space([0.0, 0.0, -1.0], -0.5))])
}

fn bend() -> [(&'static str, HandlePose); 1] {
    [("top", HandlePose::rotation([0.5, 0.2, 0.0]).about([0.5, 0.5, 3.0]))]
}

/// Which shape is edited.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Edited {
    /// The rest shape; poses stay.
    Rest,
    /// The shape in the rest pose becomes the rest shape.
    AtRest,
    /// A pose becomes the rest shape.
    Posed,
}

struct Story<'a> {
    exec: Exec<'a>,
    settings: SolveSettings,
}

impl Story<'_> {
    fn bend(&self, deformer: &mut Deformer) -> ModelShape {
        deformer.commit(bend(), &self.settings, &self.exec).expect("a pose")
    }

    /// Opens the bar and edits it, with handles set all the while or taken off before the edits.
    fn edited(&self, region: &Region, edits: &[Edit], on: Edited, keep: bool) -> Option<Deformer> {
        let mut deformer = bench::bench(&bar());
        deformer.set_handles(handles(region), &self.exec).expect("handles");
        let posed = self.bend(&mut deformer);
        let mut shape = if on == Edited::Posed {
            posed
        } else {
            deformer.rest_shape()
        };
        if !keep {
            deformer.set_handles(HandleSet::default(), &self.exec).expect("none");
        }
        let mut poses = deformer.initial_poses();
        if keep && on != Edited::AtRest {
            poses = deformer.change_poses(&poses, bend()).expect("a pose");
        }
        for edit in edits {
            let command = EditCommand {
                edit,
                on: if on == Edited::Rest {
                    EditedShape::Rest
                } else {
                    EditedShape::Current
                },
                shape: &shape,
                poses: &poses,
                settings: Some(&self.settings),
            };
            let EditOutcome {
                shape: next,
                poses: after,
                ..
            } = deformer.edit(&command, &self.exec).ok()?;
            (shape, poses) = (next, after);
        }
        Some(deformer)
    }
}

/// The nodes that a handle holds hard, and those that it holds softly with the bits of their stiffness.
type HeldNodes = (Vec<u32>, Vec<(u32, u64)>);

/// Of each handle the nodes that it holds and pulls.
fn held(deformer: &Deformer) -> Vec<HeldNodes> {
    let setup = deformer.handle_system().expect("handles").setup();
    let pulls = |pulls: &[(u32, f64)]| pulls.iter().map(|p| (p.0, p.1.to_bits())).collect();
    setup
        .handles
        .iter()
        .map(|h| (h.nodes.clone(), pulls(&h.pulls)))
        .collect()
}

#[test]
fn handles_set_before_an_edit_and_after_it_give_the_same_bits() {
    let pool = Pool::new(2).expect("threads");
    let story = Story {
        exec: Exec::new(&pool, &Silent),
        settings: SolveSettings::default(),
    };
    let mut tried = 0;
    for (operation, edits) in operations() {
        for (kind, region) in regions() {
            for on in [Edited::Rest, Edited::AtRest, Edited::Posed] {
                let case = format!("{operation}, {kind}, {on:?}");
                let keep = operation == FOR_POSE;
                let Some(mut before) = story.edited(&region, &edits, on, true) else {
                    assert!(
                        story.edited(&region, &edits, on, keep).is_none(),
                        "{case}: refused once"
                    );
                    continue;
                };
                let mut after = story.edited(&region, &edits, on, keep).expect("it was edited before");
                after.set_handles(HandleSet::default(), &story.exec).expect("none");
                assert_eq!(bits(before.rest()), bits(after.rest()), "{case}: the rest shape");
                let carried = before.handles().clone();
                after.set_handles(&carried, &story.exec).expect("the handles fit");
                if before.handles().handles.len() < 2 {
                    continue;
                }
                tried += 1;
                assert_eq!(held(&before), held(&after), "{case}: what is held");
                let shape = bits(&story.bend(&mut before));
                assert_eq!(shape, bits(&story.bend(&mut after)), "{case}: the shape");
                // What is given by place stays so, and is what the user has set, where the rest shape stays.
                if region.is_solid() && on != Edited::Posed && operation != PARTED {
                    assert_eq!(carried.handles[0].region, region, "{case}");
                }
                // Set again, where it is.
                before.set_handles(carried, &story.exec).expect("the handles fit");
                assert_eq!(shape, bits(&story.bend(&mut before)), "{case}: set again");
            }
        }
    }
    assert!(tried > 240, "{tried} of 450 cases");
}

#[test]
fn undo_and_redo_lead_to_what_handles_hold_when_they_are_set_there() {
    let pool = Pool::new(2).expect("threads");
    let story = Story {
        exec: Exec::new(&pool, &Silent),
        settings: SolveSettings::default(),
    };
    for (kind, region) in regions() {
        let mut deformer = bench::bench(&bar());
        deformer.set_handles(handles(&region), &story.exec).expect("handles");
        let start = (deformer.topology_state(), deformer.handles().clone());
        let bent = bits(&story.bend(&mut deformer));
        let edit = Edit::Subdivide {
            region: Some(Region::sphere([1.0, 0.5, 2.0], 0.5)),
            scheme: SubdivisionScheme::Midpoint,
            creases: Default::default(),
        };
        deformer.edit_rest(&edit, &story.exec).expect("edited");
        let edited = (deformer.topology_state(), deformer.handles().clone());
        let after = bits(&story.bend(&mut deformer));
        for ((state, handles), expected) in [(&start, &bent), (&edited, &after), (&start, &bent)] {
            deformer.restore_topology(state, &story.exec).expect("the way is known");
            deformer.set_handles(handles, &story.exec).expect("the handles fit");
            assert_eq!(&bits(&story.bend(&mut deformer)), expected, "{kind}");
        }
    }
}

/// The relative change of the volume by a job on a bar of eight corners along y.
fn volume_change(steps: &str) -> f64 {
    let (points, faces) = shapes::box_with_cells(DVec3::new(0.4, 4.0, 0.4), [1; 3]);
    let middle = DVec3::new(0.2, 0.0, 0.2);
    let file = bench::obj(&(points.iter().map(|p| *p - middle).collect(), faces));
    let text = format!(
        r#"{{"handles": [{{"id": "base", "region": {{"halfSpace": {{"normal": [0, -1, 0], "offset": -0.05}}}}}},
            {{"id": "top", "region": {{"halfSpace": {{"normal": [0, 1, 0], "offset": 3.95}}}}}}], "steps": [{steps}]}}"#
    );
    let job: pb::Job = json::from_json(text.as_bytes()).unwrap_or_else(|e| panic!("{e}: {text}"));
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let done = batch::run(file, &job, None, &DeformerLimits::default(), &exec, &|| 0.0).expect("the job runs");
    let files = FileSet::single("bar.obj", done.written.main);
    let model = Model::read(files, Some(Format::OBJ), &Limits::default()).expect("it reads");
    let volume = pliant::mesh::signed_volume(&model.positions, &model.triangles);
    volume / (0.4 * 0.4 * 4.0) - 1.0
}

#[test]
fn a_coarse_bar_that_is_remeshed_bends_along_an_arc() {
    let pose = r#"{"pose": {"handles": [{"id": "top", "pose": {"rotationVector": [0, 0, -1.2], "pivot": [0, 4, 0],
        "translation": [2.1256, -0.8932, 0]}}]}}"#;
    let remesh = |on: &str| format!(r#"{{"edit": {{"on": "{on}", "remesh": {{"edgeLength": 0.1}}}}}}"#);
    for steps in [
        format!("{}, {pose}", remesh("CURRENT")),
        format!("{pose}, {}", remesh("REST")),
    ] {
        let change = volume_change(&steps);
        assert!(change.abs() < 0.01, "{change}: {steps}");
    }
}

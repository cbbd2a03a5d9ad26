//! Commits come back as they were written, and bytes that are no commit are refused.

use super::*;
use pliant_core::engine::{Contact, Handle, HandleScale, Region, Stiff, VertexTargets};
use proptest::prelude::*;

fn facts() -> Box<pb::Session> {
    Box::new(pb::Session {
        model: Some(pb::ModelFacts {
            format: "obj".into(),
            bytes: 3,
            sha256: "abc".into(),
            vertices: 8,
            triangles: 12,
        }),
        solver: Some(pb::SolverFacts::default()),
        ..Default::default()
    })
}

fn handle_set() -> HandleSet {
    let stiff = Stiff {
        regions: vec![Region::Component(2)],
        strength: 1.0 / 3.0,
        ..Stiff::default()
    };
    HandleSet {
        stiff: Some(stiff),
        ..HandleSet::from([Handle::new("a", Region::Component(1)).soft(1.0 / 3.0)])
    }
}

fn unusual_settings() -> SolveSettings {
    SolveSettings {
        quality: Quality {
            tolerance: None,
            max_error: Some(1.0 / 3.0),
            refine: Some(0),
            smoothing: 1.0 / 3.0,
            keeps_volume: false,
        },
        method: Method::Diffusion,
        fits: FitOrder::GraphAlone,
        recipe: Recipe::AsTheyCome,
        gradients: false,
        contact: Contact::Avoided {
            clearance: Some(1.0 / 3.0),
        },
    }
}

fn unusual_chain(poses: &HandlePoses) -> PoseChain {
    let pose = PoseRecipe {
        poses: poses.clone(),
        settings: unusual_settings(),
    };
    PoseChain {
        starts: vec![PoseRecipe::default(), pose.clone()],
        pose,
    }
}

/// No request can ask for it: a default stands where nothing is given.
fn unasked_chain(poses: &HandlePoses) -> PoseChain {
    let settings = SolveSettings {
        quality: Quality {
            tolerance: None,
            ..Quality::default()
        },
        method: Method::SpatialRbf,
        ..SolveSettings::default()
    };
    PoseChain {
        starts: Vec::new(),
        pose: PoseRecipe {
            poses: poses.clone(),
            settings,
        },
    }
}

fn commits() -> Vec<LoggedCommit> {
    let third = 1.0 / 3.0;
    let pose = HandlePose {
        scale: Some(HandleScale::Uniform(third)),
        pivot: Some(DVec3::splat(third)),
        free_rotation: true,
        ..HandlePose::translation([third, -0.0, 1e-300])
    };
    let targets = VertexTargets::of([[0.1, -0.0, 3.0e38]]).weighted([0.3]);
    let poses = HandlePoses(vec![pose, HandlePose::default(), HandlePose::targets(targets)].into());
    let probe = ShapeProbe::of(&[DVec3::splat(third); 40]);
    let weld = pb::EditRequest {
        on: pb::edit_request::On::Rest.into(),
        operation: Some(pb::edit_request::Operation::Weld(pb::edit_request::Weld {
            tolerance: third,
        })),
        ..Default::default()
    };
    let turn = pb::FoundTurn {
        id: "a".into(),
        rotation_vector: vec![0.0, third, 7.0],
    };
    vec![
        LoggedCommit::Create { facts: facts() },
        LoggedCommit::Handles {
            set: handle_set(),
            poses: poses.clone(),
            facts: facts(),
        },
        LoggedCommit::Pose {
            chain: unusual_chain(&poses),
            warnings: vec![pb::Warning {
                code: "a".into(),
                message: "b".into(),
                r#where: "c".into(),
                ..Default::default()
            }],
            found_turns: vec![turn.clone()],
            probe: probe.clone(),
            frame: Some(Box::new(AnsweredFrame {
                header: pb::Frame {
                    seq: 7,
                    found_turns: vec![turn],
                    r#final: true,
                    residual: third,
                    solve_ms: 1.0,
                    quality: Some(Default::default()),
                    ..Default::default()
                },
                output: FrameOutput {
                    normals: true,
                    changed_only: Some(0.0),
                    encoding: FrameEncoding::Meshopt,
                    ..FrameOutput::default()
                },
            })),
        },
        LoggedCommit::Pose {
            chain: unasked_chain(&poses),
            warnings: Vec::new(),
            found_turns: Vec::new(),
            probe: probe.clone(),
            frame: None,
        },
        LoggedCommit::Edit {
            edit: Box::new(session_edit(&weld).expect("an edit")),
            files: Some(FileReferences {
                name: "x".into(),
                main: "y".into(),
                companions: [("k".to_owned(), "z".to_owned())].into(),
            }),
            report: Box::new(pb::EditResult {
                handles_kept: vec!["a".into()],
                curve: vec![1, 2],
                deviation: 0.25,
                digest: "d".into(),
                repaired: true,
                ..pb::EditResult::default()
            }),
            poses,
            facts: facts(),
            probe,
        },
        LoggedCommit::Step {
            target: u64::MAX,
            forward: true,
        },
    ]
}

#[test]
fn every_kind_of_commit_comes_back_as_it_was_written() {
    for commit in commits() {
        let again = LoggedCommit::read(&commit.write()).expect("it was written");
        assert_eq!(format!("{again:?}"), format!("{commit:?}"));
    }
}

#[test]
fn every_edit_comes_back_as_it_was_asked_for() {
    let region = r#"{"sphere": {"center": [1, 2, 3], "radius": 0.25}}"#;
    let texts = [
        r#"{"cut": {"plane": {"normal": [0, 0, 1], "offset": 0.5}, "keep": "ABOVE", "fill": true}}"#.to_owned(),
        r#"{"on": "REST", "cut": {"polyline": [0, 0, 0, 1, 0, 0, 1, 1, 0], "closed": true, "keep": "BELOW"}}"#.into(),
        r#"{"cut": {"path": [4, 5, 9]}}"#.into(),
        format!(r#"{{"subdivide": {{"region": {region}, "scheme": "MIDPOINT"}}}}"#),
        r#"{"subdivide": {}}"#.into(),
        r#"{"subdivide": {"auto": true}}"#.into(),
        r#"{"subdivide": {"creaseDegrees": 30, "creases": [1, 2, 2, 7], "creasePrimitives": true, "sharpness": 0.5}}"#
            .into(),
        format!(r#"{{"decimate": {{"ratio": 0.3, "region": {region}}}}}"#),
        format!(r#"{{"delete": {{"fill": true, "region": {region}}}}}"#),
        format!(r#"{{"fill": {{"region": {region}}}}}"#),
        r#"{"fill": {}}"#.into(),
        format!(r#"{{"remesh": {{"edgeLength": 0.1, "region": {region}}}}}"#),
        r#"{"remesh": {"auto": true}}"#.into(),
        r#"{"remesh": {"auto": true, "maxDeviation": 0.01, "sharpDegrees": 25}}"#.into(),
        r#"{"smooth": {}}"#.into(),
        format!(
            r#"{{"smooth": {{"kind": "RELAX", "iterations": 3, "strength": 0.25, "sharpDegrees": 30, "region": {region}}}}}"#
        ),
        r#"{"merge": {"session": "x", "how": "LOOSE", "tolerance": 0.1, "format": "obj"}}"#.into(),
        r#"{"merge": {"session": "x", "how": "STITCH", "transform": [1,0,0,0, 0,2,0,0, 0,0,3,0, 4,5,6,1]}}"#.into(),
        r#"{"insertCurve": {"points": [0, 0, 0, 1, 0, 0], "closed": false}}"#.into(),
        r#"{"weld": {"tolerance": 0.001}}"#.into(),
        r#"{"wrap": {"session": "x", "format": "off", "inPlace": true, "mask": {"sphere": {"center": [0, 0, 0], "radius": 1}}}}"#.into(),
        r#"{"wrap": {"session": "x", "landmarks": [{"name": "nose", "ownVertex": 0, "targetPoint": [1, 2, 3]}, {"ownPoint": [0, 0, 1], "targetVertex": 7}]}}"#
            .into(),
    ];
    for text in texts {
        let request: pb::EditRequest = crate::json::from_json(text.as_bytes()).expect(&text);
        let mut edit = session_edit(&request).expect(&text);
        edit.other_session = None;
        let commit = LoggedCommit::Edit {
            edit: Box::new(edit),
            files: None,
            report: Box::default(),
            poses: HandlePoses::default(),
            facts: facts(),
            probe: ShapeProbe::default(),
        };
        let again = LoggedCommit::read(&commit.write()).expect(&text);
        assert_eq!(format!("{again:?}"), format!("{commit:?}"), "{text}");
    }
}

#[test]
fn a_probe_distinguishes_shapes() {
    let shape: Vec<DVec3> = (0..100).map(|k| DVec3::splat(f64::from(k))).collect();
    let probe = ShapeProbe::of(&shape);
    assert!(probe.is_close_to(&shape, 0.0));
    let mut moved = shape.clone();
    moved.iter_mut().for_each(|p| p.x += 1e-6);
    assert!(probe.is_close_to(&moved, 2e-6) && !probe.is_close_to(&moved, 1e-7));
    moved.pop();
    assert!(!probe.is_close_to(&moved, 1.0), "another number of vertices");
    moved[0].y = f64::NAN;
    moved.push(DVec3::splat(99.0));
    assert!(!probe.is_close_to(&moved, 1.0), "no number");
    assert!(ShapeProbe::of(&[]).is_close_to(&[], 0.0));
}

proptest! {
    /// Whatever a disk holds, reading it ends with a commit or an error.
    #[test]
    fn no_bytes_break_the_reader(which in 0usize..6, at: prop::sample::Index, to: u8, cut: prop::sample::Index) {
        let mut bytes = commits()[which].write();
        let k = at.index(bytes.len());
        bytes[k] = to;
        let _ = LoggedCommit::read(&bytes);
        bytes.truncate(cut.index(bytes.len() + 1));
        let _ = LoggedCommit::read(&bytes);
    }
}

#[test]
fn a_record_from_before_borders_were_smooth_is_solved_as_it_was() {
    // Field 8 was a bool.
    for (bytes, recipe) in [
        (&[][..], Recipe::AsTheyCome),
        (&[0x40, 1], Recipe::Unbuckled),
        (&[0x40, 2], Recipe::SmoothBorders),
    ] {
        let message = SettingsMessage::decode(bytes).expect("a record");
        assert_eq!(recorded_settings(&message).expect("settings").recipe, recipe);
    }
    let unknown = SettingsMessage::decode(&[0x40, 9][..]).expect("a record");
    assert!(matches!(recorded_settings(&unknown), Err(Error::Invalid { field, .. }) if field == "settings.recipe"));
}

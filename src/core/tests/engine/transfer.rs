//! Blend shapes and poses of one model on another.

use crate::surface_files::{Surface, file_of};
use glam::{DMat4, DQuat, DVec3, Vec3};
use pliant_core::asset::{
    BlendClip, BlendShape, BlendShapes, ChannelInterpolation, FileSet, Format, Limits, Model, sample, shapes,
};
use pliant_core::engine::{Deformer, DeformerLimits, Error, OpenOptions, OtherModel, TransferCommand, Transferred};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::{CancelFlag, Silent};

fn read(files: FileSet) -> Model {
    Model::read(files, None, &Limits::default()).expect("a model")
}

/// Long, wide and high by different amounts, with a nose and a pair of ears that say which way it looks.
fn head(p: DVec3) -> DVec3 {
    let bump = |at: DVec3, height: f64| height * libm::exp(-p.distance_squared(at.normalize()) / 0.06);
    let ears = bump(DVec3::new(0.5, 0.7, 0.8), 0.3) + bump(DVec3::new(0.5, 0.7, -0.8), 0.3);
    p * DVec3::new(1.6, 1.0, 0.8) * (1.0 + bump(DVec3::new(1.0, 0.3, 0.0), 0.4) + ears)
}

/// Another head: thicker, and bent.
fn other(p: DVec3) -> DVec3 {
    let p = p * DVec3::new(1.1, 1.0, 1.2);
    p + DVec3::Y * (0.1 * p.x * p.x)
}

/// Where the other head stands, and how large it is.
fn elsewhere() -> DMat4 {
    let turn = DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(-0.2);
    DMat4::from_scale_rotation_translation(DVec3::splat(40.0), turn, DVec3::new(300.0, -80.0, 20.0))
}

/// What shapes do around a place of the unit sphere: nothing beyond a distance.
fn pull(p: DVec3, at: DVec3, reach: f64, by: DVec3) -> DVec3 {
    let off = p.distance(at.normalize()) / reach;
    by * f64::powi((1.0 - off * off).max(0.0), 3)
}

const SHAPES: [(&str, f64); 2] = [("brow up", 0.4), ("mouth wide", 0.6)];

fn moves(k: usize, p: DVec3) -> DVec3 {
    match k {
        0 => pull(p, DVec3::new(1.0, 0.5, 0.3), SHAPES[0].1, DVec3::new(0.02, 0.12, 0.0)),
        _ => pull(p, DVec3::new(1.0, -0.4, 0.0), SHAPES[1].1, DVec3::new(0.05, -0.1, 0.1)),
    }
}

/// The head with its shapes and a clip of them, as a GLB.
fn source() -> (Surface, FileSet) {
    let (round, triangles) = shapes::icosphere(1.0, 4);
    let surface = (round.iter().map(|p| head(*p)).collect(), triangles);
    let shape = |k: usize| BlendShape {
        name: SHAPES[k].0.into(),
        moves: round.iter().map(|p| moves(k, *p).as_vec3()).collect(),
        weight: 0.25 * k as f32,
    };
    let clip = BlendClip {
        name: "talk".into(),
        times: vec![0.0, 0.5],
        interpolation: ChannelInterpolation::Linear,
        weights: vec![(0, vec![0.0, 1.0]), (1, vec![1.0, 0.5])],
    };
    let all = BlendShapes {
        shapes: vec![shape(0), shape(1)],
        clips: vec![clip],
        ..BlendShapes::default()
    };
    let written = read(file_of(&surface)).write_blend_shapes(&all).expect("a GLB");
    (surface, written.into_files("head.glb"))
}

fn of_files(files: FileSet) -> OtherModel {
    OtherModel {
        files,
        ..OtherModel::default()
    }
}

fn transfer(target: FileSet, source: FileSet, shape: Option<FileSet>) -> Result<Transferred, Error> {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = Deformer::open(target, &OpenOptions::default(), &DeformerLimits::default(), &exec)?;
    let command = TransferCommand {
        source: of_files(source),
        shape: shape.map(of_files),
        fit: None,
        landmarks: Vec::new(),
        format: None,
    };
    deformer.transfer(deformer.rest(), &command, &exec)
}

#[test]
fn on_the_same_triangles_shapes_turn_and_grow_with_the_head_and_what_stays_stays() {
    let ((points, triangles), files) = source();
    let placed = points.iter().map(|p| elsewhere().transform_point3(*p)).collect();
    let came = transfer(file_of(&(placed, triangles)), files.clone(), None).expect("shapes");
    assert!(came.report.wrap.is_none(), "nothing is wrapped");
    let (was, now) = (read(files), read(came.files.into_files("out.glb")));
    let (was, now) = (was.blend_shapes().expect("shapes"), now.blend_shapes().expect("shapes"));
    assert_eq!(now.clips, was.clips);
    for (was, now) in was.shapes.iter().zip(&now.shapes) {
        assert_eq!((&now.name, now.weight), (&was.name, was.weight));
        for (was, now) in was.moves.iter().zip(&now.moves) {
            let wanted = elsewhere().transform_vector3(was.as_dvec3());
            assert!(wanted.distance(now.as_dvec3()) < 0.01, "{wanted} {now}");
            assert!(*was != Vec3::ZERO || *now == Vec3::ZERO, "{now}");
        }
    }
}

#[test]
fn on_another_head_shapes_do_what_they_would_have_done_there() {
    let (round, triangles) = shapes::icosphere(1.0, 5);
    let turn = DQuat::from_rotation_z(0.3);
    let round: Vec<DVec3> = round.iter().map(|p| turn * *p).collect();
    let place = |p: DVec3| elsewhere().transform_point3(other(p));
    let target: Surface = (round.iter().map(|p| place(head(*p))).collect(), triangles);
    let came = transfer(file_of(&target), source().1, None).expect("shapes");
    let told = came.report.wrap.expect("it was wrapped");
    assert!(told.to_target.p95 < 2e-3, "{told:?}");
    let now = read(came.files.into_files("out.glb"));
    assert_eq!(now.triangles, target.1, "the model keeps its own surface");
    let now = now.blend_shapes().expect("shapes");
    for (k, facts) in came.report.shapes.iter().enumerate() {
        assert_eq!((facts.flipped_triangles, &*facts.name), (0, SHAPES[k].0));
        let truth = |p: &DVec3| place(head(*p) + moves(k, *p)) - place(head(*p));
        let largest = round.iter().map(|p| truth(p).length()).fold(0.0, f64::max);
        let mut off = 0.0;
        for (p, now) in round.iter().zip(&now.shapes[k].moves) {
            off += truth(p).distance_squared(now.as_dvec3()) / round.len() as f64;
            let middle = if k == 0 {
                DVec3::new(1.0, 0.5, 0.3)
            } else {
                DVec3::new(1.0, -0.4, 0.0)
            };
            let is_far = p.distance(middle.normalize()) > SHAPES[k].1 + 0.25;
            assert!(!is_far || *now == Vec3::ZERO, "{k}: {p} moves by {now}");
        }
        let all: f64 = round.iter().map(|p| truth(p).length_squared()).sum::<f64>() / round.len() as f64;
        assert!(
            off.sqrt() < 0.3 * all.sqrt(),
            "{k}: {} of {}, at most {largest}",
            off.sqrt(),
            all.sqrt()
        );
    }
}

#[test]
fn a_pose_comes_to_another_model_in_its_own_format() {
    let ((points, triangles), _) = source();
    let nod = |p: &DVec3| DQuat::from_rotation_z(0.2 * (p.x + 1.6)) * *p;
    let posed: Surface = (points.iter().map(nod).collect(), triangles.clone());
    let place = |p: &DVec3| elsewhere().transform_point3(other(*p));
    let target: Surface = (points.iter().map(place).collect(), triangles);
    let rest = file_of(&(points, target.1.clone()));
    let came = transfer(file_of(&target), rest.clone(), Some(file_of(&posed))).expect("a pose");
    assert_eq!(came.format, Format::OFF);
    let now = read(came.files.into_files("out.off"));
    let truth = |p: &DVec3| elsewhere().transform_point3(nod(&other(*p)));
    let (mut off, mut moved) = (0.0, 0.0);
    for ((p, rest), now) in source().0.0.iter().zip(&target.0).zip(&now.positions) {
        off += truth(p).distance(*now);
        moved += rest.distance(*now);
    }
    assert!(off < 0.25 * moved, "{off} of {moved}");

    let fewer = shapes::icosphere(1.0, 3);
    let refused = transfer(file_of(&target), rest, Some(file_of(&fewer))).expect_err("other triangles");
    assert!(
        matches!(&refused, Error::Invalid { field, .. } if field == "shape"),
        "{refused}"
    );
}

#[test]
fn a_skin_and_its_clips_stay_and_moves_are_those_of_the_rest_pose() {
    let figure = || FileSet::single("figure.glb", sample::figure_glb().to_vec());
    let model = read(figure());
    let low = model.positions.iter().map(|p| p.y).fold(f64::MAX, f64::min);
    let moves = model
        .positions
        .iter()
        .map(|p| Vec3::new(0.0, 0.0, (0.1 * (p.y - low).max(0.0)) as f32));
    let puff = BlendShape {
        name: "puff".into(),
        moves: moves.collect(),
        weight: 0.0,
    };
    let all = BlendShapes {
        shapes: vec![puff],
        ..BlendShapes::default()
    };
    let source = model.write_blend_shapes(&all).expect("a GLB").into_files("source.glb");
    let came = transfer(figure(), source, None).expect("shapes");
    let now = read(came.files.into_files("out.glb"));
    assert_eq!(now.joint_names(), model.joint_names());
    let clips = |model: &Model| model.moving_scene().expect("read").expect("a scene").clip_names;
    assert_eq!(clips(&now), clips(&model));
    let found = now.blend_shapes().expect("shapes");
    for (was, now) in all.shapes[0].moves.iter().zip(&found.shapes[0].moves) {
        assert!(was.distance(*now) < 2e-3, "{was} {now}");
    }
}

#[test]
fn clips_of_one_name_stay_apart_and_shapes_that_move_nothing_are_told() {
    let figure = || FileSet::single("figure.glb", sample::figure_glb().to_vec());
    let model = read(figure());
    let clips = |model: &Model| model.moving_scene().expect("read").expect("a scene").clip_names;
    let name = clips(&model).first().expect("a clip").clone();
    let shape = |name: &str, by: f32| BlendShape {
        name: name.into(),
        moves: vec![Vec3::new(0.0, by, 0.0); model.positions.len()],
        weight: 0.0,
    };
    let clip = |name: &str| BlendClip {
        name: name.into(),
        times: vec![0.0, 1.0],
        interpolation: ChannelInterpolation::Linear,
        weights: vec![(0, vec![0.0, 1.0])],
    };
    let all = BlendShapes {
        shapes: vec![shape("up", 0.1), shape("still", 0.0)],
        clips: vec![clip(&name), clip("own")],
        ..BlendShapes::default()
    };
    let source = model.write_blend_shapes(&all).expect("a GLB").into_files("source.glb");
    let came = transfer(figure(), source, None).expect("shapes");
    let told: Vec<_> = came
        .files
        .warnings
        .iter()
        .filter(|w| w.code == "shapes-move-nothing")
        .collect();
    assert!(
        told.len() == 1 && told[0].message.contains("1 of 2") && told[0].message.contains("\"still\""),
        "{told:?}"
    );
    let now = read(came.files.into_files("out.glb"));
    let mut expected = clips(&model);
    expected.extend([format!("{name} 2"), "own".to_owned()]);
    assert_eq!(clips(&now), expected);
}

#[test]
fn what_cannot_come_is_refused_by_its_field() {
    let (points, triangles) = shapes::icosphere(1.0, 3);
    let bare = || file_of(&(points.clone(), triangles.clone()));
    let refused = transfer(bare(), bare(), None).expect_err("no shapes");
    assert!(
        matches!(&refused, Error::Invalid { field, .. } if field == "model"),
        "{refused}"
    );
    let refused = transfer(bare(), FileSet::single("x", "solid"), None).expect_err("no model");
    assert!(
        matches!(&refused, Error::Invalid { field, .. } if field == "model"),
        "{refused}"
    );

    let pool = Pool::new(1).expect("a thread");
    let raised = CancelFlag::default();
    raised.cancel();
    let still = Exec::new(&pool, &Silent);
    let deformer = Deformer::open(bare(), &OpenOptions::default(), &DeformerLimits::default(), &still).expect("open");
    let command = TransferCommand {
        source: of_files(source().1),
        shape: None,
        fit: None,
        landmarks: Vec::new(),
        format: None,
    };
    let cancelled = deformer.transfer(deformer.rest(), &command, &Exec::new(&pool, &raised));
    assert!(matches!(cancelled, Err(Error::Cancelled)));
}

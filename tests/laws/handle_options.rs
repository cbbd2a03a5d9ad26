//! Every option of a handle with every other: what fits together is solved, the rest is refused with a reason.

use crate::support::bench;
use crate::support::messages::message;
use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits, Model, shapes};
use pliant::batch;
use pliant::deform::fit_rigid_motion;
use pliant::engine::{Deformer, DeformerLimits, Handle, HandleConstrains, HandlePose, Region, SolveSettings};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::pb;
use serde_json::{Value, json};

/// A bar along z, 4 long.
fn bar() -> bench::Shape {
    shapes::box_with_cells(DVec3::new(1.0, 1.0, 4.0), [2, 2, 10])
}

/// The options, each with all of its values; null where it is left out.
fn options() -> Value {
    let rest = bar().0;
    let upper = (0..).zip(&rest).filter(|(_, p)| p.z > 3.5).map(|(v, _)| v);
    let upper: Vec<usize> = upper.collect();
    let weights: Vec<f64> = rest.iter().map(|p| (p.z - 3.0).clamp(0.0, 1.0)).collect();
    json!({
        "constrains": [
            [], ["POSITION"], ["ROTATION"], ["SCALE"],
            ["POSITION", "ROTATION"], ["POSITION", "SCALE"], ["ROTATION", "SCALE"],
        ],
        "rigid": [false, true],
        "stiffness": [null, 0.05, 20],
        "falloff": [null, {"radius": 0.4, "kind": "LINEAR"}, {"radius": 0.4, "kind": "SMOOTH"}],
        "region": [
            {"halfSpace": {"normal": [0, 0, 1], "offset": 3.5}},
            {"sphere": {"center": [0.5, 0.5, 4], "radius": 0.9}},
            {"box": {"min": [-1, -1, 3.5], "max": [2, 2, 5]}},
            {"capsule": {"from": [0.5, 0.5, 3.5], "to": [0.5, 0.5, 4.2], "radius": 0.75}},
            {"tube": {"points": [0.5, 0.5, 3.5, 0.5, 0.5, 4.2], "radius": 0.75}},
            {"component": {"index": 0}},
            {"primitive": {"index": 0}},
            {"vertices": {"indices": upper}},
            {"weights": {"values": weights}},
        ],
        "pose": [
            {"translation": [0.6, 0, 0]},
            {"rotationVector": [0, 0.6, 0.3]},
            {"rotationVector": [0, 0.6, 0.3], "pivot": [0.5, 0.5, 2]},
            {"scale": [1.3]},
            {"translation": [0.2, 0.3, 0.2], "rotation": [0, 0.3, 0, 0.954], "scale": [1.1, 0.9, 1.2]},
        ],
        "symmetryPlane": [null, {"normal": [1, 0, 0], "offset": 0.5}],
        "regionOfInterest": [null, {"halfSpace": {"normal": [0, 0, 1], "offset": 1.5}}],
        "base": [{"id": "base", "region": {"halfSpace": {"normal": [0, 0, -1], "offset": -0.5}}}, null],
        "refine": [0, 4],
        "method": ["GRAPH", "SPATIAL_RBF"],
    })
}

/// Fields with values, without those that are null.
fn present(fields: &[(&str, &Value)]) -> Value {
    let given = fields.iter().filter(|(_, value)| !value.is_null());
    given
        .map(|(name, value)| ((*name).to_owned(), (*value).clone()))
        .collect()
}

/// Rows of values, by option, in which every value of every option meets every value of every other.
fn pairs(sizes: &[usize]) -> Vec<Vec<usize>> {
    let mut rows: Vec<Vec<usize>> = Vec::new();
    for (i, &first) in sizes.iter().enumerate() {
        for (j, &second) in sizes.iter().enumerate().skip(i + 1) {
            for (a, b) in (0..first).flat_map(|a| (0..second).map(move |b| (a, b))) {
                if rows.iter().any(|row| row[i] == a && row[j] == b) {
                    continue;
                }
                // What the pair leaves open goes round, so that new rows bring new pairs.
                let turn = rows.len();
                let mut row: Vec<usize> = (sizes.iter().enumerate())
                    .map(|(k, n)| (turn / (k + 1) + turn) % n)
                    .collect();
                (row[i], row[j]) = (a, b);
                rows.push(row);
            }
        }
    }
    rows
}

/// Why handles like these are refused; `None` when they must be solved.
fn reason_to_refuse(value: &dyn Fn(&str) -> Value) -> Option<&'static str> {
    let is_given = |name: &str| !value(name).is_null();
    if is_given("falloff") && !is_given("stiffness") && value("rigid") == true {
        return Some("rigid");
    }
    let constrains = value("constrains");
    let has_position = constrains == json!([]) || constrains[0] == "POSITION";
    let is_held = has_position || is_given("base") || is_given("regionOfInterest");
    (!is_held).then_some("POSITION")
}

#[test]
fn every_option_of_a_handle_goes_with_every_other_or_is_refused() {
    let options = options();
    let options = options.as_object().expect("fields");
    let values: Vec<(&String, &Vec<Value>)> = options.iter().filter_map(|(k, v)| Some((k, v.as_array()?))).collect();
    let sizes: Vec<usize> = values.iter().map(|o| o.1.len()).collect();
    let pool = Pool::new(2).expect("threads");
    let rest = bar().0;
    let (mut solved, mut refused, mut rigid) = (0, 0, 0);
    let limits = DeformerLimits::default();
    for row in pairs(&sizes) {
        let value = |name: &str| {
            let at = values.iter().position(|o| o.0 == name).expect("an option");
            values[at].1[row[at]].clone()
        };
        let of_top = ["region", "constrains", "rigid", "stiffness", "falloff"].map(|name| (name, value(name)));
        let mut top = present(&of_top.each_ref().map(|(name, value)| (*name, value)));
        top["id"] = "top".into();
        let handles: Vec<Value> = [top, value("base")].into_iter().filter(|h| !h.is_null()).collect();
        let text = present(&[
            ("handles", &handles.into()),
            ("symmetryPlane", &value("symmetryPlane")),
            ("regionOfInterest", &value("regionOfInterest")),
            (
                "steps",
                &json!([{"pose": {"handles": [{"id": "top", "pose": value("pose")}]}}]),
            ),
            (
                "options",
                &json!({"refine": value("refine"), "method": value("method")}),
            ),
        ]);
        let job: pb::Job = message(&text);
        let exec = Exec::new(&pool, &Silent);
        let done = batch::run(bench::obj(&bar()), &job, None, &limits, &exec, &|| 0.0);
        let done = match (done, reason_to_refuse(&value)) {
            (Ok(done), None) => done,
            (Ok(_), Some(reason)) => panic!("to be refused for {reason}: {text}"),
            (Err(reported), Some(reason)) => {
                assert!(reported.to_string().contains(reason), "{reported}: {text}");
                refused += 1;
                continue;
            }
            (Err(reported), None) => panic!("{reported}: {text}"),
        };
        let files = FileSet::single("bar.obj", done.written.main);
        let model = Model::read(files, Some(Format::OBJ), &Limits::default()).expect("it reads");
        let farthest = |p: &DVec3| p.distance(DVec3::new(0.5, 0.5, 2.0));
        let reach = model.positions.iter().map(farthest).fold(0.0, f64::max);
        assert!(reach < 8.0, "{reach} from the middle: {text}");
        assert!(model.positions.iter().all(|p| p.is_finite()), "{text}");
        solved += 1;
        // All regions hold what is above 3.55, as one body where they are rigid.
        let is_mirrored = !value("symmetryPlane").is_null();
        let held: Vec<usize> = (0..rest.len()).filter(|&v| rest[v].z > 3.55).collect();
        if value("rigid") == true && !is_mirrored {
            rigid += 1;
            for (a, b) in held.iter().zip(&held[1..]) {
                let (was, now) = (
                    rest[*a].distance(rest[*b]),
                    model.positions[*a].distance(model.positions[*b]),
                );
                assert!((was - now).abs() < 1e-5, "{was} has become {now}: {text}");
            }
        }
    }
    println!("{solved} solved, {refused} refused, {rigid} rigid");
    assert!(
        solved > 50 && refused > 10 && rigid > 10,
        "{solved} solved, {refused} refused, {rigid} rigid"
    );
}

/// The upper end of the bar after a pose of a rigid handle that leaves something open: its fitted motion.
fn motion_of_end(top: Handle, pose: HandlePose) -> (DVec3, DVec3) {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer: Deformer = bench::bench(&bar());
    let base = Handle::new("base", Region::half_space([0.0, 0.0, -1.0], -0.5));
    deformer.set_handles([base, top], &exec).expect("handles");
    let solved = deformer
        .commit([("top", pose)], &SolveSettings::default(), &exec)
        .expect("a pose");
    let end = |shape: &[DVec3]| -> Vec<DVec3> {
        let above = deformer.rest().iter().zip(shape).filter(|(p, _)| p.z > 3.5);
        above.map(|(_, x)| *x).collect()
    };
    let motion = fit_rigid_motion(&end(deformer.rest()), &end(&solved.positions));
    let moved = end(deformer.rest())
        .iter()
        .zip(end(&solved.positions))
        .map(|(p, x)| motion.map()(*p).distance(x))
        .fold(0.0, f64::max);
    assert!(moved < 1e-5, "the region keeps its shape, off by {moved}");
    (motion.rotation, motion.translation)
}

#[test]
fn a_rigid_region_that_is_dragged_turns_as_the_model_bends() {
    let top = Handle {
        rigid: true,
        constrains: HandleConstrains {
            position: true,
            rotation: false,
            scale: false,
        },
        ..Handle::new("top", Region::half_space([0.0, 0.0, 1.0], 3.5)).soft(0.05)
    };
    let (rotation, translation) = motion_of_end(top, HandlePose::translation([1.5, 0.0, -0.3]));
    assert!(rotation.y > 0.08 && rotation.y < 1.2, "turned by {rotation}");
    assert!(translation.x > 0.5, "moved by {translation}");
}

#[test]
fn a_rigid_region_that_is_turned_finds_its_place() {
    let top = Handle {
        rigid: true,
        constrains: HandleConstrains {
            position: false,
            rotation: true,
            scale: false,
        },
        ..Handle::new("top", Region::half_space([0.0, 0.0, 1.0], 3.5))
    };
    let turn = DVec3::new(0.0, 0.8, 0.0);
    let (rotation, translation) = motion_of_end(top, HandlePose::rotation(turn));
    assert!(rotation.distance(turn) < 1e-5, "turned by {rotation}");
    assert!(translation.x > 0.3, "moved by {translation}");
}

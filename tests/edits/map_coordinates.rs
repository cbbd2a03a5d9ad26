//! Models in map coordinates: millions from the origin, in doubles. Whatever is done to them comes out where the same model near the
//! origin does, in every format.

use glam::DVec3;
use pliant::asset::shapes::box_with_cells;
use pliant::asset::{FileSet, Format, Limits, Model};
use pliant::batch::{self, BatchOutcome};
use pliant::engine::DeformerLimits;
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::json::from_json;
use serde_json::{Value, json};
use std::fmt::Write;

/// A place in UTM coordinates, and one on the ellipsoid; neither fits 32-bit numbers.
const PLACES: [DVec3; 2] = [
    DVec3::new(523_417.25, 5_274_861.5, 412.1),
    DVec3::new(-1_288_734.3, -4_720_201.7, 4_080_013.9),
];

/// A bar, 0.4 by 4 by 0.4, with its middle at `place`. Numbers of 20 binary places make its two sides exactly alike: what lies between
/// equal places goes to either side otherwise, near the origin as well.
fn bar_at(place: DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let (positions, triangles) = box_with_cells(DVec3::new(0.4, 4.0, 0.4), [3, 24, 3]);
    let middle = (positions.iter().copied().reduce(DVec3::min)).unwrap_or_default() + DVec3::new(0.2, 2.0, 0.2);
    let even = |p: DVec3| (p * 1048576.0).round() / 1048576.0;
    (positions.iter().map(|p| even(*p - middle) + place).collect(), triangles)
}

/// The same bar with no two lengths alike, so that no decision between two hangs on the last digit of a place.
fn uneven_bar_at(place: DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let (positions, triangles) = bar_at(DVec3::ZERO);
    let shaken = |(k, p): (f64, &DVec3)| {
        let by = DVec3::new(libm::sin(1.7 * k), libm::sin(2.3 * k), libm::sin(3.1 * k));
        ((*p + 0.01 * by) * 1048576.0).round() / 1048576.0 + place
    };
    let numbered = (0..positions.len()).map(|k| k as f64).zip(&positions);
    (numbered.map(shaken).collect(), triangles)
}

fn text_of((positions, triangles): &(Vec<DVec3>, Vec<[u32; 3]>), format: Format) -> String {
    let mut text = String::new();
    let numbers = |p: &DVec3| format!("{} {} {}\n", p.x, p.y, p.z);
    let all = || positions.iter().map(numbers).collect::<String>();
    let faces = |start: &str, base: u32| {
        let face = |t: &[u32; 3]| format!("{start} {} {} {}\n", t[0] + base, t[1] + base, t[2] + base);
        triangles.iter().map(face).collect::<String>()
    };
    let (v, f) = (positions.len(), triangles.len());
    _ = match format.name() {
        "off" => write!(text, "OFF\n{v} {f} 0\n{}{}", all(), faces("3", 0)),
        "ply" => write!(
            text,
            "ply\nformat ascii 1.0\nelement vertex {v}\nproperty double x\nproperty double y\nproperty double z\nelement face \
             {f}\nproperty list uchar int vertex_indices\nend_header\n{}{}",
            all(),
            faces("3", 0)
        ),
        "stl" => {
            let facet = |t: &[u32; 3]| {
                let corners = t
                    .map(|v| format!("vertex {}", numbers(&positions[v as usize])))
                    .concat();
                format!("facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n")
            };
            write!(
                text,
                "solid bar\n{}endsolid bar\n",
                triangles.iter().map(facet).collect::<String>()
            )
        }
        _ => {
            let lines: String = positions.iter().map(|p| format!("v {}", numbers(p))).collect();
            write!(text, "{lines}{}", faces("f", 1))
        }
    };
    text
}

/// Edits that are looked at after a pose too.
const MAP_EDITS: [&str; 2] = ["smooth", "insertCurve"];

/// Edits of every kind that depends on places.
fn edits_at(place: DVec3) -> Vec<Value> {
    let curve = [DVec3::new(0.05, -1.0, 0.2), DVec3::new(-0.05, 1.0, 0.2)]
        .map(|p| (place + p).to_array())
        .concat();
    vec![
        json!({"subdivide": {"scheme": "LOOP"}}),
        json!({"decimate": {"ratio": 0.5}}),
        json!({"remesh": {"edgeLength": 0.2}}),
        json!({"cut": {"plane": {"normal": [0, 1, 0.1], "offset": place.y + 0.1 * place.z + 0.03}}}),
        json!({"smooth": {"iterations": 3}}),
        json!({"insertCurve": {"points": curve}}),
    ]
}

/// Every kind of step.
fn jobs_at(place: DVec3) -> Vec<Value> {
    let pose = json!({"pose": {"handles": [{"id": "top", "pose": {
        "rotationVector": [0, 0, -1.2], "pivot": (place + DVec3::Y * 2.0).to_array(), "translation": [1.1, -0.7, 0]
    }}]}});
    let handles = json!([
        {"id": "base", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": 1.5 - place.y}}},
        {"id": "top", "region": {"box": {"min": (place + DVec3::new(-1.0, 1.5, -1.0)).to_array(),
            "max": (place + DVec3::new(1.0, 2.5, 1.0)).to_array()}}},
    ]);
    let edits = edits_at(place);
    // What makes new places is looked at alone: a graph between them depends on their last digits, near the origin as well.
    let is_posed = |edit: &Value| {
        ["subdivide", "decimate", "cut"]
            .iter()
            .any(|kind| edit.get(kind).is_some())
    };
    // A shape that was posed there, which has the rounding of its place.
    let after = edits
        .clone()
        .into_iter()
        .filter(|edit| MAP_EDITS.iter().any(|kind| edit.get(kind).is_some()));
    let after: Vec<Value> = after.map(|edit| json!([pose.clone(), {"edit": edit}])).collect();
    let edited = edits.into_iter().map(|edit| match is_posed(&edit) {
        true => json!([{"edit": edit}, pose.clone()]),
        false => json!([{"edit": edit}]),
    });
    let steps = [
        json!([]),
        json!([pose.clone()]),
        json!([pose.clone(), {"edit": {"subdivide": {"scheme": "MIDPOINT"}}}]),
    ];
    let options = json!({"tolerance": 1e-6, "output": {"selfIntersections": true}});
    let job = |steps: Value| json!({"handles": handles.clone(), "steps": steps, "options": options.clone()});
    steps.into_iter().chain(edited).chain(after).map(job).collect()
}

fn run(place: DVec3, job: &Value, format: Format, to: Format, exec: &Exec<'_>) -> BatchOutcome {
    run_on(text_of(&bar_at(place), format), job, [format, to], exec)
}

fn run_on(text: String, job: &Value, [format, to]: [Format; 2], exec: &Exec<'_>) -> BatchOutcome {
    let files = FileSet::single(format!("bar.{format}"), text);
    let job = from_json(job.to_string().as_bytes()).expect("a job");
    let done = batch::run(files, &job, Some(to), &DeformerLimits::default(), exec, &|| 0.0);
    done.unwrap_or_else(|e| panic!("{format} to {to}: {e}"))
}

/// Where the vertices of the written file are.
fn written_places(done: &BatchOutcome, to: Format) -> Vec<DVec3> {
    let name = format!("out.{to}");
    let files = FileSet::single(name, done.written.main.clone());
    let model = Model::read(files, Some(to), &Limits::default()).expect("a model");
    model.geometry.positions.clone()
}

#[test]
fn a_model_far_away_comes_out_where_the_same_one_near_the_origin_does() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let near = jobs_at(DVec3::ZERO);
    let mut wrong = Vec::new();
    for (k, place) in PLACES.into_iter().enumerate() {
        for (n, (job, here)) in jobs_at(place).iter().zip(&near).enumerate() {
            // Each format with some of the steps, and all steps with one.
            let formats = [Format::OBJ, Format::OFF, Format::PLY, Format::STL];
            for format in formats.into_iter().filter(|f| *f == Format::OBJ || n < 3 && k == 0) {
                let outputs = [format, Format::GLB, Format::PLY];
                for to in outputs.into_iter().take(if n < 3 { 3 } else { 1 }) {
                    let what = format!("{format} to {to} at {place} with {}", job["steps"]);
                    let (far, expected) = (
                        run(place, job, format, to, &exec),
                        run(DVec3::ZERO, here, format, to, &exec),
                    );
                    let (far_places, places) = (written_places(&far, to), written_places(&expected, to));
                    assert_eq!(far_places.len(), places.len(), "{what}");
                    let off = far_places.iter().zip(&places).map(|(p, q)| (*p - place - *q).length());
                    let off = off.fold(0.0, f64::max);
                    if off >= 1e-3 {
                        wrong.push(format!("{what}: {off} off"));
                    }
                    // Coplanar neighbours may cross by the last digit of a rounded place, here or there.
                    let quality = |done: &BatchOutcome| done.report.quality.and_then(|q| q.self_intersections);
                    let crossings = [&far, &expected].map(|done| quality(done).unwrap_or_default());
                    if crossings[0].abs_diff(crossings[1]) > 4 {
                        wrong.push(format!("{what}: {crossings:?} crossings"));
                    }
                    let codes = |done: &BatchOutcome| done.written.warnings.iter().map(|w| w.code).collect::<Vec<_>>();
                    if codes(&far) != codes(&expected) {
                        wrong.push(format!("{what}: {:?}", codes(&far)));
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_edit_of_a_shape_posed_far_away_is_the_one_near_the_origin() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut wrong = Vec::new();
    for kind in 0..edits_at(DVec3::ZERO).len() {
        // The vertices, those of a line on the bar, and points beside it.
        let edited = |place: DVec3| -> Vec<DVec3> {
            let mut job = jobs_at(place).swap_remove(1);
            let steps = job["steps"].as_array_mut().expect("a list");
            steps.push(json!({"edit": edits_at(place)[kind]}));
            let beside = [DVec3::new(0.5, 1.9, 0.1), DVec3::new(-0.3, 0.2, 0.4)];
            let beside = beside.map(|p| (place + p).to_array()).concat();
            job["create"] = json!({"passengers": [{"points": {"positions": beside}}]});
            let bar = uneven_bar_at(place);
            let count = bar.0.len();
            let ends = [-1.5, 1.75].map(|y| place + DVec3::new(0.2, y, 0.0625));
            let line = ends.map(|p| format!("v {} {} {}\n", p.x, p.y, p.z)).concat();
            let text = format!("{}{line}l {} {}\n", text_of(&bar, Format::OBJ), count + 1, count + 2);
            let done = run_on(text, &job, [Format::OBJ; 2], &exec);
            let points = done.report.passengers[0].positions.as_chunks::<3>().0.iter();
            let points = points.map(|p| DVec3::from_array(*p));
            let places = written_places(&done, Format::OBJ);
            places.into_iter().chain(points).map(|p| p - place).collect()
        };
        let near = edited(DVec3::ZERO);
        for place in PLACES {
            let far = edited(place);
            let off = far.iter().zip(&near).map(|(p, q)| p.distance(*q)).fold(0.0, f64::max);
            if far.len() != near.len() || off > 1e-6 {
                wrong.push(format!(
                    "{}: {off} off, {} of {}",
                    edits_at(place)[kind],
                    far.len(),
                    near.len()
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn what_has_to_round_says_by_how_much() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let [place, _] = PLACES;
    let told = |done: &BatchOutcome| {
        let rounded = done.written.warnings.iter().filter(|w| w.code == "places-rounded");
        rounded.map(|w| w.message.clone()).collect::<Vec<_>>()
    };
    let job = &jobs_at(place)[1];
    let stl = told(&run(place, job, Format::OBJ, Format::STL, &exec));
    assert!(stl.len() == 1 && stl[0].contains("e-1 off"), "{stl:?}");
    let near = told(&run(
        DVec3::ZERO,
        &jobs_at(DVec3::ZERO)[1],
        Format::OBJ,
        Format::STL,
        &exec,
    ));
    assert!(near.is_empty(), "{near:?}");
}

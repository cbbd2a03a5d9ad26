//! Files as users have them, each with its right answer from `field/README.md` of the data folder: bent, and compared with it.

use crate::support::data::{data_bytes, data_path};
use crate::support::gltf_parsed::parse;
use crate::support::skinning::draw;
use glam::DVec3;
use pliant::asset::{FileSet, Limits, Model, missing_companions};
use pliant::batch::{self, BatchOutcome};
use pliant::engine::DeformerLimits;
use pliant::exec::Exec;
use pliant::mesh::query::TriangleBvh;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::json::from_json;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// The bend of bars and rods along y from 0 to 4.
pub(super) fn bend() -> Value {
    json!({"handles": [{"id": "base", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.5}}},
                       {"id": "top", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 3.5}}}],
           "steps": [{"pose": {"handles": [{"id": "top", "pose": {"rotationVector": [0, 0, -1.2], "translation": [1.1, -0.7, 0]}}]}}],
           "options": {"tolerance": 1e-6}})
}

pub(super) fn run(files: FileSet, job: &Value, exec: &Exec<'_>) -> BatchOutcome {
    let job = from_json(job.to_string().as_bytes()).expect("a job");
    batch::run(files, &job, None, &DeformerLimits::default(), exec, &|| 0.0).expect("it bends")
}

/// Bends a file of the folder: what it was, and what came of it. `None` without the data.
pub(super) fn bent(name: &str, exec: &Exec<'_>) -> Option<(Model, BatchOutcome)> {
    let files = FileSet::single(name, data_bytes(&format!("field/{name}"))?);
    let model = Model::read(files.clone(), None, &Limits::default()).expect("readable");
    Some((model, run(files, &bend(), exec)))
}

pub(super) fn farthest(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

#[test]
fn markers_of_a_bar_go_with_the_surface_around_them() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let Some((rest, done)) = bent("bar_markers.ply", &exec) else {
        return;
    };
    let mut used = vec![false; rest.positions.len()];
    rest.triangles
        .as_flattened()
        .iter()
        .for_each(|v| used[*v as usize] = true);
    let markers: Vec<usize> = (0..used.len()).filter(|v| !used[*v]).collect();
    assert_eq!(markers.len(), 100);
    let now = &done.positions;
    let places: Vec<f64> = markers.iter().flat_map(|v| rest.positions[*v].to_array()).collect();
    let mut job = bend();
    job["create"] = json!({"passengers": [{"points": {"positions": places}}]});
    let files = FileSet::single("bar.ply", data_bytes("field/bar_markers.ply").expect("there"));
    let as_points = run(files, &job, &exec).report.passengers[0].positions.clone();
    let carried = as_points.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p));
    let before = TriangleBvh::build(&rest.positions, &rest.triangles, &pool);
    let after = TriangleBvh::build(now, &rest.triangles, &pool);
    for (v, point) in markers.into_iter().zip(carried) {
        assert!(now[v].distance(point) < 1e-9, "vertex {v}: {} for {point}", now[v]);
        let distance = |surface: &TriangleBvh<'_>, place| surface.closest_point(place).expect("a surface").distance;
        let (was, is) = (distance(&before, rest.positions[v]), distance(&after, now[v]));
        assert!(
            (was - is).abs() < 0.03,
            "vertex {v} was {was} off the surface and is {is}"
        );
    }
}

#[test]
fn three_skins_over_joints_in_other_orders_are_drawn_where_the_shape_says() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let Some((rest, done)) = bent("three_skins.glb", &exec) else {
        return;
    };
    let drawn = draw(&parse(&done.written.main, &BTreeMap::new()), None, &[]).expect("not compressed");
    let drawn: Vec<DVec3> = drawn.into_iter().flat_map(|primitive| primitive.positions).collect();
    assert_eq!(drawn.len(), done.positions.len());
    assert!(farthest(&drawn, &done.positions) < 2e-6);
    assert!(farthest(&rest.positions, &done.positions) > 1.0, "it has moved");
}

/// The words behind the place of each vertex row, and the face rows.
fn rows_of(text: &[u8]) -> (Vec<Vec<String>>, Vec<String>) {
    let text = std::str::from_utf8(text).expect("text");
    let mut rows = text.lines().filter(|line| !line.trim().is_empty()).skip(1);
    let counts: Vec<usize> = (rows.next().expect("counts").split_whitespace())
        .map(|word| word.parse().expect("a count"))
        .collect();
    let behind = |row: &str| row.split_whitespace().skip(3).map(str::to_owned).collect();
    let vertices = rows.by_ref().take(counts[0]).map(behind).collect();
    let words = |row: &str| row.split_whitespace().collect::<Vec<_>>().join(" ");
    (vertices, rows.take(counts[1]).map(words).collect())
}

#[test]
fn colours_and_normals_of_off_files_stay_on_their_rows() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    for name in [
        "bar_coff_float.off",
        "bar_off_colours_unsaid.off",
        "bar_face_colours_float.off",
        "bar_noff.off",
    ] {
        let Some((rest, done)) = bent(name, &exec) else { return };
        let (was, is) = (rows_of(&rest.files.main), rows_of(&done.written.main));
        assert_eq!(was.1, is.1, "{name}: faces with their colours");
        if name != "bar_noff.off" {
            assert_eq!(was.0, is.0, "{name}: colours of vertices");
            continue;
        }
        let smooth = |positions: &[DVec3]| pliant::mesh::shading::smooth_normals(positions, &rest.triangles);
        let (before, after) = (smooth(&rest.positions), smooth(&done.positions));
        let number = |word: &String| word.parse::<f32>().expect("a number");
        let normal = |row: &[String]| glam::Vec3::from_slice(&row.iter().map(number).collect::<Vec<_>>());
        let mut turned = 0.0f32;
        for (v, (was, is)) in was.0.iter().zip(&is.0).enumerate() {
            let (was, is) = (normal(was), normal(is));
            assert!((is.length() - 1.0).abs() < 1e-5, "row {v}: {is}");
            let angles = [was.angle_between(before[v]), is.angle_between(after[v])];
            assert!(
                (angles[0] - angles[1]).abs() < 0.05,
                "row {v}: {angles:?} from the surface"
            );
            turned = turned.max(was.angle_between(is));
        }
        assert!(turned > 1.0, "the top turns by 1.2: {turned}");
    }
}

#[test]
fn no_point_of_a_sleeve_comes_inside_the_arm() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let Some((rest, done)) = bent("arm_and_sleeve.glb", &exec) else {
        return;
    };
    let [arm, sleeve] = &rest.primitives[..] else {
        panic!("two primitives")
    };
    let (of_arm, _) = rest.triangles.split_at(arm.index_count as usize / 3);
    let surface = TriangleBvh::build(&done.positions, of_arm, &pool);
    for vertex in sleeve.vertices() {
        let place = done.positions[vertex];
        let at = surface.closest_point(place).expect("a surface");
        let [a, b, c] = of_arm[at.triangle as usize].map(|v| done.positions[v as usize]);
        let out = (b - a).cross(c - a).normalize().dot(place - at.point);
        assert!(
            out > 0.0 && at.distance < 0.01,
            "vertex {vertex} is {out} outside, {} away",
            at.distance
        );
    }
}

#[test]
fn files_of_any_name_are_found_and_named_alike() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let Some(folder) = data_path("names of files", "field/names") else {
        return;
    };
    for (name, companions) in [("bär 1.gltf", 3), ("bär 2.obj", 2)] {
        let read = |name: &str| std::fs::read(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let mut files = FileSet::single(name, read(name));
        // A library's name with blanks may be several names: what there is of them is taken.
        loop {
            let there = |name: &String| folder.join(name).is_file();
            let found: Vec<String> = missing_companions(&files).into_iter().filter(there).collect();
            if found.is_empty() {
                break;
            }
            for name in found {
                let bytes = read(&name);
                files.companions.insert(name, bytes.into());
            }
        }
        assert_eq!(files.companions.len(), companions, "{:?}", files.companions.keys());
        let done = run(files.clone(), &bend(), &exec);
        let names = |list: &mut dyn Iterator<Item = &String>| list.cloned().collect::<Vec<_>>();
        assert_eq!(
            names(&mut done.written.companions.keys()),
            names(&mut files.companions.keys()),
            "{name}"
        );
        let written = FileSet {
            name: name.into(),
            main: done.written.main.clone().into(),
            companions: done
                .written
                .companions
                .clone()
                .into_iter()
                .map(|(n, b)| (n, b.into()))
                .collect(),
        };
        let again = Model::read(written, None, &Limits::default()).expect("readable");
        let images = again.drawn().expect("a look").look.images;
        assert!(
            !images.is_empty() && images.iter().all(Result::is_ok),
            "{name}: {images:?}"
        );
        let off = farthest(&again.positions, &done.positions);
        assert!(off < 1e-6, "{name}: {off}");
    }
}

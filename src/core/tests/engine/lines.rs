//! Points and lines through edits: they stay on the surface, are cut with it, and turn with it.

use glam::DVec3;
use pliant_core::asset::{FileSet, Format, shapes};
use pliant_core::edit::{KeptSide, SubdivisionScheme};
use pliant_core::engine::{
    Creases, CutLine, Deformer, DeformerLimits, Edit, EditCommand, EditOutcome, EditedShape, Handle, HandlePose,
    OpenOptions, Plane, Region, RemeshCommand, SmoothCommand, SolveSettings, shading,
};
use pliant_core::exec::Exec;
use pliant_core::mesh::query::TriangleBvh;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

type Shape = (Vec<DVec3>, Vec<[u32; 3]>);

/// A closed tube along y, from 0 to 3.
fn tube() -> Shape {
    let (points, faces) = shapes::cylinder(0.5, 3.0, 12, 9, true);
    (points.iter().map(|p| DVec3::new(p.y, p.z, p.x)).collect(), faces)
}

/// A glTF of the tube and of a primitive of `mode` between points, with normals along x.
fn with_drawn(mode: u64, drawn: &[DVec3], indices: &[u32]) -> FileSet {
    let (points, faces) = tube();
    let mut buffer: Vec<u8> = Vec::new();
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    let mut add = |bytes: Vec<u8>, kind: String| {
        let (first, size) = (buffer.len(), bytes.len());
        buffer.extend(bytes);
        accessors.push(format!(r#"{{"bufferView":{},{kind}}}"#, views.len()));
        views.push(format!(r#"{{"buffer":0,"byteOffset":{first},"byteLength":{size}}}"#));
    };
    let mut add_vectors = |list: &[DVec3]| {
        let text = |p: DVec3| format!("[{},{},{}]", p.x as f32, p.y as f32, p.z as f32);
        let low = text(list.iter().fold(list[0], |a, p| a.min(*p)));
        let high = text(list.iter().fold(list[0], |a, p| a.max(*p)));
        let bytes = list
            .iter()
            .flat_map(|p| p.as_vec3().to_array())
            .flat_map(f32::to_le_bytes);
        let count = list.len();
        add(
            bytes.collect(),
            format!(r#""componentType":5126,"count":{count},"type":"VEC3","min":{low},"max":{high}"#),
        );
    };
    add_vectors(&points);
    add_vectors(drawn);
    add_vectors(&vec![DVec3::X; drawn.len()]);
    for list in [faces.as_flattened(), indices] {
        let kind = format!(r#""componentType":5125,"count":{},"type":"SCALAR""#, list.len());
        add(list.iter().flat_map(|v| v.to_le_bytes()).collect(), kind);
    }
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"uri":"a.bin","byteLength":{}}}],"bufferViews":[{}],"accessors":[{}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":3}},{{"attributes":{{"POSITION":1,"NORMAL":2}},"indices":4,"mode":{mode}}}]}}],"nodes":[{{"mesh":0}}],"scenes":[{{"nodes":[0]}}],"scene":0}}"#,
        buffer.len(),
        views.join(","),
        accessors.join(",")
    );
    let mut files = FileSet::single("model.gltf", json);
    files.companions.insert("a.bin".into(), buffer.into());
    files
}

/// The model as a written glTF has it.
fn written_and_opened(deformer: &Deformer, exec: &Exec<'_>) -> Deformer {
    let written = deformer.write(deformer.rest(), Format::GLTF, exec).expect("written");
    let files = FileSet {
        name: "written.gltf".into(),
        main: written.main.into(),
        companions: written.companions.into_iter().map(|(n, b)| (n, b.into())).collect(),
    };
    open(files, exec)
}

fn open(files: FileSet, exec: &Exec<'_>) -> Deformer {
    Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), exec).expect("opened")
}

fn edit(deformer: &mut Deformer, edit: &Edit, exec: &Exec<'_>) -> EditOutcome {
    let (shape, poses) = (deformer.rest_shape(), deformer.initial_poses());
    let command = EditCommand {
        edit,
        on: EditedShape::Current,
        shape: &shape,
        poses: &poses,
        settings: None,
    };
    deformer.edit(&command, exec).expect("edited")
}

/// Where the vertices of the last primitive are, and the farthest of them from the surface of the first.
fn drawn_places(deformer: &Deformer, exec: &Exec<'_>) -> (Vec<DVec3>, f64) {
    let primitives = deformer.facts().primitives;
    let rest = deformer.rest();
    let surface = TriangleBvh::build(rest, &deformer.geometry().triangles, exec.pool);
    let drawn: Vec<DVec3> = primitives.last().expect("two").vertices().map(|v| rest[v]).collect();
    let off = drawn.iter().map(|p| surface.closest_point(*p).expect("faces").distance);
    (drawn.clone(), off.fold(0.0, f64::max))
}

#[test]
fn lines_and_points_stay_on_the_surface_through_edits() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (points, faces) = tube();
    // Corners, middles of edges and middles of faces.
    let middles = faces.iter().map(|f| f.map(|v| points[v as usize]));
    let drawn: Vec<DVec3> = (points.iter().copied())
        .chain(middles.flat_map(|[a, b, c]| [(a + b) / 2.0, (a + b + c) / 3.0]))
        .collect();
    let indices: Vec<u32> = (0..drawn.len() as u32).collect();
    let subdivide = |scheme| Edit::Subdivide {
        region: None,
        scheme,
        creases: Creases::default(),
    };
    for (done, moves) in [
        (Edit::Smooth(SmoothCommand::default()), true),
        (subdivide(SubdivisionScheme::Loop), true),
        (subdivide(SubdivisionScheme::Midpoint), false),
        (
            Edit::Decimate {
                region: None,
                ratio: 0.15,
            },
            true,
        ),
        (
            Edit::Remesh(RemeshCommand {
                edge_length: Some(0.3),
                ..RemeshCommand::default()
            }),
            true,
        ),
    ] {
        let mut deformer = open(with_drawn(0, &drawn, &indices), &exec);
        let (before, off) = drawn_places(&deformer, &exec);
        assert!(off < 1e-6, "{off}");
        let warnings = edit(&mut deformer, &done, &exec).report.warnings;
        assert!(warnings.iter().all(|w| w.code != "loose-vertices-stay"), "{done:?}");
        let (after, off) = drawn_places(&deformer, &exec);
        assert!(off < 1e-6, "{done:?}: {off} off the surface");
        let far = before
            .iter()
            .zip(&after)
            .map(|(a, b)| a.distance(*b))
            .fold(0.0, f64::max);
        assert_eq!(far > 1e-3, moves, "{done:?}: {far}");
        assert!(far < 0.3, "{done:?}: {far}");
        if let Edit::Subdivide { .. } = done {
            // What was in the middle of an edge is where the edge has its new vertex.
            let rest = deformer.rest();
            let solid = deformer.facts().primitives[0].vertices();
            for (k, place) in after[points.len()..].iter().step_by(2).enumerate() {
                let near = rest[solid.clone()]
                    .iter()
                    .map(|p| p.distance(*place))
                    .fold(f64::MAX, f64::min);
                assert!(near < 1e-6, "edge {k}: {near}");
            }
        }
    }
}

#[test]
fn a_cut_ends_lines_at_its_plane() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    // Along the tube, away from it at the top, and one that the cut takes whole.
    let drawn = [0.2, 1.15, 2.8, 3.4].map(|y| DVec3::new(0.5, y, 0.0));
    for (mode, indices, segments) in [
        (1u64, vec![0u32, 1, 1, 2, 2, 3], 2),
        (3, vec![0, 1, 2, 3], 2),
        (2, vec![0, 1, 2, 3], 3),
    ] {
        let mut deformer = open(with_drawn(mode, &drawn, &indices), &exec);
        let cut = Edit::Cut {
            along: CutLine::Plane(Plane::new([0.0, 1.0, 0.0], 1.6)),
            keep: KeptSide::Below,
            fill: true,
            cap: None,
        };
        let report = edit(&mut deformer, &cut, &exec).report;
        assert!(
            report.warnings.iter().any(|w| w.code == "lines-cut"),
            "{:?}",
            report.warnings
        );
        let (places, _) = drawn_places(&deformer, &exec);
        let highest = places.iter().fold(0.0f64, |most, p| most.max(p.y));
        assert!(
            (highest - 1.6).abs() < 1e-6 && places.len() == segments + 1,
            "{places:?}"
        );
        let again = written_and_opened(&deformer, &exec);
        let (read, _) = drawn_places(&again, &exec);
        assert!(
            read.iter().zip(&places).all(|(a, b)| a.distance(*b) < 1e-6),
            "mode {mode}"
        );
        // And cut once more, from below.
        let mut deformer = again;
        let cut = Edit::Cut {
            along: CutLine::Plane(Plane::new([0.0, 1.0, 0.0], 1.3)),
            keep: KeptSide::Above,
            fill: true,
            cap: None,
        };
        edit(&mut deformer, &cut, &exec);
        let (places, _) = drawn_places(&deformer, &exec);
        assert!(
            places.iter().all(|p| p.y > 1.3 - 1e-6 && p.y < 1.6 + 1e-6),
            "{places:?}"
        );
        assert!(places.len() >= 2, "{places:?}");
    }
}

/// An OBJ of the tube and of a line through places of its own.
fn obj_with_line(drawn: &[DVec3]) -> FileSet {
    let (points, faces) = tube();
    let vertices = points
        .iter()
        .chain(drawn)
        .map(|p| format!("v {} {} {}\n", p.x, p.y, p.z));
    let faces = faces
        .iter()
        .map(|f| f.map(|v| v + 1))
        .map(|[a, b, c]| format!("f {a} {b} {c}\n"));
    let line: String = (0..drawn.len()).map(|k| format!(" {}", points.len() + k + 1)).collect();
    let text: String = vertices.chain(faces).collect();
    FileSet::single("tube.obj", format!("{text}l{line}\n"))
}

/// Between which heights the pieces of the lines of an OBJ reach, rising.
fn spans_of_lines(text: &str) -> Vec<[f64; 2]> {
    let numbers = |line: &str| -> Vec<f64> { line.split(' ').map(|n| n.parse().expect("a number")).collect() };
    let heights: Vec<f64> = text
        .lines()
        .filter_map(|l| l.strip_prefix("v "))
        .map(|l| numbers(l)[1])
        .collect();
    let lines = text.lines().filter_map(|l| l.strip_prefix("l ")).map(numbers);
    let ends = lines.map(|l| [l[0], l[l.len() - 1]].map(|v| heights[v as usize - 1]));
    let mut spans: Vec<[f64; 2]> = ends.map(|[a, b]| [a.min(b), a.max(b)]).collect();
    spans.sort_by(|a, b| a[0].total_cmp(&b[0]));
    spans
}

/// A line on the tube, along it.
fn line_along() -> (Vec<DVec3>, Vec<u32>) {
    (
        [0.2, 1.15, 2.8].map(|y| DVec3::new(0.5, y, 0.0)).to_vec(),
        vec![0, 1, 2],
    )
}

/// The curve around the tube at a height, of which the left is above.
fn around(height: f64) -> CutLine {
    let corner = |k: u32| {
        let (sine, cosine) = (f64::from(k) * std::f64::consts::FRAC_PI_4 + 0.2).sin_cos();
        [0.5 * cosine, height, -0.5 * sine]
    };
    CutLine::Polyline {
        points: (0..8).map(corner).map(DVec3::from_array).collect(),
        closed: true,
    }
}

#[test]
fn every_cut_ends_lines_where_it_ends_the_surface() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let plane = || CutLine::Plane(Plane::new([0.0, 1.0, 0.0], 1.6));
    for (along, what) in [(plane(), "a plane"), (around(1.6), "a curve")] {
        for keep in [KeptSide::Both, KeptSide::Above, KeptSide::Below] {
            let (drawn, indices) = line_along();
            let cut = Edit::Cut {
                along: along.clone(),
                keep,
                fill: true,
                cap: None,
            };
            let mut deformer = open(obj_with_line(&drawn), &exec);
            edit(&mut deformer, &cut, &exec);
            let written = deformer.write(deformer.rest(), Format::OBJ, &exec).expect("written");
            let spans = spans_of_lines(&String::from_utf8(written.main).expect("text"));
            // The curve runs a little beside its height where it is laid onto facets.
            let near = |a: f64, b: f64| (a - b).abs() < if what == "a plane" { 2e-6 } else { 0.05 };
            let (low, high) = ([0.2, 1.6], [1.6, 2.8]);
            let wanted: Vec<[f64; 2]> = match keep {
                KeptSide::Both => vec![low, high],
                KeptSide::Below => vec![low],
                KeptSide::Above => vec![high],
            };
            let is_right = spans.len() == wanted.len()
                && spans
                    .iter()
                    .zip(&wanted)
                    .all(|(s, w)| near(s[0], w[0]) && near(s[1], w[1]));
            assert!(is_right, "{what}, {keep:?}: {spans:?} for {wanted:?}");

            let mut deformer = open(with_drawn(3, &drawn, &indices), &exec);
            edit(&mut deformer, &cut, &exec);
            let again = written_and_opened(&deformer, &exec);
            let vertices = again.facts().primitives[1].vertices();
            assert_eq!(
                vertices.len(),
                if keep == KeptSide::Both {
                    5
                } else {
                    2 + usize::from(keep == KeptSide::Below)
                }
            );
            let normals = shading(again.geometry(), again.rest(), again.rest()).normals;
            for normal in &normals[vertices] {
                assert!(normal.distance(glam::Vec3::X) < 1e-5, "{what}, {keep:?}: {normal}");
            }
        }
    }
}

#[test]
fn both_halves_of_a_line_go_with_their_halves_of_the_surface() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (drawn, indices) = line_along();
    let half = |normal: [f64; 3], offset| Region::HalfSpace(Plane::new(normal, offset));
    // How far off the line's heights are after a cut that keeps both halves, and a pose that parts them.
    let off = |beside: f64, riders_keep_sides: bool| {
        let drawn: Vec<DVec3> = drawn.iter().map(|p| *p + DVec3::X * beside).collect();
        let options = OpenOptions {
            riders_keep_sides,
            ..OpenOptions::default()
        };
        let files = with_drawn(3, &drawn, &indices);
        let mut deformer = Deformer::open(files, &options, &DeformerLimits::default(), &exec).expect("opened");
        let cut = Edit::Cut {
            along: CutLine::Plane(Plane::new([0.0, 1.0, 0.0], 1.6)),
            keep: KeptSide::Both,
            fill: true,
            cap: None,
        };
        edit(&mut deformer, &cut, &exec);
        let handles = [
            Handle::new("low", half([0.0, -1.0, 0.0], -0.3)),
            Handle::new("high", half([0.0, 1.0, 0.0], 2.7)),
        ];
        deformer.set_handles(handles.to_vec(), &exec).expect("handles");
        let up = HandlePose::translation([0.0, 1.0, 0.0]);
        let solved = deformer
            .commit([("high", up)], &SolveSettings::default(), &exec)
            .expect("solved");
        let firsts = deformer.facts().primitives.last().expect("two").vertices();
        let mut heights: Vec<f64> = solved.positions[firsts].iter().map(|p| p.y).collect();
        heights.sort_by(f64::total_cmp);
        let wanted = [0.2, 1.15, 1.6, 2.6, 3.8];
        assert_eq!(heights.len(), wanted.len(), "{heights:?}");
        let off = heights.iter().zip(wanted).map(|(a, b)| (a - b).abs());
        off.fold(0.0, f64::max)
    };
    // On the surface, and beside it.
    for beside in [0.0, 0.2, 0.6] {
        let off = off(beside, true);
        assert!(off < 1e-3, "{beside} beside: {off}");
    }
    // Sessions of before have it between the halves.
    assert!(off(0.6, false) > 0.1);
}

#[test]
fn a_short_piece_of_a_line_is_no_small_model_far_away() {
    let pool = Pool::new(1).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let short = [1.9, 1.91].map(|y| DVec3::new(0.8, y, 0.0));
    let mut files = with_drawn(1, &short, &[0, 1]);
    let text = String::from_utf8(files.main.to_vec()).expect("text");
    let far = r#""nodes":[{"mesh":0,"translation":[523417,5274861,412]}]"#;
    files.main = text.replace(r#""nodes":[{"mesh":0}]"#, far).into();
    let deformer = open(files, &exec);
    let moved: Vec<DVec3> = deformer.rest().iter().map(|p| *p + DVec3::splat(0.1)).collect();
    assert!(moved[0].y > 5e6);
    let written = deformer.write(&moved, Format::GLTF, &exec).expect("written");
    let told: Vec<_> = written.warnings.iter().filter(|w| w.code == "places-rounded").collect();
    assert!(told.is_empty(), "{told:?}");
}

#[test]
fn vertices_that_no_line_draws_are_not_said_to_stay() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    // The line has all vertices of the tube, as one that shares them with its triangles, and draws one edge of the bottom.
    let (points, faces) = tube();
    let is_low = |f: &&[u32; 3]| f.iter().all(|&v| points[v as usize].y < 1.0);
    let face = faces.iter().find(is_low).expect("a low face");
    for (edges, said) in [(vec![face[0], face[1]], 0), (vec![], 1)] {
        let indices = if edges.is_empty() {
            (0..points.len() as u32).collect()
        } else {
            edges
        };
        let mode = if said == 0 { 1 } else { 0 };
        let mut deformer = open(with_drawn(mode, &points, &indices), &exec);
        let cut = Edit::Cut {
            along: CutLine::Plane(Plane::new([0.0, 1.0, 0.0], 1.6)),
            keep: KeptSide::Below,
            fill: true,
            cap: None,
        };
        let warnings = edit(&mut deformer, &cut, &exec).report.warnings;
        let stay = warnings.iter().filter(|w| w.code == "loose-vertices-stay");
        assert_eq!(stay.count(), said, "{warnings:?}");
    }
}

#[test]
fn normals_of_points_turn_with_the_pose() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let drawn = [0.01, 1.5, 2.9].map(|y| DVec3::new(0.5, y, 0.0));
    let mut deformer = open(with_drawn(0, &drawn, &[0, 1, 2]), &exec);
    let half = |normal: [f64; 3], offset| Region::HalfSpace(Plane::new(normal, offset));
    let handles = [
        Handle::new("low", half([0.0, -1.0, 0.0], -0.3)),
        Handle::new("high", half([0.0, 1.0, 0.0], 2.7)),
    ];
    deformer.set_handles(handles.to_vec(), &exec).expect("handles");
    // A quarter turn about the tube takes x to z.
    let turn = HandlePose::rotation([0.0, -std::f64::consts::FRAC_PI_2, 0.0]);
    let solved = deformer
        .commit([("high", turn)], &SolveSettings::default(), &exec)
        .expect("solved");
    let firsts = deformer.facts().primitives[1].vertices();
    let shown = shading(deformer.geometry(), deformer.rest(), &solved.positions).normals[firsts].to_vec();
    let written = deformer.write(&solved.positions, Format::GLTF, &exec).expect("written");
    let files = FileSet {
        name: "posed.gltf".into(),
        main: written.main.into(),
        companions: written.companions.into_iter().map(|(n, b)| (n, b.into())).collect(),
    };
    let again = open(files, &exec);
    let vertices = again.facts().primitives[1].vertices();
    let read = shading(again.geometry(), again.rest(), again.rest()).normals[vertices].to_vec();
    for normals in [shown, read] {
        assert!(normals[0].distance(glam::Vec3::X) < 0.05, "{normals:?}");
        assert!(normals[2].distance(glam::Vec3::Z) < 0.05, "{normals:?}");
        assert!(
            normals[1].dot(glam::Vec3::new(1.0, 0.0, 1.0).normalize()) > 0.9,
            "{normals:?}"
        );
    }
}

//! A surface is not its file's seams: a file that repeats each vertex for every triangle is edited as its welded twin is.

use super::edit_support::{Shape, cube, moved, sphere};
use crate::support::data::data_bytes;
use glam::{DMat4, DVec3};
use pliant::asset::{FileSet, Format, Limits, Model};
use pliant::deform::VolumeMode;
use pliant::edit::{KeptSide, SubdivisionScheme};
use pliant::engine::{
    CutLine, Deformer, DeformerLimits, Edit, EditReport, Handle, HandlePose, MergeJoin, ModelMerge, OpenOptions,
    OtherModel, Plane, Region, RemeshCommand, SmoothCommand, SmoothKind, SolveSettings,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

/// Numbers that every format holds, and points in the order in which triangles first name them: a soup's solver vertices are
/// numbered like that.
fn twin((positions, triangles): Shape) -> Shape {
    let (mut number, mut points) = (BTreeMap::new(), Vec::new());
    let mut renumbered = Vec::with_capacity(triangles.len());
    for t in &triangles {
        renumbered.push(t.map(|v| {
            *number.entry(v).or_insert_with(|| {
                points.push(positions[v as usize].as_vec3().as_dvec3());
                points.len() as u32 - 1
            })
        }));
    }
    (points, renumbered)
}

/// Three vertices for each triangle.
fn soup((positions, triangles): &Shape) -> Shape {
    let corners = triangles.iter().flatten().map(|&v| positions[v as usize]).collect();
    let count = triangles.len() as u32;
    (corners, (0..count).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
}

fn facet_normal(corners: [DVec3; 3]) -> DVec3 {
    (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize()
}

fn corners((positions, triangles): &Shape) -> Vec<[DVec3; 3]> {
    triangles.iter().map(|t| t.map(|v| positions[v as usize])).collect()
}

/// An OFF file; `normals` gives each vertex one.
fn off((positions, triangles): &Shape, normals: Option<&dyn Fn(usize) -> DVec3>) -> FileSet {
    let mut text = format!(
        "{}\n{} {} 0\n",
        if normals.is_some() { "NOFF" } else { "OFF" },
        positions.len(),
        triangles.len()
    );
    for (v, p) in positions.iter().enumerate() {
        write!(text, "{} {} {}", p.x, p.y, p.z).expect("a text");
        if let Some(n) = normals.map(|normal| normal(v)) {
            write!(text, " {} {} {}", n.x, n.y, n.z).expect("a text");
        }
        text.push('\n');
    }
    for [a, b, c] in triangles {
        writeln!(text, "3 {a} {b} {c}").expect("a text");
    }
    FileSet::single("shape.off", text.into_bytes())
}

/// A text STL of which the facets with a middle below `height` are the first solid.
fn text_stl(shape: &Shape, height: f64) -> FileSet {
    let mut text = String::new();
    for (name, low) in [("Lower half", true), ("UPPER", false)] {
        writeln!(text, "solid {name}").expect("a text");
        for t in corners(shape) {
            if ((t[0].y + t[1].y + t[2].y) / 3.0 < height) != low {
                continue;
            }
            let n = facet_normal(t);
            writeln!(text, "facet normal {} {} {}\nouter loop", n.x, n.y, n.z).expect("a text");
            t.iter()
                .for_each(|p| writeln!(text, "vertex {} {} {}", p.x, p.y, p.z).expect("a text"));
            text.push_str("endloop\nendfacet\n");
        }
        writeln!(text, "endsolid {name}").expect("a text");
    }
    FileSet::single("shape.stl", text.into_bytes())
}

fn binary_stl(shape: &Shape) -> FileSet {
    let mut bytes = vec![b' '; 80];
    bytes.extend((shape.1.len() as u32).to_le_bytes());
    for t in corners(shape) {
        let numbers = [facet_normal(t), t[0], t[1], t[2]].map(|p| p.as_vec3().to_array());
        bytes.extend(numbers.as_flattened().iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend([0, 0]);
    }
    FileSet::single("shape.stl", bytes)
}

/// An OBJ of loose triangles: a picture is mapped on it so that nothing differs at any place, and so are normals.
fn obj_soup(shape: &Shape) -> FileSet {
    let mut text = String::from("o shape\n");
    for p in soup(shape).0 {
        let n = p.normalize();
        writeln!(
            text,
            "v {} {} {}\nvt {} {}\nvn {} {} {}",
            p.x, p.y, p.z, p.x, p.y, n.x, n.y, n.z
        )
        .expect("a text");
    }
    for t in 0..shape.1.len() {
        let [a, b, c] = [1, 2, 3].map(|k| 3 * t + k);
        writeln!(text, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}").expect("a text");
    }
    FileSet::single("shape.obj", text.into_bytes())
}

fn ply_soup(shape: &Shape) -> FileSet {
    let (positions, triangles) = soup(shape);
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nproperty uchar red\n\
        property uchar green\nproperty uchar blue\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        positions.len(),
        triangles.len()
    );
    for p in positions {
        let red = (p.x * 20.0 + 100.0) as u8;
        writeln!(text, "{} {} {} {red} 7 9", p.x, p.y, p.z).expect("a text");
    }
    triangles
        .iter()
        .for_each(|[a, b, c]| writeln!(text, "3 {a} {b} {c}").expect("a text"));
    FileSet::single("shape.ply", text.into_bytes())
}

/// The same in a GLB.
fn glb(files: FileSet) -> FileSet {
    let model = Model::read(files, None, &Limits::default()).expect("a model");
    let written = model.write(&model.positions, Format::GLB).expect("a GLB");
    FileSet::single("shape.glb", written.main)
}

fn open(files: FileSet) -> Deformer {
    let pool = Pool::new(1).expect("a thread");
    let mut options = OpenOptions::default();
    options.body.volume = VolumeMode::Off;
    let exec = Exec::new(&pool, &Silent);
    Deformer::open(files, &options, &DeformerLimits::default(), &exec).expect("it opens")
}

fn edit(deformer: &mut Deformer, edit: &Edit) -> Result<EditReport, String> {
    let pool = Pool::new(1).expect("a thread");
    let outcome = deformer.edit_rest(edit, &Exec::new(&pool, &Silent));
    outcome.map(|o| o.report).map_err(|e| e.to_string())
}

/// A file of the shape as it is now.
fn file_of(deformer: &Deformer, format: Format) -> Vec<u8> {
    let pool = Pool::new(1).expect("a thread");
    let written = deformer.write(&deformer.rest_shape(), format, &Exec::new(&pool, &Silent));
    written.expect("written").main
}

fn text_of(deformer: &Deformer, format: Format) -> String {
    String::from_utf8(file_of(deformer, format)).expect("a text")
}

fn written(deformer: &Deformer, format: Format) -> Model {
    let files = FileSet::single("back", file_of(deformer, format));
    Model::read(files, Some(format), &Limits::default()).expect("read back")
}

fn thin(ratio: f64) -> Edit {
    Edit::Decimate { region: None, ratio }
}

fn remesh(length: f64) -> Edit {
    Edit::Remesh(RemeshCommand {
        edge_length: Some(length),
        ..RemeshCommand::default()
    })
}

fn smooth(kind: SmoothKind, region: Option<Region>) -> Edit {
    Edit::Smooth(SmoothCommand {
        region,
        kind,
        ..SmoothCommand::default()
    })
}

/// The triangles by the places of their corners, in an order of their own.
fn surface(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<[[u64; 3]; 3]> {
    let place = |v: u32| (positions[v as usize] + DVec3::ZERO).to_array().map(f64::to_bits);
    let turned = |t: &[u32; 3]| {
        let mut t = t.map(place);
        let first = (0..3).min_by_key(|&k| t[k]).expect("three");
        t.rotate_left(first);
        t
    };
    let mut all: Vec<_> = triangles.iter().map(turned).collect();
    all.sort_unstable();
    all
}

fn surface_of(deformer: &Deformer) -> Vec<[[u64; 3]; 3]> {
    surface(deformer.rest(), &deformer.geometry().triangles)
}

/// A ball, a box and a bar, with the length of their edges.
fn shapes() -> [(&'static str, Shape, f64); 3] {
    let bar = moved(cube(4), |p| p * DVec3::new(0.4, 2.0, 0.3));
    [
        ("ball", twin(sphere(3, 1.0)), 0.2),
        ("box", twin(cube(4)), 0.3),
        ("bar", twin(bar), 0.2),
    ]
}

/// The same shape beside it, open at the bottom.
fn merged((positions, triangles): &Shape, join: MergeJoin) -> Edit {
    let above = |t: &&[u32; 3]| t.iter().any(|&v| positions[v as usize].y > -0.45);
    let open = twin((positions.clone(), triangles.iter().filter(above).copied().collect()));
    Edit::Merge(Box::new(ModelMerge {
        other: OtherModel {
            files: off(&open, None),
            ..OtherModel::default()
        },
        own_from_other: DMat4::from_translation(DVec3::Y * 5.0),
        join,
        tolerance: None,
    }))
}

/// Every operation, and some after another, as lists of edits.
fn operations(shape: &Shape, edge: f64) -> Vec<(&'static str, Vec<Edit>)> {
    let top = || Region::half_space(DVec3::Y, 0.45);
    let plane = |keep, fill| Edit::Cut {
        along: CutLine::Plane(Plane::new(DVec3::new(0.1, 1.0, 0.05), 0.07)),
        keep,
        fill,
        cap: None,
    };
    let subdivide = |region, scheme| Edit::Subdivide {
        region,
        scheme,
        creases: Default::default(),
    };
    let delete = |fill| Edit::Delete { region: top(), fill };
    // Around the shape, near enough to it.
    let around: Vec<DVec3> = (0..8)
        .map(|k| std::f64::consts::TAU * f64::from(k) / 8.0)
        .map(|a| DVec3::new(libm::cos(a), 0.11, libm::sin(a)))
        .collect();
    vec![
        ("decimate", vec![thin(0.4)]),
        (
            "decimate a region",
            vec![Edit::Decimate {
                region: Some(top()),
                ratio: 0.3,
            }],
        ),
        ("coarser remesh", vec![remesh(1.7 * edge)]),
        ("finer remesh", vec![remesh(0.6 * edge)]),
        ("midpoints", vec![subdivide(Some(top()), SubdivisionScheme::Midpoint)]),
        ("loop", vec![subdivide(None, SubdivisionScheme::Loop)]),
        (
            "loop of a region",
            vec![subdivide(Some(top()), SubdivisionScheme::Loop)],
        ),
        ("smooth", vec![smooth(SmoothKind::Smooth, None)]),
        ("smooth a region", vec![smooth(SmoothKind::Smooth, Some(top()))]),
        ("relax", vec![smooth(SmoothKind::Relax, None)]),
        ("weld", vec![Edit::Weld { tolerance: 1e-6 }]),
        ("coarse weld", vec![Edit::Weld { tolerance: 0.5 * edge }]),
        ("cut", vec![plane(KeptSide::Below, false)]),
        ("filled cut", vec![plane(KeptSide::Above, true)]),
        ("both sides", vec![plane(KeptSide::Both, true)]),
        ("delete", vec![delete(false)]),
        ("delete and fill", vec![delete(true)]),
        (
            "fill",
            vec![
                delete(false),
                Edit::Fill {
                    region: None,
                    cap: None,
                },
            ],
        ),
        (
            "curve",
            vec![Edit::InsertCurve {
                points: around.clone(),
                closed: true,
            }],
        ),
        (
            "cut along a curve",
            vec![Edit::Cut {
                along: CutLine::Polyline {
                    points: around,
                    closed: true,
                },
                keep: KeptSide::Both,
                fill: false,
                cap: None,
            }],
        ),
        ("merge", vec![merged(shape, MergeJoin::Loose)]),
        ("stitch", vec![delete(false), merged(shape, MergeJoin::Stitch)]),
        (
            "one after the other",
            vec![
                subdivide(Some(top()), SubdivisionScheme::Midpoint),
                plane(KeptSide::Below, true),
                thin(0.5),
                remesh(1.5 * edge),
            ],
        ),
    ]
}

/// What the soup and its twin come to: after every edit the same surface, or the same refusal.
fn compare(name: &str, soup: FileSet, twin: FileSet, edits: &[Edit]) -> (Deformer, Deformer) {
    let (mut soup, mut twin) = (open(soup), open(twin));
    for (k, step) in edits.iter().enumerate() {
        let (got, wanted) = (edit(&mut soup, step), edit(&mut twin, step));
        match (&got, &wanted) {
            (Ok(got), Ok(wanted)) => {
                assert_eq!(got.after.faces, wanted.after.faces, "{name}, edit {k}");
                let codes = |report: &EditReport| {
                    let codes = report.warnings.iter().map(|w| w.code.to_string());
                    // The soup has something to weld: its vertices.
                    codes.filter(|code| code != "weld-nothing").collect::<Vec<_>>()
                };
                assert_eq!(codes(got), codes(wanted), "{name}, edit {k}");
            }
            (Err(got), Err(wanted)) => assert_eq!(got, wanted, "{name}, edit {k}"),
            _ => panic!("{name}, edit {k}: {got:?} and {wanted:?}"),
        }
        assert!(
            surface_of(&soup) == surface_of(&twin),
            "{name}, edit {k}: another surface"
        );
        let (a, b) = (soup.report(), twin.report());
        assert_eq!((a.closed, a.volume), (b.closed, b.volume), "{name}, edit {k}");
    }
    (soup, twin)
}

#[test]
fn every_operation_makes_of_a_soup_what_it_makes_of_its_twin() {
    for (name, shape, edge) in shapes() {
        for (operation, edits) in operations(&shape, edge) {
            let soups = [
                ("off", off(&soup(&shape), None)),
                ("binary stl", binary_stl(&shape)),
                ("glb", glb(off(&soup(&shape), None))),
            ];
            for (format, files) in soups {
                compare(
                    &format!("{name}, {operation}, {format}"),
                    files,
                    off(&shape, None),
                    &edits,
                );
            }
        }
    }
}

#[test]
fn equal_attributes_are_no_seam() {
    let (_, shape, edge) = shapes().into_iter().next().expect("the ball");
    let smooth = soup(&shape).0;
    for (operation, edits) in operations(&shape, edge) {
        // A cap has an edge where vertices have normals, so later edits see a line there.
        let edits = &edits[..edits.len().min(2)];
        if operation == "stitch" {
            continue;
        }
        for (format, files) in [
            ("obj", obj_soup(&shape)),
            ("ply", ply_soup(&shape)),
            ("noff", off(&soup(&shape), Some(&|v| smooth[v].normalize()))),
        ] {
            compare(&format!("{operation}, {format}"), files, off(&shape, None), edits);
        }
    }
}

#[test]
fn a_thinned_soup_comes_back_as_its_format_has_it() {
    let (_, shape, _) = shapes().into_iter().next().expect("the ball");
    let halve = thin(0.5);
    for (files, format) in [
        (binary_stl(&shape), Format::STL),
        (off(&soup(&shape), None), Format::OFF),
        (obj_soup(&shape), Format::OBJ),
        (ply_soup(&shape), Format::PLY),
    ] {
        let mut deformer = open(files);
        let before = deformer.geometry().triangles.len();
        edit(&mut deformer, &halve).expect("thinned");
        let back = written(&deformer, format);
        assert_eq!(back.triangles.len(), before / 2, "{format}");
        let vertices = back.positions.len();
        match format == Format::STL {
            true => assert_eq!(vertices, 3 * back.triangles.len()),
            false => assert!(vertices <= 3 * back.triangles.len()),
        }
        assert_eq!(back.normals.is_empty(), format != Format::OBJ, "{format}");
    }
    // What a picture is mapped by, and what is painted, stays where it was.
    let mut deformer = open(obj_soup(&shape));
    edit(&mut deformer, &halve).expect("thinned");
    let text = text_of(&deformer, Format::OBJ);
    let numbers = |line: &str| -> Vec<f64> { line.split(' ').skip(1).map(|w| w.parse().expect("a number")).collect() };
    let lines = |word: &str| -> Vec<Vec<f64>> { text.lines().filter(|l| l.starts_with(word)).map(numbers).collect() };
    let (places, coordinates) = (lines("v "), lines("vt "));
    for face in text.lines().filter(|l| l.starts_with("f ")) {
        for corner in face.split(' ').skip(1) {
            let at: Vec<usize> = corner.split('/').map(|w| w.parse().expect("an index")).collect();
            assert_eq!(places[at[0] - 1][..2], coordinates[at[1] - 1][..], "{corner}");
        }
    }
}

/// The largest angle between the normal of a corner and that of its triangle, in degrees.
fn least_flat(model: &Model) -> f64 {
    let worst = model.triangles.iter().flat_map(|t| {
        let facet = facet_normal(t.map(|v| model.positions[v as usize]));
        t.map(|v| facet.dot(model.normals[v as usize].as_dvec3()))
    });
    libm::acos(worst.fold(1.0, f64::min)).to_degrees()
}

#[test]
fn a_flat_shaded_soup_is_one_surface_and_stays_flat_shaded() {
    let (_, shape, edge) = shapes().into_iter().next().expect("the ball");
    let facets: Vec<DVec3> = corners(&shape).into_iter().map(facet_normal).collect();
    let flat = || off(&soup(&shape), Some(&|v| facets[v / 3]));
    for (operation, edits) in operations(&shape, edge) {
        let edits = &edits[..1];
        let (deformer, _) = compare(&format!("flat ball, {operation}"), flat(), off(&shape, None), edits);
        if !operation.starts_with("merge") {
            let angle = least_flat(&written(&deformer, Format::OFF));
            assert!(angle < 0.1, "{operation}: a normal is off by {angle} degrees");
        }
    }
    let mut deformer = open(glb(flat()));
    for _ in 0..2 {
        let report = edit(&mut deformer, &thin(0.5)).expect("thinned");
        assert_eq!(report.after.faces, report.before.faces / 2);
        let back = written(&deformer, Format::GLB);
        assert!(least_flat(&back) < 0.1, "{}", least_flat(&back));
        assert!(deformer.report().closed);
    }
}

#[test]
fn facets_that_meet_at_an_edge_have_one() {
    let (_, shape, _) = shapes().into_iter().nth(1).expect("the box");
    let facets: Vec<DVec3> = corners(&shape).into_iter().map(facet_normal).collect();
    let mut deformer = open(off(&soup(&shape), Some(&|v| facets[v / 3])));
    for step in [thin(0.4), remesh(0.4)] {
        edit(&mut deformer, &step).expect("edited");
        let report = deformer.report();
        assert!(report.closed && (report.volume - 8.0).abs() < 1e-9, "{}", report.volume);
        assert!(least_flat(&written(&deformer, Format::OFF)) < 0.1);
    }
}

#[test]
fn real_seams_stay() {
    // Two halves of a ball that a picture is mapped on by one coordinate each, and two materials.
    let (_, shape, _) = shapes().into_iter().next().expect("the ball");
    let mut text = String::new();
    for (k, t) in corners(&shape).into_iter().enumerate() {
        let upper = t.iter().all(|p| p.y >= 0.0);
        let line = if upper { "usemtl upper" } else { "usemtl lower" };
        writeln!(text, "{line}").expect("a text");
        t.iter()
            .for_each(|p| writeln!(text, "v {} {} {}", p.x, p.y, p.z).expect("a text"));
        writeln!(text, "f {} {} {}", 3 * k + 1, 3 * k + 2, 3 * k + 3).expect("a text");
    }
    let mut deformer = open(FileSet::single("two.obj", text.into_bytes()));
    edit(&mut deformer, &thin(0.3)).expect("thinned");
    assert!(deformer.report().closed);
    let text = text_of(&deformer, Format::OBJ);
    let mut heights: Vec<f64> = Vec::new();
    let mut upper = None;
    for line in text.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        match words[0] {
            "v" => heights.push(words[2].parse().expect("a number")),
            "usemtl" => upper = Some(words[1] == "upper"),
            "f" => {
                let at = |w: &&str| heights[w.split('/').next().expect("one").parse::<usize>().expect("an index") - 1];
                let middle: f64 = words[1..].iter().map(at).sum::<f64>() / 3.0;
                assert_eq!(upper, Some(middle > 0.0), "a triangle at height {middle}");
            }
            _ => {}
        }
    }
}

/// The solids of a text STL: name, and the heights of the middles of its facets.
fn solids(text: &str) -> Vec<(String, Vec<f64>)> {
    let mut found: Vec<(String, Vec<f64>)> = Vec::new();
    let mut heights = Vec::new();
    for line in text.lines().map(str::trim) {
        if let Some(name) = line.strip_prefix("solid") {
            found.push((name.trim().to_owned(), Vec::new()));
        } else if let Some(numbers) = line.strip_prefix("vertex ") {
            heights.push(numbers.split(' ').nth(1).expect("y").parse::<f64>().expect("a number"));
            if heights.len() == 3 {
                let last = found.last_mut().expect("a solid");
                last.1.push(heights.drain(..).sum::<f64>() / 3.0);
            }
        } else if let Some(name) = line.strip_prefix("endsolid") {
            assert_eq!(found.last().map(|s| s.0.as_str()), Some(name.trim()));
        }
    }
    found
}

#[test]
fn a_text_stl_stays_a_text_with_its_solids() {
    let (_, shape, edge) = shapes().into_iter().nth(2).expect("the bar");
    let mut done = 0;
    for (operation, edits) in operations(&shape, edge) {
        let mut deformer = open(text_stl(&shape, 0.0));
        if edits.iter().any(|step| edit(&mut deformer, step).is_err()) {
            continue;
        }
        done += 1;
        let text = text_of(&deformer, Format::STL);
        let found = solids(&text);
        let names: Vec<&str> = found.iter().map(|s| s.0.as_str()).collect();
        assert_eq!(names[..2], ["Lower half", "UPPER"], "{operation}");
        let count: usize = found.iter().map(|s| s.1.len()).sum();
        assert_eq!(count, deformer.geometry().triangles.len(), "{operation}");
        if !operation.contains("weld") {
            let stayed = found[0].1.iter().all(|y| *y < 0.0) && found[1].1.iter().all(|y| *y > 0.0);
            assert!(stayed, "{operation}: a facet left its solid");
        }
        let back = Model::read(FileSet::single("back.stl", text.into_bytes()), None, &Limits::default());
        let back = back.expect("read back");
        assert!(
            surface(&back.positions, &back.triangles) == surface_of(&deformer),
            "{operation}"
        );
    }
    assert!(done > 15, "{done} operations were tried");
}

#[test]
fn handles_hold_what_they_held_of_a_soup() {
    let (_, shape, _) = shapes().into_iter().nth(2).expect("the bar");
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let mut ends = Vec::new();
    for files in [off(&soup(&shape), None), off(&shape, None)] {
        let mut deformer = open(files);
        // Of each place at the top one vertex alone is listed.
        let (mut places, mut listed) = (BTreeSet::new(), Vec::new());
        let count = deformer.rest().len() as u32;
        for (v, p) in (0..count).zip(deformer.rest().iter()).rev().filter(|(_, p)| p.y > 1.9) {
            if places.insert(p.to_array().map(f64::to_bits)) {
                listed.push(v);
            }
        }
        let handles = [
            Handle::new("base", Region::half_space(DVec3::NEG_Y, 1.9)),
            Handle::new("top", Region::vertices(listed)),
        ];
        deformer.set_handles(handles, &exec).expect("held");
        let split = Edit::Subdivide {
            region: None,
            scheme: SubdivisionScheme::Midpoint,
            creases: Default::default(),
        };
        let report = edit(&mut deformer, &split).expect("split");
        assert_eq!(report.handles_kept, ["base", "top"]);
        let aside = [("top", HandlePose::translation(DVec3::X))];
        let moved = deformer.commit(aside, &SolveSettings::default(), &exec);
        let moved = moved.expect("posed");
        ends.push(surface(&moved.positions, &deformer.geometry().triangles));
    }
    assert!(ends[0] == ends[1], "the soup bends otherwise");
}

#[test]
fn what_users_had_comes_out_right() {
    let thin = thin(0.4);
    for name in ["ball.stl", "ball_soup.off", "ball_soup_flat.glb"] {
        let Some(bytes) = data_bytes(&format!("field/{name}")) else {
            return;
        };
        let mut deformer = open(FileSet::single(name, bytes.clone()));
        let report = edit(&mut deformer, &thin).expect("thinned");
        assert_eq!((report.before.faces, report.after.faces), (720, 288), "{name}");
        assert!(
            report.warnings.is_empty() && deformer.report().closed,
            "{name}: {report:?}"
        );
        let mut deformer = open(FileSet::single(name, bytes.clone()));
        let report = edit(&mut deformer, &remesh(0.3)).expect("remeshed");
        assert!(
            report.after.faces < 720 && deformer.report().closed,
            "{name}: {report:?}"
        );
        let mut deformer = open(FileSet::single(name, bytes));
        let report = edit(&mut deformer, &Edit::Weld { tolerance: 1e-5 }).expect("welded");
        let flat = name.contains("flat");
        assert_eq!(report.after.vertices < report.before.vertices, !flat, "{name}");
        edit(&mut deformer, &thin).expect("thinned");
        assert_eq!(deformer.geometry().triangles.len(), 288, "{name}, welded");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Sequences of edits.
    #[test]
    fn sequences_of_edits_make_of_a_soup_what_they_make_of_its_twin(
        choices in prop::collection::vec(0usize..20, 1..4),
        which in 0usize..3,
    ) {
        let (name, shape, edge) = shapes().into_iter().nth(which).expect("three");
        let all = operations(&shape, edge);
        let edits: Vec<Edit> = choices.iter().flat_map(|&k| all[k % all.len()].1.clone()).collect();
        compare(name, off(&soup(&shape), None), off(&shape, None), &edits);
    }
}

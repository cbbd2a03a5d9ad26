//! Gaussian splats carried along with a posed model.

use glam::{DMat3, DQuat, DVec3};
use pliant_core::asset::{FileSet, Following, Format, LargeSplatRule, Limits, Splats, shapes};
use pliant_core::edit::KeptSide;
use pliant_core::engine::{
    CarriedModel, CutLine, Deformer, DeformerLimits, Edit, EditCommand, EditedShape, Handle, HandlePose, ModelShape,
    OpenOptions, Plane, Region, SolveSettings,
};
use pliant_core::exec::Exec;
use pliant_core::mesh::carry::{CarriedFrame, CarriedSpace, SurfaceCarrier};
use pliant_core::mesh::rotation::exp_rotation;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use std::fmt::Write as _;

/// A bar from y = 0 to 4, with splats in it, on it and beside it: long along the bar, red on one side.
pub(super) fn bar() -> (FileSet, FileSet, Vec<DVec3>) {
    let (points, faces) = shapes::box_with_cells(DVec3::new(0.5, 4.0, 0.5), [4, 32, 4]);
    let points: Vec<DVec3> = points.iter().map(|p| *p - DVec3::new(0.25, 0.0, 0.25)).collect();
    let mut text = String::new();
    points
        .iter()
        .for_each(|p| writeln!(text, "v {} {} {}", p.x, p.y, p.z).expect("memory"));
    for face in faces {
        let [a, b, c] = face.map(|v| v + 1);
        writeln!(text, "f {a} {b} {c}").expect("memory");
    }
    let mut centers = Vec::new();
    for row in 0..40 {
        for (x, z) in [(0.0, 0.0), (0.25, 0.1), (0.1, -0.2), (-0.3, 0.2)] {
            centers.push(DVec3::new(x, 0.05 + 0.1 * f64::from(row), z));
        }
    }
    (
        FileSet::single("bar.obj", text),
        FileSet::single("splats.ply", splats_at(&centers, 0.03)),
        centers,
    )
}

/// Splats of that length along y, a third as wide, with harmonics of degree 3, as text.
pub(super) fn splats_at(centers: &[DVec3], length: f64) -> String {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", centers.len());
    let names = [
        "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    ];
    let names = names.map(str::to_owned).into_iter();
    let names = names
        .chain((0..4).map(|k| format!("rot_{k}")))
        .chain((0..45).map(|k| format!("f_rest_{k}")));
    names.for_each(|name| writeln!(text, "property float {name}").expect("memory"));
    text += "end_header\n";
    for (i, p) in centers.iter().enumerate() {
        let (long, thin) = (length.ln(), (length / 3.0).ln());
        write!(
            text,
            "{} {} {} 0.5 -0.25 0.125 2 {thin} {long} {thin} 1 0 0 0",
            p.x, p.y, p.z
        )
        .expect("memory");
        for k in 0..45 {
            write!(text, " {}", ((i * 45 + k) as f64).sin() * 0.3).expect("memory");
        }
        text.push('\n');
    }
    text
}

fn posed(pose: HandlePose, exec: &Exec<'_>) -> (Deformer, Vec<DVec3>) {
    bent_bar(LargeSplatRule::Divide, pose, exec)
}

fn bent_bar(large_splats: LargeSplatRule, pose: HandlePose, exec: &Exec<'_>) -> (Deformer, Vec<DVec3>) {
    let options = OpenOptions {
        following: Following {
            large_splats,
            ..Following::default()
        },
        ..OpenOptions::default()
    };
    let mut deformer = Deformer::open(bar().0, &options, &DeformerLimits::default(), exec).expect("a bar");
    let handles = [
        Handle::new("low", Region::half_space([0.0, -1.0, 0.0], -0.5)),
        Handle::new("high", Region::half_space([0.0, 1.0, 0.0], 3.5)),
    ];
    deformer.set_handles(handles, exec).expect("handles");
    let solved = deformer
        .commit([("high", pose)], &SolveSettings::default(), exec)
        .expect("solved");
    let positions = solved.positions.to_vec();
    (deformer, positions)
}

fn carried(files: FileSet, output: Option<Format>) -> CarriedModel {
    CarriedModel {
        files,
        format: None,
        output,
        path: String::new(),
    }
}

/// The numbers of the splats of a text, one row each.
pub(super) fn rows(text: &[u8]) -> Vec<Vec<f64>> {
    let text = String::from_utf8_lossy(text).into_owned();
    let body = text.split_once("end_header\n").expect("a header").1.lines();
    body.map(|line| line.split(' ').map(|word| word.parse().expect("a number")).collect())
        .collect()
}

#[test]
fn splats_of_a_rigid_move_are_where_the_formula_has_them() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (files, splats, _) = bar();
    let mut deformer =
        Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec).expect("a bar");
    deformer
        .set_handles([Handle::new("all", Region::half_space([0.0, 1.0, 0.0], -1.0))], &exec)
        .expect("a handle");
    let (turn, offset) = (exp_rotation(DVec3::new(0.9, -1.3, 0.4)), DVec3::new(0.4, 2.0, -1.0));
    let still = deformer.rest().to_vec();
    let moved: Vec<DVec3> = still.iter().map(|p| turn * *p + offset).collect();
    let unmoved = deformer
        .carry_model(&still, carried(splats.clone(), None), &exec)
        .expect("carried");
    assert_eq!(unmoved.main, splats.main, "what has not moved is the file as it came");
    let written = deformer
        .carry_model(&moved, carried(splats.clone(), None), &exec)
        .expect("carried");

    let mut wanted = Splats::read(splats, Format::PLY, &Limits::default(), &Silent).expect("splats");
    let spaces = wanted.centers().iter().map(|center| CarriedSpace {
        frame: CarriedFrame {
            position: turn * *center + offset,
            rotation: turn,
            scale: 1.0,
        },
        gradient: DMat3::from_quat(turn),
    });
    let spaces: Vec<CarriedSpace> = spaces.collect();
    wanted.carry(0, &spaces, &pool);
    let wanted = wanted.write(Format::PLY).expect("written");
    for (row, wanted) in rows(&written.main).iter().zip(rows(&wanted.main)) {
        assert!(
            row.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-5),
            "{row:?} {wanted:?}"
        );
        let own = DQuat::from_xyzw(row[11], row[12], row[13], row[10]).normalize();
        assert!(own.dot(turn).abs() > 1.0 - 1e-10);
    }
}

#[test]
fn splats_bend_with_a_bar_on_any_number_of_threads_and_too_large_ones_are_told() {
    let results = [1, 4].map(|threads| {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let pose = HandlePose::translation([1.1, -0.7, 0.0]).rotated([0.0, 0.0, -1.2]);
        let (deformer, positions) = posed(pose, &exec);
        let (_, splats, centers) = bar();
        let written = deformer
            .carry_model(&positions, carried(splats, None), &exec)
            .expect("carried");
        assert!(written.warnings.is_empty(), "{:?}", written.warnings);
        let rows = rows(&written.main);
        for column in 0..4 {
            // Along a row of splats: a long one points from the one below it to the one above it.
            for k in 4..36 {
                let at = |k: usize| DVec3::from_slice(&rows[4 * k + column]);
                let along = (at(k + 1) - at(k - 1)).normalize();
                let row = &rows[4 * k + column];
                let turn = DQuat::from_xyzw(row[11], row[12], row[13], row[10]);
                assert!((turn * DVec3::Y).dot(along) > 0.985, "splat {k} of column {column}");
                // As long as the bar around it has become.
                let growth = (at(k + 1) - at(k - 1)).length() / centers[4 * (k + 1)].distance(centers[4 * (k - 1)]);
                let own = row[8].exp() / 0.03;
                assert!(
                    (own / growth - 1.0).abs() < 0.12,
                    "splat {k} of column {column}: {own} {growth}"
                );
            }
        }
        let large = || {
            let centers = [DVec3::new(0.0, 2.0, 0.0), DVec3::new(0.0, 0.2, 0.0)];
            FileSet::single("large.ply", splats_at(&centers, 0.7))
        };
        let carry = |deformer: &Deformer| {
            deformer
                .carry_model(&positions, carried(large(), None), &exec)
                .expect("carried")
        };
        let divided = carry(&deformer);
        let message = &divided.warnings[0].message;
        assert!(message.starts_with("1 splat was larger than the bend"), "{message}");
        assert_eq!(divided.warnings.len(), 1, "{:?}", divided.warnings);
        let parts = self::rows(&divided.main);
        assert!((4..=30).contains(&parts.len()), "{}", parts.len());
        assert!(
            message.contains(&format!("the file has {} splats", parts.len())),
            "{message}"
        );
        // They lie in a row along the bar, where its middle has gone, and the whole one stays as it is.
        let (whole, parts) = parts.split_last().expect("a splat");
        assert!((whole[6] - 2.0).abs() < 1e-6);
        let axis = |row: &[f64]| DQuat::from_xyzw(row[11], row[12], row[13], row[10]) * DVec3::Y;
        for part in parts {
            let place = DVec3::from_slice(part);
            let near = rows.iter().step_by(4);
            let near = near.min_by(|a, b| {
                let away = |row: &[f64]| DVec3::from_slice(row).distance(place);
                away(a).total_cmp(&away(b))
            });
            let near = near.expect("a splat");
            assert!(DVec3::from_slice(near).distance(place) < 0.1, "{part:?}");
            assert!(axis(part).dot(axis(near)) > 0.95, "{part:?} {near:?}");
        }
        let kept = bent_bar(
            LargeSplatRule::Keep,
            HandlePose::translation([1.1, -0.7, 0.0]).rotated([0.0, 0.0, -1.2]),
            &exec,
        );
        let kept = carry(&kept.0);
        assert_eq!(self::rows(&kept.main).len(), 2);
        assert!(
            kept.warnings[0].message.starts_with("1 splat is larger than the bend"),
            "{kept:?}"
        );
        written.main
    });
    assert!(results[0] == results[1]);
}

#[test]
fn the_gradient_inside_and_on_a_stretched_body_is_that_of_the_stretch() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let root = std::f64::consts::SQRT_2;
    for (name, (rest, faces)) in [
        ("box", shapes::box_with_cells(DVec3::new(0.5, 4.0, 0.5), [4, 32, 4])),
        ("ball", shapes::icosphere(1.0, 3)),
    ] {
        let middle = rest.iter().sum::<DVec3>() / rest.len() as f64;
        let rest: Vec<DVec3> = rest.iter().map(|p| *p - middle).collect();
        let now: Vec<DVec3> = rest.iter().map(|p| DVec3::new(p.x, root * p.y, p.z)).collect();
        let carrier = SurfaceCarrier::new(&faces, &rest, &now, &pool);
        let stretch = carrier.stretch(&pool);
        let middle = |face: &[u32; 3]| face.iter().map(|&v| rest[v as usize]).sum::<DVec3>() / 3.0;
        let on: Vec<DVec3> = faces.iter().map(middle).collect();
        let inside: Vec<DVec3> = on.iter().map(|p| *p * 0.05).collect();
        let there = carrier.carry_spaces(&stretch, &on, &exec).expect("carried");
        for (face, space) in faces.iter().zip(&there) {
            let [a, b, c] = face.map(|v| v as usize);
            let edge = rest[b] - rest[a];
            let wanted = now[b] - now[a];
            let apart = (space.gradient * edge).distance(wanted);
            assert!(apart < 0.05 * wanted.length(), "{name}: {apart} of {wanted} ({c})");
        }
        for space in carrier.carry_spaces(&stretch, &inside, &exec).expect("carried") {
            let apart = space.gradient - DMat3::from_diagonal(DVec3::new(1.0, root, 1.0));
            let most = apart.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
            assert!(most < 0.05, "{name}: {:?}", space.gradient);
        }
    }
}

#[test]
fn a_mesh_is_not_written_as_splats_and_splats_not_as_a_mesh_and_not_merged() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let (files, splats, _) = bar();
    let limits = DeformerLimits::default();
    let deformer = Deformer::open(files.clone(), &OpenOptions::default(), &limits, &exec).expect("a bar");
    let rest = deformer.rest().to_vec();
    let refused = deformer
        .write(&rest, Format::SPLAT, &exec)
        .expect_err("no splats")
        .to_string();
    assert!(refused.contains("no Gaussian splats"), "{refused}");
    for (files, output) in [(splats, Format::OBJ), (files, Format::SPZ)] {
        let refused = deformer.carry_model(&rest, carried(files, Some(output)), &exec);
        assert!(refused.expect_err("refused").to_string().contains("Gaussian splats"));
    }
}

/// The splats of [`bar`] as a model of their own.
pub(super) fn own_model(splats: &FileSet, exec: &Exec<'_>) -> Deformer {
    let limits = DeformerLimits::default();
    Deformer::open(splats.clone(), &OpenOptions::default(), &limits, exec).expect("splats")
}

#[test]
fn splats_of_their_own_turn_with_a_rigid_move_as_the_formula_says() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (_, splats, centers) = bar();
    let mut deformer = own_model(&splats, &exec);
    let primitives = &deformer.geometry().primitives;
    let names: Vec<&str> = primitives.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["splats", "cage"]);
    assert_eq!(primitives[0].vertex_count as usize, centers.len());
    assert!(deformer.report().closed, "{:?}", deformer.report().warnings);
    let unmoved = deformer
        .write(&deformer.rest().to_vec(), Format::PLY, &exec)
        .expect("written");
    assert_eq!(unmoved.main, splats.main, "what has not moved is the file as it came");

    let (turn, offset) = (exp_rotation(DVec3::new(0.9, -1.3, 0.4)), DVec3::new(0.4, 2.0, -1.0));
    deformer
        .set_handles([Handle::new("all", Region::half_space([0.0, 1.0, 0.0], -1.0))], &exec)
        .expect("a handle");
    let pose = HandlePose::translation(offset.to_array())
        .rotated([0.9, -1.3, 0.4])
        .about([0.0; 3]);
    let solved = deformer
        .commit([("all", pose)], &SolveSettings::default(), &exec)
        .expect("solved");
    let written = deformer.write(&solved.positions, Format::PLY, &exec).expect("written");
    let mut wanted = Splats::read(splats, Format::PLY, &Limits::default(), &Silent).expect("splats");
    let spaces = wanted.centers().iter().map(|center| CarriedSpace {
        frame: CarriedFrame {
            position: turn * *center + offset,
            rotation: turn,
            scale: 1.0,
        },
        gradient: DMat3::from_quat(turn),
    });
    let spaces: Vec<CarriedSpace> = spaces.collect();
    wanted.carry(0, &spaces, &pool);
    let wanted = wanted.write(Format::PLY).expect("written");
    for (row, wanted) in rows(&written.main).iter().zip(rows(&wanted.main)) {
        assert!(
            row.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-5),
            "{row:?} {wanted:?}"
        );
    }
}

#[test]
fn splats_of_their_own_bend_and_come_back_in_each_format() {
    let results = [1, 4].map(|threads| {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let (_, splats, centers) = bar();
        let mut deformer = own_model(&splats, &exec);
        let handles = [
            Handle::new("low", Region::half_space([0.0, -1.0, 0.0], -0.5)),
            Handle::new("high", Region::half_space([0.0, 1.0, 0.0], 3.5)),
        ];
        deformer.set_handles(handles, &exec).expect("handles");
        let pose = HandlePose::translation([1.1, -0.7, 0.0]).rotated([0.0, 0.0, -1.2]);
        let solved = deformer
            .commit([("high", pose)], &SolveSettings::default(), &exec)
            .expect("solved");
        let positions = solved.positions.to_vec();
        let written = deformer.write(&positions, Format::PLY, &exec).expect("written");
        assert!(written.warnings.is_empty(), "{:?}", written.warnings);
        let bent = rows(&written.main);
        for (row, position) in bent.iter().zip(&positions) {
            assert!(DVec3::from_slice(row).distance(*position) < 1e-6, "as in frames");
            assert_eq!(row[3..7], [0.5, -0.25, 0.125, 2.0]);
        }
        for column in 0..4 {
            for k in 4..36 {
                let at = |k: usize| DVec3::from_slice(&bent[4 * k + column]);
                let along = (at(k + 1) - at(k - 1)).normalize();
                let row = &bent[4 * k + column];
                let turn = DQuat::from_xyzw(row[11], row[12], row[13], row[10]);
                assert!((turn * DVec3::Y).dot(along) > 0.98, "splat {k} of column {column}");
            }
        }
        // Another format of splats holds them all, one of meshes the surface around them.
        let packed = deformer.write(&positions, Format::SPZ, &exec).expect("written");
        let packed = FileSet::single("a.spz", packed.main);
        let packed = Splats::read(packed, Format::SPZ, &Limits::default(), &Silent).expect("readable");
        assert_eq!(packed.len(), centers.len());
        let surface = deformer.write(&positions, Format::OBJ, &exec).expect("written");
        assert!(
            surface
                .warnings
                .iter()
                .any(|w| w.message.contains("160 Gaussian splats"))
        );
        written.main
    });
    assert!(results[0] == results[1]);
}

#[test]
fn what_an_edit_takes_takes_its_splats_along_and_the_others_ride_on() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (_, splats, centers) = bar();
    let half = Edit::Cut {
        along: CutLine::Plane(Plane {
            normal: DVec3::Y,
            offset: 2.0,
        }),
        keep: KeptSide::Below,
        fill: true,
        cap: None,
    };
    let end = Edit::Delete {
        region: Region::half_space([0.0, -1.0, 0.0], -0.5),
        fill: true,
    };
    let turn = exp_rotation(DVec3::new(0.0, 0.0, 1.5));
    for (edit, left) in [(half, 0..80), (end, 20..160_usize)] {
        let mut deformer = own_model(&splats, &exec);
        let rest = deformer.rest_shape();
        let command = EditCommand {
            edit: &edit,
            on: EditedShape::Rest,
            shape: &rest,
            poses: &deformer.initial_poses(),
            settings: None,
        };
        let outcome = deformer.edit(&command, &exec).expect("edited");
        assert!(outcome.report.warnings.iter().any(|w| w.code == "splats-cut"));
        let all = Handle::new("all", Region::half_space([0.0, 1.0, 0.0], -9.0));
        deformer.set_handles([all], &exec).expect("a handle");
        let pose = HandlePose::rotation([0.0, 0.0, 1.5]).about([0.0; 3]);
        let solved = deformer
            .commit([("all", pose)], &SolveSettings::default(), &exec)
            .expect("solved");
        let written = deformer.write(&solved.positions, Format::PLY, &exec).expect("written");
        let kept = rows(&written.main);
        assert!(kept.len().abs_diff(left.len()) <= 8, "{} of {left:?}", kept.len());
        for row in &kept {
            let place = turn.conjugate() * DVec3::from_slice(row);
            let was = centers
                .iter()
                .position(|c| c.distance(place) < 1e-5)
                .expect("one of them");
            assert!((left.start.saturating_sub(4)..left.end + 4).contains(&was), "{was}");
            let own = DQuat::from_xyzw(row[11], row[12], row[13], row[10]);
            assert!(own.dot(turn).abs() > 1.0 - 1e-9, "{own}");
        }
    }
}

/// The bar of [`bar`] with its splats in one glTF, under a node that turns and enlarges both; and the names of its harmonics.
pub(super) fn gltf_of_bar(node: &str) -> (FileSet, Vec<String>) {
    let (points, faces) = shapes::box_with_cells(DVec3::new(0.5, 4.0, 0.5), [4, 32, 4]);
    let points = points.iter().map(|p| *p - DVec3::new(0.25, 0.0, 0.25));
    let (_, splats, centers) = bar();
    let rows = rows(&splats.main);
    let names = [3, 5, 7].iter().zip(1..).flat_map(|(count, degree)| {
        (0..*count).map(move |k| format!("KHR_gaussian_splatting:SH_DEGREE_{degree}_COEF_{k}"))
    });
    let names: Vec<String> = names.collect();
    let mut lists: Vec<(&str, Vec<f64>)> = vec![
        ("VEC3", points.flat_map(|p| p.to_array()).collect()),
        ("VEC3", centers.iter().flat_map(|p| p.to_array()).collect()),
        ("VEC4", rows.iter().flat_map(|r| [r[11], r[12], r[13], r[10]]).collect()),
        (
            "VEC3",
            rows.iter().flat_map(|r| r[7..10].iter().map(|s| s.exp())).collect(),
        ),
    ];
    for k in 0..15 {
        let of = |r: &Vec<f64>| [r[14 + k], r[29 + k], r[44 + k]];
        lists.push(("VEC3", rows.iter().flat_map(of).collect()));
    }
    let mut bytes: Vec<u8> = faces.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let corners = 3 * faces.len();
    let mut views = format!(r#"{{"buffer":0,"byteLength":{}}}"#, bytes.len());
    let mut accessors = format!(r#"{{"bufferView":0,"componentType":5125,"count":{corners},"type":"SCALAR"}}"#);
    for (k, (shape, values)) in lists.iter().enumerate() {
        let (lanes, at) = (if *shape == "VEC4" { 4 } else { 3 }, bytes.len());
        bytes.extend(values.iter().flat_map(|v| (*v as f32).to_le_bytes()));
        let bounds = if k < 2 {
            r#","min":[-9,-9,-9],"max":[9,9,9]"#
        } else {
            ""
        };
        write!(
            views,
            r#",{{"buffer":0,"byteOffset":{at},"byteLength":{}}}"#,
            4 * values.len()
        )
        .expect("memory");
        write!(
            accessors,
            r#",{{"bufferView":{},"componentType":5126,"count":{},"type":"{shape}"{bounds}}}"#,
            k + 1,
            values.len() / lanes
        )
        .expect("memory");
    }
    let harmonics: String = names
        .iter()
        .zip(5..)
        .map(|(name, k)| format!(r#","{name}":{k}"#))
        .collect();
    let text = format!(
        r#"{{"asset":{{"version":"2.0"}},"extensionsUsed":["KHR_gaussian_splatting"],"scenes":[{{"nodes":[0]}}],"scene":0,
"nodes":[{{"mesh":0{node}}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":1}},"indices":0}},
{{"mode":0,"attributes":{{"POSITION":2,"KHR_gaussian_splatting:ROTATION":3,"KHR_gaussian_splatting:SCALE":4{harmonics}}},
"extensions":{{"KHR_gaussian_splatting":{{"kernel":"ellipse","colorSpace":"srgb_rec709_display"}}}}}}]}}],
"buffers":[{{"uri":"b.bin","byteLength":{}}}],"bufferViews":[{views}],"accessors":[{accessors}]}}"#,
        bytes.len()
    );
    let mut files = FileSet::single("bar.gltf", text);
    files.companions.insert("b.bin".into(), bytes.into());
    (files, names)
}

#[test]
fn splats_of_a_gltf_turn_with_a_rigid_move_as_the_formula_says() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let own = exp_rotation(DVec3::new(0.3, 0.2, -0.5));
    let node = format!(
        r#","rotation":[{},{},{},{}],"scale":[2,2,2],"translation":[1,0.5,-2]"#,
        own.x, own.y, own.z, own.w
    );
    let (files, names) = gltf_of_bar(&node);
    let mut deformer = Deformer::open(
        files.clone(),
        &OpenOptions::default(),
        &DeformerLimits::default(),
        &exec,
    )
    .expect("a bar");
    deformer
        .set_handles([Handle::new("all", Region::half_space([0.0, 0.0, 1.0], -99.0))], &exec)
        .expect("a handle");
    let vector = DVec3::new(0.9, -1.3, 0.4);
    let pose = HandlePose::translation([0.4, 2.0, -1.0])
        .rotated(vector)
        .about([0.0; 3]);
    let solved = deformer
        .commit([("all", pose)], &SolveSettings::default(), &exec)
        .expect("solved");
    let written = deformer.write(&solved.positions, Format::GLTF, &exec).expect("written");
    assert!(written.warnings.is_empty(), "{:?}", written.warnings);
    let text = String::from_utf8(written.main).expect("text");
    assert_eq!(text.matches("componentType").count(), 20, "written where they were");

    // The same motion in the coordinates of the mesh.
    let turn = own.conjugate() * exp_rotation(vector) * own;
    let (_, splats, centers) = bar();
    let mut wanted = Splats::read(splats, Format::PLY, &Limits::default(), &Silent).expect("splats");
    let space = CarriedSpace {
        frame: CarriedFrame {
            position: DVec3::splat(-7.0),
            rotation: turn,
            scale: 1.0,
        },
        gradient: DMat3::from_quat(turn),
    };
    wanted.carry(0, &vec![space; centers.len()], &pool);
    let wanted = rows(&wanted.write(Format::PLY).expect("written").main);
    let bytes = written.companions.values().next().expect("a buffer");
    let before = files.companions["b.bin"].len() - 4 * centers.len() * (4 + 3 + 45);
    let numbers: Vec<f64> = bytes[before..]
        .as_chunks::<4>()
        .0
        .iter()
        .map(|b| f64::from(f32::from_le_bytes(*b)))
        .collect();
    let (turns, rest) = numbers.split_at(4 * centers.len());
    let (scales, harmonics) = rest.split_at(3 * centers.len());
    for (i, wanted) in wanted.iter().enumerate() {
        let q = DQuat::from_slice(&turns[4 * i..]);
        let r = DQuat::from_xyzw(wanted[11], wanted[12], wanted[13], wanted[10]);
        assert!(q.dot(r).abs() > 1.0 - 1e-10, "{q} {r}");
        for axis in 0..3 {
            assert!((scales[3 * i + axis] - wanted[7 + axis].exp()).abs() < 1e-6);
        }
        for (k, name) in names.iter().enumerate() {
            for colour in 0..3 {
                let own = harmonics[3 * (k * centers.len() + i) + colour];
                assert!((own - wanted[14 + 15 * colour + k]).abs() < 1e-5, "{name} of {i}");
            }
        }
    }
}

/// A drag with gradients of a model of splats: its shape, and the shape of the same pose without them.
fn dragged(turn: [f64; 3], moves_all: bool, threads: usize) -> (Deformer, ModelShape, ModelShape) {
    let pool = Pool::new(threads).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (_, splats, _) = bar();
    let drag = |gradients: bool| {
        let mut deformer = own_model(&splats, &exec);
        let high = if moves_all { -9.0 } else { 3.5 };
        let mut handles = vec![Handle::new("high", Region::half_space([0.0, 1.0, 0.0], high))];
        if !moves_all {
            handles.push(Handle::new("low", Region::half_space([0.0, -1.0, 0.0], -0.5)));
        }
        deformer.set_handles(handles, &exec).expect("handles");
        let turned = HandlePose::rotation(turn).about([0.0, 2.0, 0.0]);
        let settings = SolveSettings {
            gradients,
            ..SolveSettings::default()
        };
        let shape = deformer
            .drag(&settings)
            .solve([("high", turned)], &exec)
            .expect("solved");
        (deformer, shape)
    };
    let (_, plain) = drag(false);
    assert!(plain.gradients.is_none());
    let (deformer, shape) = drag(true);
    (deformer, shape, plain)
}

#[test]
fn gradients_of_a_rigid_drag_turn_splats_as_the_formula_says() {
    let turn = [0.4, 1.1, -0.7];
    let (deformer, shape, plain) = dragged(turn, true, 2);
    let gradients = shape.gradients.as_deref().expect("asked for");
    let whole = exp_rotation(DVec3::from_array(turn));
    let about = DVec3::new(0.0, 2.0, 0.0);
    assert_eq!(gradients.rotations.len(), shape.len());
    for (v, rest) in deformer.rest().iter().enumerate() {
        let place = about + whole * (*rest - about);
        assert!(shape[v].distance(place) < 1e-5 * deformer.diagonal(), "vertex {v}");
        assert!(shape[v].distance(plain[v]) < 1e-5 * deformer.diagonal(), "vertex {v}");
        // Harmonics turn by it too: a direction is where the formula has it.
        let own = DQuat::from_vec4(gradients.rotations[v].as_dvec4());
        for axis in DVec3::AXES {
            assert!((own * axis).distance(whole * axis) < 1e-5, "vertex {v}");
        }
        assert!((gradients.stretches[v] - glam::Vec3::ONE).length() < 1e-5, "vertex {v}");
        assert!(gradients.shears[v].length() < 1e-5, "vertex {v}");
    }
}

#[test]
fn gradients_of_a_bent_drag_are_those_of_the_exact_field_on_any_number_of_threads() {
    let turn = [0.0, 0.0, 1.2];
    let (deformer, shape, plain) = dragged(turn, false, 1);
    let gradients = shape.gradients.as_deref().expect("asked for");
    let (_, again, _) = dragged(turn, false, 3);
    assert_eq!(Some(gradients), again.gradients.as_deref());
    assert_eq!(shape.positions, again.positions);
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let carrier = deformer.carrier(&plain.positions, &exec).expect("a carrier");
    let splats = deformer.geometry().primitives[0].vertex_count as usize;
    let stretch = carrier.stretch(&pool);
    let spaces = carrier
        .carry_spaces(&stretch, &deformer.rest()[..splats], &exec)
        .expect("carried");
    let mut stretched = 0.0f64;
    for (v, space) in spaces.iter().enumerate() {
        let off = shape[v].distance(space.frame.position);
        assert!(off < 1e-3 * deformer.diagonal(), "splat {v} is off by {off}");
        let [rotation, d, s] = [
            gradients.rotations[v].as_dvec4(),
            gradients.stretches[v].as_dvec3().extend(0.0),
            gradients.shears[v].as_dvec3().extend(0.0),
        ];
        let symmetric = DMat3::from_cols_array(&[d.x, s.z, s.y, s.z, d.y, s.x, s.y, s.x, d.z]);
        let gradient = DMat3::from_quat(DQuat::from_vec4(rotation)) * symmetric;
        let difference = gradient - space.gradient;
        let worst = [difference.x_axis, difference.y_axis, difference.z_axis].map(DVec3::length);
        assert!(worst.iter().all(|length| *length < 0.03), "splat {v}: {worst:?}");
        stretched = stretched.max((d.truncate() - DVec3::ONE).length());
    }
    assert!(stretched > 0.05, "the bar bends: {stretched}");
    // The vertices that are solved have the same places with and without gradients.
    assert_eq!(shape[splats..], plain[splats..]);
    let asked = deformer.gradients(&shape.positions, &exec).expect("gradients");
    assert_eq!(&*asked, gradients, "they are a function of the shape");
}

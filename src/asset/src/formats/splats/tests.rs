use super::cloud::SplatShape;
use super::*;
use glam::{DMat3, DQuat, DVec3, Vec3};
use pliant_exec::pool::Pool;
use pliant_exec::progress::Silent;
use pliant_mesh::carry::{CarriedFrame, CarriedSpace};

/// Numbers between −1 and 1.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }
}

/// A file as 3DGS writes it, with a property that no program knows, of splats that are twice as long as wide.
fn ply_of(count: usize, degree: u8) -> Vec<u8> {
    let rest = cloud::coefficients_of(degree);
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n");
    for name in ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"] {
        header += &format!("property float {name}\n");
    }
    header += "property ushort segment\n";
    for k in 0..rest {
        header += &format!("property float f_rest_{k}\n");
    }
    for name in [
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ] {
        header += &format!("property float {name}\n");
    }
    let mut out = (header + "end_header\n").into_bytes();
    let mut dice = Dice(3);
    for row in 0..count {
        let mut put = |value: f32| out.extend(value.to_le_bytes());
        (0..6).for_each(|_| put(dice.next()));
        out.extend((row as u16).to_le_bytes());
        let mut put = |value: f32| out.extend(value.to_le_bytes());
        (0..rest + 1).for_each(|_| put(0.5 * dice.next()));
        [-3.0, -3.7, -4.1].into_iter().for_each(&mut put);
        (0..4).for_each(|_| put(dice.next()));
    }
    out
}

fn read(name: &str, bytes: impl Into<Bytes>) -> Result<Splats, Error> {
    let files = FileSet::single(name, bytes);
    let format = Splats::format_of(&files, None).expect("a file of splats");
    Splats::read(files, format, &Limits::default(), &Silent)
}

/// The same affine motion of all.
fn moved(splats: &Splats, gradient: DMat3, offset: DVec3) -> Splats {
    let (_, rotation, _) = glam::DAffine3::from_mat3(gradient).to_scale_rotation_translation();
    let space = |center: &DVec3| CarriedSpace {
        frame: CarriedFrame {
            position: gradient * *center + offset,
            rotation,
            scale: 1.0,
        },
        gradient,
    };
    let spaces: Vec<CarriedSpace> = splats.centers().iter().map(space).collect();
    let mut moved = splats.clone();
    moved.carry(0, &spaces, &Pool::new(2).expect("threads"));
    moved
}

fn covariance(splats: &Splats, i: usize) -> DMat3 {
    let shape = splats.shapes[i];
    let turn = DMat3::from_quat(DQuat::from_array(shape.turn.map(f64::from)));
    let variances = shape.log_scale.map(|s| libm::exp(2.0 * f64::from(s)));
    turn * DMat3::from_diagonal(DVec3::from_array(variances)) * turn.transpose()
}

fn size(matrix: DMat3) -> f64 {
    matrix.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max)
}

#[test]
fn a_rigid_motion_turns_centres_ellipsoids_and_colours_as_it_should() {
    let splats = read("a.ply", ply_of(40, 3)).expect("read");
    let (turn, offset) = (
        DQuat::from_rotation_x(0.7) * DQuat::from_rotation_y(-2.1),
        DVec3::new(3.0, -1.0, 0.5),
    );
    let now = read(
        "b.ply",
        moved(&splats, DMat3::from_quat(turn), offset)
            .write(Format::PLY)
            .expect("written")
            .main,
    );
    let now = now.expect("read again");
    // The colour by side, by the formulas of the paper's renderer.
    let colour = |splats: &Splats, i: usize, side: DVec3| -> [f64; 3] {
        let DVec3 { x, y, z } = side;
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let basis = [
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2.0 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3.0 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4.0 * zz - xx - yy),
            0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
            -0.4570457994644658 * x * (4.0 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3.0 * yy),
        ];
        [0, 1, 2].map(|c| {
            let own = &splats.harmonics[i * 45 + c * 15..i * 45 + (c + 1) * 15];
            own.iter().zip(basis).map(|(&k, y)| f64::from(k) * y).sum()
        })
    };
    let rotation = DMat3::from_quat(turn);
    for i in 0..40 {
        assert!(now.centers[i].distance(turn * splats.centers[i] + offset) < 1e-6);
        let wanted = rotation * covariance(&splats, i) * rotation.transpose();
        assert!(size(covariance(&now, i) - wanted) < 1e-5 * size(wanted));
        // Axes keep their order.
        for k in 0..3 {
            assert!((now.shapes[i].log_scale[k] - splats.shapes[i].log_scale[k]).abs() < 1e-5);
        }
        for side in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(0.6, -0.64, 0.48)] {
            let (then, now) = (colour(&splats, i, side), colour(&now, i, turn * side));
            assert!((0..3).all(|c| (then[c] - now[c]).abs() < 1e-5), "{then:?} {now:?}");
        }
    }
}

#[test]
fn a_stretch_by_the_root_of_two_doubles_the_variance_along_it_and_a_small_motion_is_a_small_change() {
    let splats = read("a.ply", ply_of(40, 0)).expect("read");
    let stretch = DMat3::from_diagonal(DVec3::new(1.0, std::f64::consts::SQRT_2, 1.0));
    let now = moved(&splats, stretch, DVec3::ZERO);
    let nudged = moved(
        &splats,
        DMat3::from_quat(DQuat::from_rotation_z(1e-4)) * 1.0001,
        DVec3::ZERO,
    );
    let mirrored = moved(&splats, DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)), DVec3::ZERO);
    let flattened = moved(&splats, DMat3::from_diagonal(DVec3::new(1.0, 0.0, 1.0)), DVec3::ZERO);
    for i in 0..40 {
        let (then, now) = (covariance(&splats, i), covariance(&now, i));
        assert!((now.y_axis.y / then.y_axis.y - 2.0).abs() < 1e-5);
        assert!((now.x_axis.x / then.x_axis.x - 1.0).abs() < 1e-5);
        assert!(size(now - stretch * then * stretch) < 1e-5 * size(now));
        let (then, now) = (splats.shapes[i], nudged.shapes[i]);
        for k in 0..4 {
            assert!((then.turn[k] - now.turn[k]).abs() < 1e-4, "{then:?} {now:?}");
        }
        let mirror = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        let wanted = mirror * covariance(&splats, i) * mirror;
        assert!(size(covariance(&mirrored, i) - wanted) < 1e-5 * size(wanted));
        let flat = covariance(&flattened, i);
        assert!(flat.is_finite() && flat.y_axis.y < 1e-6 * size(flat), "{flat:?}");
    }
}

#[test]
fn what_a_motion_does_not_change_keeps_its_bytes() {
    let file = ply_of(5, 1);
    let splats = read("a.ply", file.clone()).expect("read");
    assert_eq!(splats.write(Format::PLY).expect("written").main, file);
    let mut turned = splats.clone();
    let at = splats.centers[2];
    let space = CarriedSpace {
        frame: CarriedFrame {
            position: at + DVec3::X,
            rotation: DQuat::from_rotation_z(1.0),
            scale: 1.0,
        },
        gradient: DMat3::from_rotation_z(1.0),
    };
    turned.carry(2, &[space], &Pool::new(1).expect("a thread"));
    let written = turned.write(Format::PLY).expect("written").main;
    let row = 4 * 6 + 2 + 4 * (9 + 8);
    let body = file.len() - 5 * row;
    assert_eq!(written.len(), file.len());
    assert_eq!(written[..body + 2 * row], file[..body + 2 * row]);
    assert_eq!(written[body + 3 * row..], file[body + 3 * row..]);
    let (own, then) = (
        &written[body + 2 * row..body + 3 * row],
        &file[body + 2 * row..body + 3 * row],
    );
    // Colour of degree 0 and the unknown number stay, and the opacity; centre and harmonics do not.
    assert_eq!(own[12..26], then[12..26]);
    assert_eq!(own[26 + 36..26 + 40], then[26 + 36..26 + 40]);
    assert!(own[..4] != then[..4] && own[26..62] != then[26..62]);
}

#[test]
fn every_format_comes_back_through_every_other() {
    let splats = read("a.ply", ply_of(30, 3)).expect("read");
    for (format, name) in [(Format::SPLAT, "b.splat"), (Format::SPZ, "b.spz")] {
        let written = splats.write(format).expect("written");
        let names = written
            .warnings
            .iter()
            .map(|w| w.message.as_str())
            .collect::<Vec<_>>()
            .join(" ");
        assert!(names.contains("property `segment`"), "{names}");
        assert_eq!(names.contains("spherical harmonics"), format == Format::SPLAT);
        let again = read(name, written.main.clone()).expect("read again");
        assert_eq!(again.write(format).expect("as it came").main, written.main);
        for i in 0..30 {
            assert!(again.centers[i].distance(splats.centers[i]) < 2e-6);
            let (then, now) = (splats.shapes[i], again.shapes[i]);
            let same: f32 = (0..4).map(|k| then.turn[k] * now.turn[k]).sum();
            assert!(same.abs() > 0.9995, "{then:?} {now:?}");
            assert!((0..3).all(|k| (then.log_scale[k] - now.log_scale[k]).abs() < 0.032));
            assert!((0..3).all(|c| (splats.looks[i].colour[c] - again.looks[i].colour[c]).abs() < 0.02));
            if format == Format::SPZ {
                let own = i * 45..(i + 1) * 45;
                let pairs = splats.harmonics[own.clone()].iter().zip(&again.harmonics[own]);
                assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 0.005));
            }
        }
        // A motion in the file's own format, and the way back to a PLY.
        let turned = moved(&again, DMat3::from_rotation_z(0.5), DVec3::X);
        let in_place = read(name, turned.write(format).expect("written").main).expect("read");
        let as_ply = read("c.ply", turned.write(Format::PLY).expect("written").main).expect("read");
        for i in 0..30 {
            assert!(in_place.centers[i].distance(as_ply.centers[i]) < 2e-6);
            let wanted = covariance(&as_ply, i);
            assert!(size(covariance(&in_place, i) - wanted) < 0.06 * size(wanted));
        }
    }
    assert!(
        splats
            .write(Format::OBJ)
            .expect_err("refused")
            .to_string()
            .contains("choose ply, splat or spz")
    );
}

#[test]
fn files_that_lie_are_refused_and_numbers_that_are_none_are_told() {
    let refusal = |name: &str, bytes: Vec<u8>| read(name, bytes).expect_err("refused").to_string();
    let file = ply_of(4, 1);
    let text = b"element vertex 4\n";
    let at = file.windows(text.len()).position(|w| w == text).expect("there");
    let mut huge = file[..at].to_vec();
    huge.extend(b"element vertex 4000000000\n");
    huge.extend(&file[at + text.len()..]);
    assert!(refusal("a.ply", huge).contains("are left"));
    assert!(refusal("a.ply", file[..file.len() - 1].to_vec()).contains("are left"));
    assert!(refusal("a.splat", vec![0; 33]).contains("whole number of records"));
    assert!(refusal("a.splat", Vec::new()).contains("0 bytes"));

    let packed = read("a.ply", file)
        .expect("read")
        .write(Format::SPZ)
        .expect("written")
        .main;
    assert!(refusal("a.spz", packed[..packed.len() - 20].to_vec()).contains("decompressed"));
    let layout = |change: fn(&mut Vec<u8>)| {
        use std::io::Write as _;
        let mut plain = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&packed[..]), &mut plain).expect("gzip");
        change(&mut plain);
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(&plain).expect("memory");
        encoder.finish().expect("memory")
    };
    assert!(refusal("a.spz", layout(|b| b[8..12].fill(255))).contains("more than"));
    assert!(refusal("a.spz", layout(|b| b[8] = 5)).contains("it holds"));
    assert!(refusal("a.spz", layout(|b| b[4] = 9)).contains("version 9; allowed are 2 and 3"));
    assert!(refusal("a.spz", layout(|b| b[12] = 4)).contains("degree 4"));
    assert!(refusal("a.spz", layout(|b| b[13] = 200)).contains("binary places"));

    let record = |splat: [f32; 6], turn: [u8; 4]| {
        let numbers = splat.into_iter().flat_map(f32::to_le_bytes);
        numbers.chain([128; 4]).chain(turn).collect::<Vec<u8>>()
    };
    assert!(
        refusal(
            "a.splat",
            record([f32::NAN, 0.0, 0.0, 1.0, 1.0, 1.0], [255, 128, 128, 128])
        )
        .contains("not finite")
    );
    for (scale, turn) in [
        (1.0, [128; 4]),
        (-1.0, [255, 128, 128, 128]),
        (f32::INFINITY, [255, 128, 128, 128]),
    ] {
        let file = record([0.0, 0.0, 0.0, 1.0, scale, 1.0], turn);
        let splats = read("a.splat", file.clone()).expect("read");
        let written = moved(&splats, DMat3::from_rotation_x(1.0), DVec3::X)
            .write(Format::SPLAT)
            .expect("written");
        assert!(written.warnings[0].message.starts_with("1 splat has"), "{written:?}");
        // It moves, and what was no shape stays what it was.
        assert_eq!(written.main[..4], 1.0f32.to_le_bytes());
        assert_eq!(written.main[12..], file[12..]);
        for format in [Format::PLY, Format::SPZ] {
            assert!(splats.write(format).is_ok());
        }
    }
    // A splat without thickness turns like any other.
    let flat = read("a.splat", record([0.0, 0.0, 0.0, 1.0, 0.0, 0.5], [255, 128, 128, 128])).expect("read");
    let turned = covariance(
        &moved(&flat, DMat3::from_rotation_z(std::f64::consts::FRAC_PI_2), DVec3::ZERO),
        0,
    );
    assert!((turned.y_axis.y - 1.0).abs() < 1e-6 && turned.x_axis.x < 1e-12 && (turned.z_axis.z - 0.25).abs() < 1e-6);
}

#[test]
fn conversions_tell_what_they_lose_and_keep_the_scales_of_splats_without_a_rotation() {
    let mut splats = read("a.ply", ply_of(3, 1)).expect("read");
    splats.normals = vec![Vec3::X; 3];
    splats.looks[0].colour = [9.0; 3];
    splats.shapes[1] = SplatShape::new([0.0; 4], [-2.0, -3.0, -4.0]);
    splats.harmonics[2 * 9] = 3.0;
    for (format, name, clamped) in [
        (Format::SPLAT, "b.splat", "1 splat has"),
        (Format::SPZ, "b.spz", "2 splats have"),
    ] {
        let written = splats.write(format).expect("written");
        let message = |code: &str| {
            let found = written.warnings.iter().find(|w| w.code == code);
            found.map(|w| w.message.clone()).unwrap_or_default()
        };
        assert!(message("splats-clamped").starts_with(clamped), "{written:?}");
        assert!(message("left-out").contains("normals"), "{written:?}");
        let again = read(name, written.main).expect("readable");
        for (scale, wanted) in again.shapes[1].log_scale.into_iter().zip([-2.0, -3.0, -4.0]) {
            assert!((scale - wanted).abs() < 1e-4, "{format} {scale}");
        }
        // What comes back in its own format has lost its colours already.
        let turned = moved(&again, DMat3::from_rotation_z(0.5), DVec3::X)
            .write(format)
            .expect("written");
        assert!(
            turned.warnings.iter().all(|w| w.code == "splats-unsound") || format == Format::SPZ,
            "{turned:?}"
        );
    }
    let again = read("c.ply", splats.write(Format::PLY).expect("written").main).expect("readable");
    assert!(
        again
            .shapes
            .iter()
            .all(|shape| shape.log_scale.iter().all(|s| s.is_finite()))
    );
}

#[test]
fn a_file_of_some_of_its_splats_has_their_rows_and_all_else() {
    let whole = read("a.ply", ply_of(4, 1)).expect("read");
    let end = b"element tail 1\nproperty uchar t\nend_header\n";
    let file = ply_of(4, 1);
    let at = file.windows(11).position(|w| w == b"end_header\n").expect("there");
    let mut file = [&file[..at], &end[..], &file[at + 11..]].concat();
    file.push(77);
    let packed = whole.write(Format::SPZ).expect("written").main;
    let records = whole.write(Format::SPLAT).expect("written").main;
    for (name, file) in [("a.ply", file), ("a.spz", packed), ("a.splat", records)] {
        let splats = read(name, file).expect("read");
        let some = splats.kept(&[3, 1, 1]);
        let written = some.write(splats.format).expect("written").main;
        assert!(name != "a.ply" || written.last() == Some(&77));
        let again = read(name, written).expect("readable");
        assert_eq!(again.len(), 3);
        for (own, was) in [3, 1, 1].into_iter().enumerate() {
            assert_eq!(again.centers[own], splats.centers[was], "{name}");
            assert_eq!(again.shapes[own], splats.shapes[was]);
            assert_eq!(again.looks[own], splats.looks[was]);
        }
        assert_eq!(again.harmonics, some.harmonics);
    }
}

#[test]
fn centres_that_a_file_rounds_by_more_than_is_seen_are_told() {
    let mut splats = read("a.ply", ply_of(3, 0)).expect("read");
    let rounded = |splats: &Splats, format: Format| {
        let written = splats.write(format).expect("written");
        let warning = written.warnings.into_iter().find(|w| w.code == "places-rounded");
        warning.map(|w| w.message)
    };
    for format in [Format::SPZ, Format::SPLAT] {
        assert_eq!(rounded(&splats, format), None);
    }
    // One splat far away makes the steps of all larger.
    splats.centers[2] = DVec3::new(30_000.1, 0.0, 0.0);
    let message = rounded(&splats, Format::SPZ).expect("rounded");
    assert!(
        message.contains("steps of 3.9e-3") && message.contains("3.000e4"),
        "{message}"
    );
    // Map coordinates in seven digits; what has not moved keeps its bytes.
    splats.centers = (0..3)
        .map(|k| DVec3::new(5e5 + 0.03 * f64::from(k), 4.9e6, 0.0))
        .collect();
    for format in [Format::SPZ, Format::SPLAT] {
        assert!(rounded(&splats, format).is_some(), "{format}");
    }
    assert_eq!(rounded(&splats, Format::PLY), None);
    splats.changes = vec![SplatChange::Moved; 3];
    assert!(rounded(&splats, Format::PLY).expect("rounded").contains("seven digits"));
}

#[test]
fn texts_and_compressed_clouds_are_refused_as_what_they_are() {
    let text = "some words of a line of 32 byte\n".repeat(4);
    let error = read("a.splat", text).expect_err("a text").to_string();
    assert!(error.contains("is a text"), "{error}");
    let packed = "ply\nformat binary_little_endian 1.0\nelement chunk 0\nproperty float min_x\nelement vertex 0\nproperty uint packed_position\n\
        property uint packed_rotation\nend_header\n";
    let files = FileSet::single("a.ply", packed);
    let error = crate::Model::read(files, None, &Limits::default()).expect_err("compressed");
    assert!(error.to_string().contains("compressed Gaussian splats"), "{error}");
}

#[test]
fn a_header_that_claims_more_than_its_file_can_hold_takes_no_memory() {
    // Sixteen bytes of header in some twenty bytes of gzip: the arrays would be hundreds of gigabytes.
    let header = |count: u32| {
        use std::io::Write as _;
        let words = [0x5053_474e, 2, count, 0x0c_03].map(u32::to_le_bytes);
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(words.as_flattened()).expect("memory");
        encoder.finish().expect("memory")
    };
    let refusal = |count: u32, limits: &Limits| {
        let files = FileSet::single("a.spz", header(count));
        Splats::read(files, Format::SPZ, limits, &Silent).expect_err("refused")
    };
    for limits in [Limits::UNLIMITED, Limits::default()] {
        let error = refusal(u32::MAX, &limits).to_string();
        assert!(error.contains("bytes of gzip can hold"), "{error}");
    }
    // What the file could hold is refused by what may be held, before it is unpacked.
    let limits = Limits {
        decoded_bytes: 1 << 10,
        ..Limits::default()
    };
    let error = refusal(100, &limits);
    assert!(matches!(error, Error::TooLarge { limit: 1024, .. }), "{error}");
    assert!(refusal(100, &Limits::default()).to_string().contains("it holds 16"));
}

#[test]
fn splats_far_off_leave_the_cage_of_the_others_as_it_is() {
    let cage = |count: usize, far: &[(usize, f32)]| {
        let mut file = ply_of(count, 0);
        let end = file.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
        let stride = (file.len() - end) / count;
        for &(row, x) in far {
            file[end + row * stride..][..4].copy_from_slice(&x.to_le_bytes());
        }
        let model = crate::Model::read(FileSet::single("a.ply", file), None, &Limits::default()).expect("readable");
        let used = model.triangles.as_flattened().iter();
        let reach = used
            .map(|&v| model.positions[v as usize].abs().max_element())
            .fold(0.0, f64::max);
        (model.triangles.len(), reach)
    };
    for count in [40, 300, 3000] {
        let (triangles, reach) = cage(count, &[]);
        for far in [&[(0, 3e5)][..], &[(0, -1e30), (7, 2e9)]] {
            let with_far = cage(count, far);
            let ratio = with_far.0 as f64 / triangles as f64;
            assert!((0.5..2.0).contains(&ratio), "{count}: {triangles} and {with_far:?}");
            assert!(with_far.1 < 2.0 * reach, "{count}: {reach} and {with_far:?}");
        }
    }
}

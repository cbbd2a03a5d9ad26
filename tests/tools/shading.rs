//! `pliant render` of shapes: normals of the file, sheets of several models, places from near by, triangles that cross.

use crate::render::{SeenPicture, render};
use crate::support::commands::Workplace;
use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits, Model};
use pliant::exec::Exec;
use pliant::mesh::{Crossing, crossing_triangles};
use pliant::pool::Pool;
use pliant::progress::Silent;
use std::fmt::Write as _;

fn drawn(folder: &Workplace, arguments: &str) -> SeenPicture {
    render(folder, &format!("{arguments} -o seen.png")).exits(0);
    SeenPicture::open(&folder.at("seen.png"))
}

/// A round thing of few faces as a text, with normals that make it smooth if `is_smooth`.
fn ball(is_smooth: bool) -> String {
    let (positions, triangles) = pliant::asset::shapes::icosphere(1.0, 1);
    let mut text = String::new();
    for p in &positions {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
        if is_smooth {
            let _ = writeln!(text, "vn {} {} {}", p.x, p.y, p.z);
        }
    }
    for t in &triangles {
        let [a, b, c] = t.map(|v| v + 1);
        let _ = match is_smooth {
            true => writeln!(text, "f {a}//{a} {b}//{b} {c}//{c}"),
            false => writeln!(text, "f {a} {b} {c}"),
        };
    }
    text
}

/// The largest kink of brightness along the middle row, away from the outline.
fn largest_kink(seen: &SeenPicture) -> i32 {
    let row: Vec<i32> = (60..140).map(|x| i32::from(seen.at(x, 100)[1])).collect();
    row.windows(3)
        .map(|w| (w[0] - 2 * w[1] + w[2]).abs())
        .max()
        .unwrap_or(0)
}

#[test]
fn normals_of_the_file_shade_a_ball_without_facets() {
    let folder = Workplace::empty();
    folder.put("smooth.obj", ball(true));
    folder.put("plain.obj", ball(false));
    let kink = |arguments: &str| largest_kink(&drawn(&folder, &format!("{arguments} --size 200x200 --view 13,7")));
    let [smooth, flat] = ["smooth.obj", "smooth.obj --normals flat"].map(kink);
    assert!(smooth <= 4, "{smooth}");
    assert!(flat >= 12, "{flat}");
    assert_eq!(flat, kink("plain.obj --normals flat"));
    // As a GLB, smooth and without normals, which glTF calls flat.
    for (name, wanted) in [("smooth", smooth), ("plain", flat)] {
        let files = FileSet::single("ball.obj", folder.bytes(&format!("{name}.obj")));
        let model = Model::read(files, None, &Limits::default()).expect("a model");
        let glb = model.write(&model.positions, Format::GLB).expect("writable");
        folder.put("ball.glb", glb.main);
        assert_eq!(kink("ball.glb"), wanted, "{name}");
    }
}

/// Two squares in one plane, and a blade that stands on it, `at` along x.
fn pierced(at: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for i in 0..5u32 {
        for j in 0..5u32 {
            positions.push(DVec3::new(f64::from(i) - 2.0, f64::from(j) - 2.0, 0.0));
        }
    }
    for i in 0..4 {
        for j in 0..4 {
            let v = i * 5 + j;
            triangles.extend([[v, v + 5, v + 6], [v, v + 6, v + 1]]);
        }
    }
    positions.extend([[-1.1, -0.5], [0.7, -0.5], [0.7, 0.5]].map(|[y, z]| DVec3::new(at, y, z)));
    triangles.push([25, 26, 27]);
    (positions, triangles)
}

fn as_obj((positions, triangles): &(Vec<DVec3>, Vec<[u32; 3]>)) -> String {
    let mut text = String::new();
    positions
        .iter()
        .for_each(|p| text += &format!("v {} {} {}\n", p.x, p.y, p.z));
    triangles
        .iter()
        .for_each(|t| text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
    text
}

#[test]
fn triangles_that_cross_are_red_and_those_that_crossed_before_are_not() {
    let folder = Workplace::empty();
    let (now, before) = (pierced(0.3), pierced(-1.6));
    folder.put("now.obj", as_obj(&now));
    folder.put("before.obj", as_obj(&before));
    let (positions, triangles) = &now;
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let crossing = crossing_triangles(positions, None, triangles, &exec).expect("no cancel");
    let count = crossing.iter().filter(|c| **c == Crossing::New).count();
    assert!(count > 2 && count < 10, "{count}");

    let is_red = |p: [u8; 3]| p[0] > 120 && p[1] < 60 && p[2] < 60;
    let is_amber = |p: [u8; 3]| p[0] > 150 && p[1] > 90 && p[2] < 90;
    let look = |seen: &SeenPicture, is_shown: &dyn Fn([u8; 3]) -> bool, left: f64| {
        for (t, crossing) in triangles.iter().zip(&crossing).take(32) {
            let middle = t.iter().map(|&v| positions[v as usize]).sum::<DVec3>() / 3.0;
            // 92 % of 200 pixels, less those of the key, for four units.
            let scale = 0.23 * (200.0 - 14.0);
            let (x, y) = (left + 100.0 + middle.x * scale, 93.0 - middle.y * scale);
            let shown = is_shown(seen.at(x as usize, y as usize));
            assert_eq!(
                shown,
                *crossing == Crossing::New,
                "triangle {t:?}: {:?}",
                seen.at(x as usize, y as usize)
            );
        }
    };
    let arguments = "--color crossings --size 200x200 --view front";
    let ran = render(&folder, &format!("now.obj {arguments} -o seen.png")).exits(0);
    assert!(
        ran.last().contains(&format!("{count} triangles cross")),
        "{}",
        ran.last()
    );
    look(&SeenPicture::open(&folder.at("seen.png")), &is_red, 0.0);
    // How deep they cross is shown of new pairs alone, darkest where it is most.
    let depths = "--color contact --size 200x200 --view front";
    let ran = render(&folder, &format!("now.obj --before before.obj {depths} -o depths.png")).exits(0);
    assert!(
        ran.last().contains("pairs cross, up to ") && ran.last().contains(" deep"),
        "{}",
        ran.last()
    );
    let ran = render(&folder, &format!("now.obj --rest now.obj {depths} -o none.png")).exits(0);
    assert!(ran.last().contains("0 pairs cross"), "{}", ran.last());
    // Compared with another place of the blade all pairs are new; with itself none is.
    look(
        &drawn(&folder, &format!("now.obj --before before.obj {arguments}")),
        &is_red,
        200.0,
    );
    look(
        &drawn(&folder, &format!("now.obj --rest now.obj {arguments}")),
        &is_amber,
        200.0,
    );
}

#[test]
fn models_fill_a_sheet_with_their_names_by_one_camera() {
    let folder = Workplace::empty();
    folder.put("a.obj", ball(true));
    folder.put("b.obj", as_obj(&pierced(0.3)));
    let size = |seen: &SeenPicture| (seen.width, seen.height);
    let three = drawn(&folder, "a.obj b.obj a.obj --size 120x120 --columns 3 --view front");
    assert_eq!(size(&three), (360, 120));
    let tile = |seen: &SeenPicture, left: usize| -> Vec<[u8; 3]> {
        (20..120)
            .flat_map(|y| (left..left + 120).map(move |x| (x, y)))
            .map(|(x, y)| seen.at(x, y))
            .collect()
    };
    assert!(tile(&three, 0) == tile(&three, 240) && tile(&three, 0) != tile(&three, 120));
    assert!(
        (0..40).any(|x| (4..12).any(|y| three.drawn(x, y))),
        "a name in the corner"
    );
    let two = drawn(&folder, "a.obj b.obj --size 120x120 --view front,side,30,20");
    assert_eq!(size(&two), (360, 240), "a row for each model, a column for each view");
    // A ball of one unit beside a sheet of four: alone, each fills its tile.
    let width = |seen: &SeenPicture| (0..120).filter(|&x| seen.drawn(x, 60)).count();
    let [shared, own] = ["", "--fit-each"].map(|more| {
        width(&drawn(
            &folder,
            &format!("a.obj b.obj --size 120x120 --columns 2 --view front {more}"),
        ))
    });
    assert!(own > shared + 30, "{own} {shared}");
    let bytes = |threads: usize| {
        drawn(
            &folder,
            &format!("a.obj b.obj --size 120x120 --view top,left --threads {threads}"),
        );
        folder.bytes("seen.png")
    };
    assert!(bytes(1) == bytes(3));
    render(&folder, &format!("{} -o seen.png", "a.obj ".repeat(65)))
        .exits(2)
        .gives(&["at most 64"]);
    render(&folder, "a.obj --view front,side --turntable 4 -o seen.png")
        .exits(2)
        .gives(&["--turntable"]);
}

#[test]
fn a_close_up_goes_where_it_is_asked_to() {
    let folder = Workplace::empty();
    let (mut now, rest) = (pierced(0.3), pierced(0.3));
    folder.put("rest.obj", as_obj(&rest));
    now.0[24].z += 0.2;
    folder.put("now.obj", as_obj(&now));
    let arguments = "now.obj --before rest.obj --color difference --size 100x100 --view front";
    let is_red = |p: [u8; 3]| i32::from(p[0]) > i32::from(p[2]) + 40;
    let seen = drawn(&folder, &format!("{arguments} --close-up worst,0.4"));
    // The corner is in the middle: a quarter of the picture is surface, red at the corner.
    assert!(
        is_red(seen.at(148, 48)) && !seen.drawn(156, 40) && seen.drawn(110, 80),
        "{:?}",
        seen.at(148, 48)
    );
    let beside = |x: usize| seen.at(x, 50);
    assert!(
        beside(48) == beside(20) && beside(48) != beside(56),
        "the same place before"
    );
    let same = drawn(&folder, &format!("{arguments} --close-up vertex:24,0.4"));
    assert!(same.pixels == seen.pixels);
    for (place, reason) in [
        ("vertex:99", "vertex 99 does not exist"),
        ("nobody,1", "nothing here has a name"),
        ("1,2", "box:"),
        ("0,0,99", "outside the model, which reaches from (-"),
    ] {
        render(&folder, &format!("now.obj --close-up {place} -o no.png"))
            .exits(2)
            .gives(&[reason]);
    }
    render(&folder, "now.obj --close-up worst -o no.png")
        .exits(2)
        .gives(&["--close-up", "--color"]);
}

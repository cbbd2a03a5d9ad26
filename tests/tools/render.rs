//! `pliant render` as a script sees it: which pixels show what, the same bytes for any number of threads, refusals.

use crate::support::commands::{Ran, Workplace};
use std::fs;
use std::path::Path;

/// Runs `pliant render`, which may replace pictures.
pub fn render(folder: &Workplace, arguments: &str) -> Ran {
    folder.run(&format!("render --force {arguments}"))
}

/// Draws a picture, and reads it back.
fn drawn(folder: &Workplace, arguments: &str, name: &str) -> SeenPicture {
    render(folder, &format!("{arguments} -o {name}")).exits(0);
    SeenPicture::open(&folder.at(name))
}

/// A picture read back.
pub struct SeenPicture {
    pub width: usize,
    pub height: usize,
    pub pixels: Vec<[u8; 3]>,
}

impl SeenPicture {
    pub fn open(path: &Path) -> Self {
        let file = std::io::BufReader::new(fs::File::open(path).expect("a picture"));
        let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
        let mut bytes = vec![0; reader.output_buffer_size().expect("it fits")];
        let facts = reader.next_frame(&mut bytes).expect("an image");
        assert_eq!(
            (facts.color_type, facts.bit_depth),
            (png::ColorType::Rgb, png::BitDepth::Eight)
        );
        let pixels = bytes.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        Self {
            width: facts.width as usize,
            height: facts.height as usize,
            pixels,
        }
    }

    pub fn at(&self, x: usize, y: usize) -> [u8; 3] {
        self.pixels[y * self.width + x]
    }

    /// Whether something is drawn there: the background has one colour in every row.
    pub fn drawn(&self, x: usize, y: usize) -> bool {
        self.at(x, y) != self.at(0, y)
    }

    /// How many pixels are dark, as wires are.
    fn dark(&self) -> usize {
        self.pixels.iter().filter(|p| p.iter().all(|&c| c < 110)).count()
    }

    /// What is drawn in a row, from a column up to another.
    fn row(&self, y: usize, columns: std::ops::Range<usize>) -> Vec<[u8; 3]> {
        let drawn = columns.filter(|&x| self.drawn(x, y));
        drawn.map(|x| self.at(x, y)).collect()
    }

    /// First and last column and row where something is drawn, between two columns.
    fn reach(&self, columns: std::ops::Range<usize>) -> [usize; 4] {
        let mut found = [usize::MAX, 0, usize::MAX, 0];
        for y in 0..self.height {
            for x in columns.clone().filter(|&x| self.drawn(x, y)) {
                found = [found[0].min(x), found[1].max(x), found[2].min(y), found[3].max(y)];
            }
        }
        found
    }
}

fn red(p: [u8; 3]) -> bool {
    i32::from(p[0]) > i32::from(p[2]) + 60
}

fn blue(p: [u8; 3]) -> bool {
    i32::from(p[2]) > i32::from(p[0]) + 60
}

/// A flat strip from x = -2 to 2 and y = -0.5 to 0.5 in 16 × 4 cells, each vertex moved by `place`.
fn strip(place: impl Fn(f64, f64) -> [f64; 3]) -> String {
    let mut text = String::new();
    for i in 0..=16 {
        for j in 0..=4 {
            let [x, y, z] = place(f64::from(i) * 0.25 - 2.0, f64::from(j) * 0.25 - 0.5);
            text += &format!("v {x} {y} {z}\n");
        }
    }
    for i in 0..16 {
        for j in 0..4 {
            let at = |i: i32, j: i32| i * 5 + j + 1;
            text += &format!(
                "f {} {} {} {}\n",
                at(i, j),
                at(i + 1, j),
                at(i + 1, j + 1),
                at(i, j + 1)
            );
        }
    }
    text
}

/// A folder with the strip in the rest pose, and one whose right half is twice as long and left half two thirds as long.
fn workplace() -> Workplace {
    let folder = Workplace::empty();
    folder.put("rest.obj", strip(|x, y| [x, y, 0.0]));
    let pulled = |x: f64, y: f64| {
        if x > 0.0 {
            [2.0 * x, y, 0.0]
        } else {
            [x / 1.5, y / 1.5, 0.0]
        }
    };
    folder.put("pulled.obj", strip(pulled));
    let moved = |x: f64, y: f64| [x, y + if x > 1.0 { 0.25 * (x - 1.0) } else { 0.0 }, 0.0];
    folder.put("moved.obj", strip(moved));
    folder
}

#[test]
fn a_shape_covers_the_pixels_that_it_should() {
    let folder = workplace();
    let ran = render(&folder, "rest.obj -o rest.png --size 200x100 --view 0,0").exits(0);
    assert_eq!(ran.out, "", "{}", ran.err);
    let last = ran.last();
    assert!(last.contains("rest.png") && last.contains("200x100"), "{last}");
    let seen = SeenPicture::open(&folder.at("rest.png"));
    assert_eq!((seen.width, seen.height), (200, 100));
    // Four times as wide as high, in the middle, 92 % of the width: 184 by 46 pixels.
    assert_eq!(seen.reach(0..200), [8, 191, 27, 72]);
    assert!((30..70).all(|y| (10..190).all(|x| seen.drawn(x, y))), "it has no hole");
    // From the side nothing but an edge is left.
    let edge = drawn(&folder, "rest.obj --size 200x100 --view 0,90", "edge.png");
    assert!((0..100).all(|y| (0..200).all(|x| !edge.drawn(x, y))));
}

#[test]
fn chosen_primitives_are_seen_alone_and_fill_the_picture() {
    let folder = Workplace::with("figure.glb", pliant::asset::sample::figure_glb());
    let picture = |chosen: &str| {
        drawn(
            &folder,
            &format!("figure.glb --size 160x160 --view 0,0 {chosen}"),
            "p.png",
        );
        folder.bytes("p.png")
    };
    let [all, hull, body] = ["", "--primitive hull", "--primitive body"].map(picture);
    assert!(hull != body, "the hull lies around the body");
    assert_eq!(picture("--primitive 3"), hull, "by its number as well");
    let every = "--primitive body --primitive lod1 --primitive lod2 --primitive hull";
    assert!(
        picture(every) != body,
        "the levels of detail and the hull are drawn where they are named"
    );
    assert_eq!(all, body, "and not otherwise");
    let ran = render(&folder, "figure.glb -o all.png --view 0,0").exits(0);
    ran.says(&["hulls are not drawn, there are lod1, lod2, hull; --primitive draws what it names"]);
    let ran = render(&folder, "figure.glb -o p.png --primitive hat").exits(2);
    ran.gives(&[r#"--primitive hat: no primitive is named so; there are 0 "body", 1 "lod1""#]);
    // Two squares far apart: alone, one of them fills what both share.
    folder.put("two.gltf", two_squares());
    let reach = |chosen: &str| {
        let seen = drawn(
            &folder,
            &format!("two.gltf --size 100x100 --view 0,0 {chosen}"),
            "two.png",
        );
        let [left, right, top, bottom] = seen.reach(0..100);
        [right - left, bottom - top]
    };
    let [both, far] = ["", "--primitive far"].map(reach);
    assert!(both[0] > 80 && both[1] < 20, "{both:?}");
    assert!(far[0] > 80 && far[1] > 80, "{far:?}");
}

/// A square, and the same one nine units to its right.
fn two_squares() -> String {
    use base64::Engine as _;
    let corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]];
    let bytes: Vec<u8> = corners
        .as_flattened()
        .iter()
        .flat_map(|&x| (x as f32).to_le_bytes())
        .collect();
    let uri = base64::engine::general_purpose::STANDARD.encode(&bytes);
    serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"name": "near", "mesh": 0}, {"name": "far", "mesh": 0, "translation": [9, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 6, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": bytes.len()}],
        "buffers": [{"byteLength": bytes.len(), "uri": format!("data:application/octet-stream;base64,{uri}")}],
    })
    .to_string()
}

#[test]
fn a_picture_never_replaces_what_the_model_is_made_of() {
    let folder = workplace();
    let text = String::from_utf8(folder.bytes("rest.obj")).expect("text");
    folder.put("skin.obj", format!("mtllib skin.mtl\nusemtl a\n{text}"));
    folder.put("skin.mtl", "newmtl a\nmap_Kd skin.png\n");
    folder.put("skin.png", "a picture");
    render(&folder, "skin.obj -o skin.png")
        .exits(2)
        .gives(&["skin.obj is made of it"]);
    assert_eq!(folder.bytes("skin.png"), b"a picture");
}

#[test]
fn colours_say_where_edges_are_longer_and_where_shorter() {
    let folder = workplace();
    let seen = drawn(
        &folder,
        "pulled.obj --before rest.obj --size 240x160 --view 0,0",
        "two.png",
    );
    assert_eq!(
        (seen.width, seen.height),
        (480, 160),
        "before on the left, after on the right"
    );
    // Rows of the key, at the bottom, count as drawn; leave them out.
    let above = |p: &[usize; 4]| p[2]..130;
    let [before, after] = [seen.reach(0..240), seen.reach(240..480)];
    let middle = 75;
    assert!(above(&before).contains(&middle) && above(&after).contains(&middle));
    // One scale for both: 4 units before, 5.33 after, one camera.
    let columns = |from: usize| (from..from + 240).filter(|&x| seen.drawn(x, middle)).count() as f64;
    let ratio = columns(240) / columns(0);
    assert!((ratio - 5.333 / 4.0).abs() < 0.02, "{ratio}");
    let row = seen.row(middle, 240..480);
    let end = row.len() - 1;
    assert!(
        red(row[end - 5]) && red(row[end / 2 + end / 4]),
        "stretched: {:?}",
        row[end - 5]
    );
    assert!(blue(row[5]) && blue(row[end / 8]), "squeezed: {:?}", row[5]);
    assert!(
        (0..240).all(|x| !red(seen.at(x, middle)) && !blue(seen.at(x, middle))),
        "before has no colours"
    );
    // The key below shows both ends of the ramp.
    let key = || (0..480).flat_map(|x| (145..160).map(move |y| (x, y)));
    assert!(key().any(|(x, y)| red(seen.at(x, y))) && key().any(|(x, y)| blue(seen.at(x, y))));
}

#[test]
fn differences_and_wires_show_where_they_are() {
    let folder = workplace();
    let draw = |arguments: &str, name: &str| drawn(&folder, &format!("{arguments} --size 240x160 --view 0,0"), name);
    let seen = draw("moved.obj --before rest.obj --color difference", "d.png");
    let middle = 75;
    let row = seen.row(middle, 240..480);
    let end = row[row.len() - 4];
    assert!(red(end), "the end moved: {end:?}");
    let light = |p: [u8; 3]| p.iter().all(|&c| c > 150);
    assert!(
        row[..row.len() / 2].iter().all(|&p| light(p)),
        "the rest did not: {:?}",
        row[0]
    );

    let (wires, plain) = (draw("rest.obj --color wire", "w.png"), draw("rest.obj", "p.png"));
    assert_eq!(plain.dark(), 0);
    assert!(wires.dark() > 300, "{}", wires.dark());
}

#[test]
fn wires_lie_over_colours_and_a_range_makes_pictures_comparable() {
    let folder = workplace();
    let draw = |name: &str, more: &str| {
        let arguments = "moved.obj --before rest.obj --color difference --size 240x160 --view 0,0";
        drawn(&folder, &format!("{arguments} {more}"), name)
    };
    let plain = draw("plain.png", "");
    let wired = draw("wired.png", "--wire");
    let row = |seen: &SeenPicture| seen.row(75, 240..480);
    assert!(wired.dark() > plain.dark() + 200);
    assert!(wired.pixels.iter().any(|&p| red(p)), "the colours are still there");
    // A quarter of a unit is the most; on a scale of ten units it is nearly nothing.
    let wide = draw("wide.png", "--range 10");
    assert!(row(&plain).iter().any(|&p| red(p)) && !row(&wide).iter().any(|&p| red(p)));
}

#[test]
fn marks_are_rings_around_what_differs_most() {
    let folder = workplace();
    let draw = |name: &str, marks: &str| {
        let arguments = "moved.obj --before rest.obj --color difference --size 240x160 --view 0,0";
        drawn(&folder, &format!("{arguments} --marks {marks}"), name)
    };
    let (none, some) = (draw("none.png", "0"), draw("some.png", "2"));
    let changed: Vec<usize> = (0..some.pixels.len())
        .filter(|&k| some.pixels[k] != none.pixels[k])
        .collect();
    assert!(changed.len() > 100, "{}", changed.len());
    // The strip's far end moved, which is on the right of the picture on the right.
    assert!(
        changed.iter().all(|k| k % some.width > 400),
        "{:?}",
        changed.iter().map(|k| k % some.width).min()
    );
    render(&folder, "rest.obj --marks 2 -o no.png")
        .exits(2)
        .gives(&["--marks"]);
}

#[test]
fn a_turntable_is_a_strip_once_around() {
    let folder = workplace();
    let arguments = "moved.obj --size 64x48 --view -45,10 --turntable 8 --up z";
    let seen = drawn(&folder, arguments, "t.png");
    assert_eq!((seen.width, seen.height), (512, 48));
    let tile = |k: usize| -> Vec<[u8; 3]> {
        (0..48)
            .flat_map(|y| (0..64).map(move |x| (x, y)))
            .map(|(x, y)| seen.at(64 * k + x, y))
            .collect()
    };
    for k in 0..8 {
        assert!(
            (64 * k..64 * k + 64).any(|x| seen.drawn(x, 24)),
            "view {k} shows something"
        );
        assert!(tile(k) != tile((k + 1) % 8), "view {k} is another one than the next");
    }
}

#[test]
fn the_same_bytes_for_any_number_of_threads_and_twice() {
    let folder = workplace();
    folder.put("creature.glb", pliant::asset::sample::creature_glb());
    let bytes = |arguments: &str, threads: &str| {
        drawn(
            &folder,
            &format!("{arguments} --size 300x200 --threads {threads}"),
            "x.png",
        );
        folder.bytes("x.png")
    };
    for arguments in [
        "creature.glb --color wire",
        "creature.glb --before creature.glb --color difference",
        "pulled.obj --before rest.obj --turntable 3",
    ] {
        let one = bytes(arguments, "1");
        for threads in ["2", "3", "1"] {
            assert!(one == bytes(arguments, threads), "{arguments}, {threads} threads");
        }
    }
}

#[test]
fn a_refusal_is_exit_2_with_its_reason_last_and_no_picture() {
    let folder = workplace();
    folder.put("nan.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    folder.put("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n");
    folder.put("flat.obj", "v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n");
    folder.put("empty.obj", "");
    folder.put("other.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let cases: [(&str, &str); 19] = [
        ("none.obj", "none.obj"),
        ("nan.obj", "line 1"),
        ("points.obj", "no triangle"),
        ("flat.obj", "none of 1 triangles"),
        ("empty.obj", "empty.obj"),
        ("rest.obj --size 15x100", "16 to 8192"),
        ("rest.obj --size 100x9000", "16 to 8192"),
        ("rest.obj --size big", "800x600"),
        ("rest.obj --view 10", "30,20"),
        ("rest.obj --view 0,nan", "-90 to 90"),
        ("rest.obj --turntable 1", "--turntable"),
        ("rest.obj --turntable 64 --size 8192x8192", "pixels"),
        ("rest.obj --color distortion", "--before"),
        ("rest.obj --color rainbow", "rainbow"),
        ("rest.obj --before other.obj --color difference", "85 vertices"),
        ("rest.obj --threads 5000", "0 to 1024"),
        ("rest.obj --range 0", "above 0"),
        ("rest.obj --before moved.obj --range 0.5", "above 1"),
        ("rest.obj --before moved.obj --marks 10", "--marks"),
    ];
    for (arguments, reason) in cases {
        let ran = render(&folder, &format!("{arguments} -o out.png")).exits(2);
        ran.gives(&[reason]);
        assert!(ran.out.is_empty() && !folder.at("out.png").exists(), "{arguments:?}");
    }
    for output in ["out.jpg", "out", "folder/"] {
        render(&folder, &format!("rest.obj -o {output}"))
            .exits(2)
            .gives(&["png"]);
    }
    // Models that cannot be compared vertex by vertex can still be seen side by side.
    render(&folder, "rest.obj --before other.obj -o both.png").exits(0);
}

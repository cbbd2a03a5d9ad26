//! Pictures of animations beside another method's, near by, begun in the rest pose; and of what a rig holds in a model.

use super::refusals::contents;
use super::{animate, animate_bar, bar_folder, run_bar};
use crate::support::commands::Workplace;
use std::fs;
use std::path::Path;

/// A picture read back.
struct SeenPicture {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

impl SeenPicture {
    fn read_from(path: &Path) -> Self {
        let file = std::io::BufReader::new(fs::File::open(path).expect("a picture"));
        let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
        let mut bytes = vec![0; reader.output_buffer_size().expect("small")];
        let facts = reader.next_frame(&mut bytes).expect("an image");
        Self {
            width: facts.width as usize,
            height: facts.height as usize,
            pixels: bytes.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect(),
        }
    }

    fn colour_at(&self, x: usize, y: usize) -> [u8; 3] {
        self.pixels[y * self.width + x]
    }

    /// The pixels of a tile.
    fn tile(&self, [x, y]: [usize; 2], [width, height]: [usize; 2]) -> Vec<[u8; 3]> {
        let rows = (y..y + height).flat_map(|y| (x..x + width).map(move |x| (x, y)));
        rows.map(|(x, y)| self.colour_at(x, y)).collect()
    }
}

fn is_strong(pixel: &[u8; 3]) -> bool {
    pixel[0].abs_diff(pixel[2]) > 60
}

#[test]
fn frames_stand_beside_linear_blend_skinning_after_the_rest_shape() {
    let folder = &bar_folder();
    animate_bar(
        folder,
        "-o sheet.png --rest --tiles 3 --tile 64x48 --color stretch --beside lbs",
    );
    let seen = SeenPicture::read_from(&folder.join("sheet.png"));
    assert_eq!(
        (seen.width, seen.height),
        (3 * 64, 2 * 48 + 40),
        "wide tiles stand above each other"
    );
    let tile = |column: usize, row: usize| seen.tile([64 * column, 48 * row], [64, 48]);
    assert_eq!(tile(0, 0), tile(0, 1), "both methods leave the rest shape as it is");
    assert!(
        !tile(0, 0).iter().any(is_strong),
        "and nothing of it is longer or shorter"
    );
    // The clip begins with the rest shape.
    assert_ne!(tile(2, 0), tile(2, 1), "they differ in the last frame");
    assert!(tile(2, 0).iter().any(is_strong), "the bend is seen in colours");
    animate_bar(folder, "-o bar.apng --tile 40x48 --frames 0:5 --beside lbs");
    let moving = SeenPicture::read_from(&folder.join("bar.apng"));
    assert_eq!((moving.width, moving.height), (80, 48), "high ones beside each other");
    animate_bar(
        folder,
        "-o sides.png --tiles 1 --tile 64x64 --frames 0:1 --view front,side,top",
    );
    let sides = SeenPicture::read_from(&folder.join("sides.png"));
    assert_eq!((sides.width, sides.height), (3 * 64, 64));
    let side = |k: usize| sides.tile([64 * k, 0], [64, 64]);
    let drawn = |k: usize| {
        (side(k).iter().enumerate())
            .filter(|(n, p)| **p != side(k)[n / 64 * 64])
            .count()
    };
    assert!((0..3).all(|k| drawn(k) > 20) && side(0) != side(1) && side(1) != side(2));
}

#[test]
fn a_wrist_that_is_turned_over_stays_thick_where_skinning_wrings_it() {
    let folder = &Workplace::empty();
    folder.done("sample body -o body.glb");
    folder.done("sample twist -o twist.bvh");
    folder.done("rig body.glb --bvh twist.bvh -o rig.json --no-picture");
    let arguments = "body.glb --bvh twist.bvh --rig rig.json -o twist.png --tiles 2 --tile 160x90 --view 0,0 --beside lbs \
                     --close-up lHand,0.18 --frames 0:51 --fps 30";
    animate(folder, arguments).well();
    let seen = SeenPicture::read_from(&folder.join("twist.png"));
    assert_eq!((seen.width, seen.height), (320, 180));
    // How many pixels the arm has at its thinnest near the wrist, which is in the middle; right of the hand there is the sky.
    let thickness = |column: usize, row: usize| {
        let of_column = |x: usize| {
            let rows = 90 * row..90 * row + 90;
            let is_drawn = |y: &usize| seen.colour_at(160 * column + x, *y) != seen.colour_at(160 * column + 159, *y);
            rows.filter(is_drawn).count()
        };
        (60..100).map(of_column).min().expect("columns")
    };
    let [rest, skinned, solved] = [thickness(0, 1), thickness(1, 0), thickness(1, 1)];
    assert!(rest > 10, "{rest}");
    assert!(3 * skinned < rest, "skinning: {skinned} of {rest}");
    assert!(4 * solved > 3 * rest, "solved: {solved} of {rest}");
}

#[test]
fn pictures_that_make_no_sense_are_refused_before_anything_is_written() {
    let folder = &bar_folder();
    let before = contents(folder);
    let cases: [(&str, &str); 8] = [
        ("-o a.apng --rest", "--tiles and --rest are for .png"),
        ("-o a.png --rest --tiles 1", "2 or more are needed"),
        (
            "-o a.pc2 --beside lbs",
            "--beside and --close-up are for .png and .apng",
        ),
        ("-o a.png --beside dqs", "possible values: lbs"),
        ("-o a.png --close-up high,wide", "such as leftHand,0.3"),
        ("-o a.png --close-up high,-1", "a radius above 0"),
        ("-o a.png --close-up 99,0,0", "outside the model, which reaches from"),
        (
            "-o a.png --close-up tail,0.5",
            "\"tail\" is not a bone, node or primitive; there are low, high",
        ),
    ];
    for (arguments, wanted) in cases {
        run_bar(folder, arguments).refused(&[wanted]);
        assert_eq!(contents(folder), before, "{arguments:?}");
    }
}

#[test]
fn a_model_is_opened_towards_the_eye_with_what_a_rig_holds_in_it() {
    let folder = &bar_folder();
    let drawn = folder.done("render bar.obj --rig rig.json -o cut.png --size 200x100 --view 0,0");
    drawn.says(&["rotations of ", " nodes and positions of "]);
    let seen = SeenPicture::read_from(&folder.join("cut.png"));
    assert_eq!((seen.width, seen.height), (200, 100));
    // The bar is six units long and fills 92 % of the width.
    let near = |x: f64, wanted: &dyn Fn([i32; 3]) -> bool| {
        let middle = (100.0 + x * 184.0 / 6.0) as usize;
        let around = seen.tile([middle - 5, 40], [10, 20]);
        around.iter().any(|p| wanted(p.map(i32::from)))
    };
    let green = |[r, g, b]: [i32; 3]| g > r + 40 && g > b + 30;
    let orange = |[r, g, b]: [i32; 3]| r > g + 40 && g > b + 40;
    for place in [-1.5, 1.2] {
        assert!(near(place, &green), "a bone turns at {place}");
    }
    for place in [-2.6, 0.0] {
        assert!(near(place, &orange), "a joint is held at {place}");
    }
    assert!(
        !near(2.85, &green) && !near(2.85, &orange),
        "nothing is beyond the last joint"
    );

    let rig = folder.text("rig.json");
    folder.put("far.json", rig.replace(", 0, 0]", ", 900, 0]"));
    for rig in ["far.json", "bar.bvh"] {
        let arguments = format!("render bar.obj -o no.png --rig {rig}");
        folder.refused(&arguments, &[&format!("{rig}: ")]);
        assert!(!folder.join("no.png").exists());
    }
}

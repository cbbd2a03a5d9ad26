//! Every output of one small animation.

use super::{FRAMES, STEP, animate_bar, bar_folder, farthest, read_cache, read_glb, run_bar};
use crate::support::commands::Workplace;
use crate::support::gltf_parsed::Parsed;
use crate::support::khronos;
use crate::support::skinning::{ClipTime, clip_length, draw, list};
use glam::{DVec3, Vec3};
use pliant::asset::{FileSet, Limits, Model};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// The positions of numbered models.
fn read_folder(folder: &Path, extension: &str) -> Vec<Vec<DVec3>> {
    let read = |k: usize| {
        let name = format!("frame_{k:05}.{extension}");
        let bytes = fs::read(folder.join(&name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let model = Model::read(FileSet::single(name, bytes), None, &Limits::default()).expect("a model");
        model.positions.clone()
    };
    (0..FRAMES).map(read).collect()
}

/// For each vertex that a GLB of the bar draws the vertex of the bar that stands where it does.
fn bar_vertices(drawn: &[DVec3], bar: &[Vec3]) -> Vec<usize> {
    let same = |p: &DVec3| bar.iter().position(|q| p.distance(q.as_dvec3()) < 1e-6);
    drawn.iter().map(|p| same(p).expect("a vertex of the bar")).collect()
}

fn rest_of_bar(folder: &Workplace) -> Vec<Vec3> {
    let bytes = folder.bytes("bar.obj");
    let model = Model::read(FileSet::single("bar.obj", bytes), None, &Limits::default()).expect("the bar");
    model.positions.iter().map(|p| p.as_vec3()).collect()
}

/// How far a GLB of the bar draws each of its vertices from where bar.pc2 has it, frame by frame.
fn offs_of_bar(folder: &Workplace, file: &Parsed) -> Vec<f64> {
    let (_, frames) = read_cache(&folder.join("bar.pc2"));
    assert_eq!(frames.len(), FRAMES);
    let still = draw(file, None, &[]).expect("it is drawn").swap_remove(0);
    let same = bar_vertices(&still.positions, &rest_of_bar(folder));
    let off = frames.iter().enumerate().flat_map(|(k, frame)| {
        let at = ClipTime {
            clip: 0,
            seconds: STEP * k as f64,
        };
        let drawn = draw(file, Some(at), &[]).expect("it is drawn").swap_remove(0);
        // A vertex on the seam is there several times.
        let mut offs = vec![0.0f64; frame.len()];
        for (p, v) in drawn.positions.iter().zip(&same) {
            offs[*v] = offs[*v].max(p.distance(frame[*v].as_dvec3()));
        }
        offs
    });
    off.collect()
}

/// The farthest of them all.
pub(super) fn farthest_of_bar(folder: &Workplace, file: &Parsed) -> f64 {
    offs_of_bar(folder, file).into_iter().fold(0.0, f64::max)
}

/// The percentage after a text in a line of what was said.
pub(super) fn percent_after(said: &str, text: &str) -> f64 {
    let (_, rest) = said.split_once(text).unwrap_or_else(|| panic!("no {text:?} in {said}"));
    let (number, _) = rest.split_once(" %").expect("a percentage");
    number.trim().parse().expect("a number")
}

/// Plays the bar's clip into bar.glb: how far the report says that the file is off bar.pc2, which is checked, and the file.
/// So is what stderr says to people: `words`, and the largest distance.
pub(super) fn written_error(folder: &Workplace, options: &str, words: &str) -> (Value, Parsed) {
    let said = animate_bar(folder, &format!("-o bar.glb {options} --force"));
    let mut report = run_bar(folder, &format!("-o bar.glb {options} --json --force")).json();
    let reported = report["writtenError"].take();
    let file = read_glb(&folder.join("bar.glb"));
    let offs = offs_of_bar(folder, &file);
    let squares: f64 = offs.iter().map(|off| off * off).sum();
    let rms = (squares / offs.len() as f64).sqrt();
    let worst = farthest_of_bar(folder, &file);
    let percent = |off: f64| 100.0 * off / DVec3::new(6.0, 1.0, 1.0).length();
    assert!(said.contains(words), "{options}: {said}");
    let (before, slack) = match options.contains("skin") {
        true => ("(root mean square), ", 5e-3),
        false => ("at worst a vertex is off by ", 2e-3),
    };
    let said = percent_after(&said, before);
    assert!(
        (percent(worst) - said).abs() < slack,
        "{options}: {} is reported as {said}",
        percent(worst)
    );
    for (seen, key, slack) in [(rms, "rmsPercent", 0.02), (worst, "maxPercent", 0.0)] {
        let said = reported[key].as_f64().unwrap_or_default();
        let apart = (percent(seen) - said).abs();
        assert!(
            apart < 2e-3 + slack * said,
            "{options}: {key} {} is reported as {said}",
            percent(seen)
        );
    }
    (reported, file)
}

#[test]
fn every_output_holds_the_same_positions() {
    let folder = &bar_folder();
    for output in [
        "-o objs/ --parents",
        "-o plys/ --parents --format ply",
        "-o bar.pc2",
        "-o bar.mdd --threads 2",
        "-o bar.glb",
        "-o baked.glb --root baked",
        "-o bare.pc2 --root none",
    ] {
        animate_bar(folder, output);
    }
    let objs = read_folder(&folder.join("objs"), "obj");
    let plys = read_folder(&folder.join("plys"), "ply");
    let (_, pc2) = read_cache(&folder.join("bar.pc2"));
    let (times, mdd) = read_cache(&folder.join("bar.mdd"));
    let as_floats = |frames: &[Vec<DVec3>]| -> Vec<Vec<Vec3>> {
        frames.iter().map(|f| f.iter().map(|p| p.as_vec3()).collect()).collect()
    };
    assert_eq!(pc2, as_floats(&objs), "to the bit, in the order of the file's v lines");
    assert_eq!(pc2, as_floats(&plys));
    assert_eq!(pc2, mdd);
    let seconds: Vec<f32> = (0..FRAMES).map(|k| (k as f64 * STEP) as f32).collect();
    assert_eq!(times, seconds);

    let rest = rest_of_bar(folder);
    for name in ["bar.glb", "baked.glb"] {
        let file = read_glb(&folder.join(name));
        assert_eq!(file.json["animations"][0]["name"], "bar");
        assert!((clip_length(&file, 0) - STEP * (FRAMES - 1) as f64).abs() < 1e-6);
        let still = draw(&file, None, &[]).expect("it is drawn").swap_remove(0);
        assert!(still.positions.len() > rest.len(), "texture seams divide vertices");
        let same = bar_vertices(&still.positions, &rest);
        for (k, frame) in pc2.iter().enumerate() {
            let at = ClipTime {
                clip: 0,
                seconds: STEP * k as f64,
            };
            let drawn = draw(&file, Some(at), &[]).expect("it is drawn").swap_remove(0);
            let wanted: Vec<Vec3> = same.iter().map(|v| frame[*v]).collect();
            let off = farthest(&drawn.positions, &wanted);
            assert!(off < 1e-5, "{name}, frame {k}: {off}");
        }
    }
    let (_, bare) = read_cache(&folder.join("bare.pc2"));
    let far = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f32::max);
    assert!(
        far(&bare[FRAMES - 1], &pc2[FRAMES - 1]) > 2.0,
        "the whole is turned by 99 degrees"
    );
    assert!(far(&bare[0], &pc2[0]) < 1e-5, "and begins as it is");
}

#[test]
fn shapes_and_bones_play_the_frames_as_nearly_as_is_reported() {
    let folder = &bar_folder();
    animate_bar(folder, "-o bar.pc2");
    for (options, parts, most, words) in [
        ("--max-targets 6", 6, 100.0, "blended from 6 shapes"),
        ("--max-targets 8", 8, 10.0, "blended from 8 shapes"),
        ("--as skin", 40, 100.0, "40 bones play the frames"),
        ("--as skin --bones 12", 12, 1.0, "12 bones play the frames"),
    ] {
        let (reported, file) = written_error(folder, options, words);
        assert_eq!(reported["parts"], parts, "{options}: {reported}");
        let worst = reported["maxPercent"].as_f64().expect("a number");
        assert!(worst < most && (parts != 8 || worst > 0.01), "{options}: {reported}");
        let targets = list(&file.json["meshes"][0]["primitives"][0]["targets"]).len();
        let joints = list(&file.json["skins"][0]["joints"]).len();
        let is_skin = options.contains("skin");
        assert_eq!([targets, joints][usize::from(is_skin)], parts, "{options}");
        assert_eq!([targets, joints][usize::from(!is_skin)], 0, "{options}");
        khronos::assert_valid("skins and morphs", &[folder.join("bar.glb")]);
    }
    let exact = run_bar(folder, "-o bar.glb --json --force").json();
    assert!(exact["writtenError"].is_null(), "nothing is off");
}

#[test]
fn pictures_show_the_frames_that_are_asked_for() {
    let folder = &bar_folder();
    let read = |name: &str| {
        let file = std::io::BufReader::new(fs::File::open(folder.join(name)).expect(name));
        let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
        let frames = reader.info().animation_control().map(|a| a.num_frames);
        let mut pixels = vec![0; reader.output_buffer_size().expect("small")];
        let facts = reader.next_frame(&mut pixels).expect("an image");
        (facts.width, facts.height, frames, pixels)
    };
    animate_bar(folder, "-o sheet.png --tiles 4 --tile 64x48");
    let (width, height, frames, pixels) = read("sheet.png");
    assert_eq!((width, height, frames), (128, 96, None));
    let tile = |column: usize, row: usize| -> Vec<u8> {
        let rows = (0..48).map(|y| ((row * 48 + y) * 128 + column * 64) * 3);
        rows.flat_map(|start| pixels[start..start + 64 * 3].to_vec()).collect()
    };
    assert_ne!(tile(0, 0), tile(1, 1), "the last frame is not the first");
    animate_bar(folder, "-o bar.apng --tile 64x48 --frames 0:5");
    let (width, height, frames, _) = read("bar.apng");
    assert_eq!((width, height, frames), (64, 48, Some(5)));
}

#[test]
fn the_validator_finds_nothing_wrong_with_morphs() {
    let folder = &bar_folder();
    animate_bar(folder, "-o node.glb");
    animate_bar(folder, "-o few.glb --max-targets 3 --root none");
    let files = ["node.glb", "few.glb"].map(|name| folder.join(name));
    khronos::assert_valid("morphs", &files);
}

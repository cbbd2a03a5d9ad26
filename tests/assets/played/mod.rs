//! `pliant animate` as a script sees it: what it writes plays what it solved, in every format.

mod bad_input;
mod beside;
mod extremes;
mod models;
mod outputs;
mod pictures;
mod refusals;
mod resume;
mod rig_bones;
mod skinned;
mod usd;

use crate::support::commands::{Arguments, Ran, Workplace};
use crate::support::gltf_parsed::{Parsed, parse};
use glam::{DVec3, Vec3};
use pliant::asset::shapes;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Frames of [`make_bar`]'s clip, and seconds between them.
const FRAMES: usize = 12;
const STEP: f64 = 0.25;

/// A bar along x, its texture coordinates cut along a seam, as an OBJ; a clip that turns and lifts the whole and bends its
/// upper half; and a rig that goes with them.
fn make_bar(folder: &Workplace) {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [24, 4, 4]);
    let mut text = String::from("vt 0 0\nvt 1 0\nvt 0 1\nvt 0.5 0.5\n");
    for p in &positions {
        writeln!(text, "v {} {} {}", p.x - 3.0, p.y - 0.5, p.z - 0.5).expect("text");
    }
    for (i, t) in triangles.iter().enumerate() {
        let shift = i % 2;
        let corner = |k: usize| format!("{}/{}", t[k] + 1, k + 1 + shift);
        writeln!(text, "f {} {} {}", corner(0), corner(1), corner(2)).expect("text");
    }
    folder.put("bar.obj", text);
    let mut clip = String::from(
        "HIERARCHY\nROOT low\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
         JOINT high\n{\nOFFSET 3 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 3 0 0\n}\n}\n}\nMOTION\n",
    );
    writeln!(clip, "Frames: {FRAMES}\nFrame Time: {STEP}").expect("text");
    for k in 0..FRAMES {
        let (k, wave) = (k as f64, (k as f64 * 0.7).sin());
        writeln!(clip, "{} {} 0 0 0 {} {} 0 0", 0.1 * k, 0.05 * k, 9.0 * k, 50.0 * wave).expect("text");
    }
    folder.put("bar.bvh", clip);
    let rig = r#"{"version": 1, "joints": {"a": [-2.7, 0, 0], "b": [0, 0, 0], "c": [2.7, 0, 0]}, "bones": [
        {"id": "low", "from": "a", "to": "b", "joint": "low", "rest": "ORIENTATION", "radius": 0.5},
        {"id": "high", "from": "b", "to": "c", "parent": "low", "joint": "high", "rest": "ORIENTATION", "radius": 0.5}]}"#;
    folder.put("rig.json", rig);
}

fn bar_folder() -> Workplace {
    let folder = Workplace::empty();
    make_bar(&folder);
    folder
}

/// Runs `pliant animate` in a folder.
fn animate(folder: &Workplace, arguments: &(impl Arguments + ?Sized)) -> Ran {
    folder.run(&[&["animate"], &arguments.list()[..]].concat())
}

/// What a run of [`make_bar`]'s clip is asked for before its output.
const BAR: [&str; 7] = ["bar.obj", "--bvh", "bar.bvh", "--rig", "rig.json", "--skip-first", "no"];

/// Runs that clip.
fn run_bar(folder: &Workplace, arguments: &(impl Arguments + ?Sized)) -> Ran {
    animate(folder, &[&BAR[..], &arguments.list()].concat())
}

/// Runs that clip into an output; the lines of stderr.
fn animate_bar(folder: &Workplace, arguments: &(impl Arguments + ?Sized)) -> String {
    run_bar(folder, arguments).well().err
}

/// A point cache read back: times where it has them, and positions by frame.
fn read_cache(path: &Path) -> (Vec<f32>, Vec<Vec<Vec3>>) {
    let bytes = fs::read(path).expect("a cache");
    let is_mdd = path.extension().is_some_and(|e| e == "mdd");
    let word = |at: usize| -> [u8; 4] { bytes[at..at + 4].try_into().expect("four bytes") };
    let whole = |at: usize| match is_mdd {
        true => u32::from_be_bytes(word(at)) as usize,
        false => u32::from_le_bytes(word(at)) as usize,
    };
    let float = |at: usize| match is_mdd {
        true => f32::from_be_bytes(word(at)),
        false => f32::from_le_bytes(word(at)),
    };
    let (frames, points, start) = if is_mdd {
        (whole(0), whole(4), 8 + 4 * whole(0))
    } else {
        assert_eq!(&bytes[..12], b"POINTCACHE2\0");
        assert_eq!((whole(12), float(20), float(24)), (1, 0.0, 1.0));
        (whole(28), whole(16), 32)
    };
    assert_eq!(bytes.len(), start + 12 * points * frames, "{}", path.display());
    let times = (8..start).step_by(4).map(float).filter(|_| is_mdd).collect();
    let point = |at: usize| Vec3::new(float(at), float(at + 4), float(at + 8));
    let frame = |k: usize| (0..points).map(|i| point(start + 12 * (k * points + i))).collect();
    (times, (0..frames).map(frame).collect())
}

/// A GLB read back.
fn read_glb(path: &Path) -> Parsed {
    parse(&fs::read(path).expect("a file"), &BTreeMap::new())
}

/// The farthest that a place of one list is from that of another.
fn farthest(a: &[DVec3], b: &[Vec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().zip(b);
    pairs.map(|(a, b)| a.distance(b.as_dvec3())).fold(0.0, f64::max)
}

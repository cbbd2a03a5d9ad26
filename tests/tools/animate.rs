//! `pliant animate` at a terminal, and of a model that brings more than its body.

use crate::support::commands::{Workplace, on_a_terminal};
use crate::support::shapes::{moved, obj_text};
use glam::DVec3;
use pliant::asset::sample::{BuiltInModel, BuiltInRecording, body_glb};
use pliant::asset::shapes;
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Frames of [`write_bar`]'s clip.
const FRAMES: usize = 1000;

/// A bar along x, a clip that bends its upper half, and a rig that goes with them.
fn write_bar(folder: &Path) {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [12, 2, 2]);
    let bar = moved((positions, triangles), |p| p - DVec3::new(3.0, 0.5, 0.5));
    fs::write(folder.join("bar.obj"), obj_text(&bar)).expect("written");
    let mut clip = String::from(
        "HIERARCHY\nROOT low\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nJOINT high\n{\nOFFSET 3 0 0\n\
         CHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 3 0 0\n}\n}\n}\nMOTION\n",
    );
    writeln!(clip, "Frames: {FRAMES}\nFrame Time: 0.02").expect("text");
    for k in 0..FRAMES {
        writeln!(clip, "0 0 0 {} 0 0", 50.0 * (0.05 * k as f64).sin()).expect("text");
    }
    fs::write(folder.join("bar.bvh"), clip).expect("written");
    let rig = r#"{"version": 1, "joints": {"a": [-2.7, 0, 0], "b": [0, 0, 0], "c": [2.7, 0, 0]}, "bones": [
        {"id": "low", "from": "a", "to": "b", "joint": "low", "rest": "ORIENTATION", "radius": 0.5},
        {"id": "high", "from": "b", "to": "c", "parent": "low", "joint": "high", "rest": "ORIENTATION", "radius": 0.5}]}"#;
    fs::write(folder.join("rig.json"), rig).expect("written");
}

const BAR: [&str; 10] = [
    "animate",
    "bar.obj",
    "--bvh",
    "bar.bvh",
    "--rig",
    "rig.json",
    "--skip-first",
    "no",
    "--threads",
    "2",
];

/// Runs the program on a terminal, and sends it the signal of Ctrl-C once a frame is shown as solved; its exit code and what it drew.
fn stopped_at_a_terminal(folder: &Path, arguments: &[&str]) -> Option<(Option<i32>, String)> {
    let script = r#"
import fcntl, os, pty, re, signal, struct, sys, termios
child, terminal = pty.fork()
if child == 0:
    os.execv(sys.argv[1], sys.argv[1:])
fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 120, 0, 0))
drawn, asked = b"", False
while True:
    try:
        more = os.read(terminal, 65536)
    except OSError:
        break
    if not more:
        break
    drawn += more
    if not asked and re.search(rb"[1-9][0-9]* of [0-9]+ frames", drawn):
        os.kill(child, signal.SIGINT)
        asked = True
sys.stdout.buffer.write(drawn)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) % 256)
"#;
    on_a_terminal(folder, script, arguments)
}

/// The numbers in front of a text, wherever it stands.
fn counts_before(drawn: &str, text: &str) -> Vec<usize> {
    let places = drawn.match_indices(text).map(|(at, _)| &drawn[..at]);
    let digits = places.map(|before| before.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap_or_default());
    digits.filter_map(|digits| digits.parse().ok()).collect()
}

#[test]
fn a_stopped_animation_says_what_it_kept_and_continues_from_there() {
    let place = Workplace::empty();
    let folder = place.path();
    write_bar(folder);
    let of = |output: &[&'static str]| [&BAR[..], output].concat();
    let whole = place.done(&of(&["-o", "whole.pc2"]));
    assert_eq!(whole.last(), "bar.obj -> whole.pc2");
    let Some((code, drawn)) = stopped_at_a_terminal(folder, &of(&["-o", "bar.pc2"])) else {
        return;
    };
    let last = drawn.trim_end().lines().last().unwrap_or_default();
    assert_eq!(code, Some(130), "{last}");
    let kept = counts_before(
        last,
        " of 1000 frames are kept in bar.pc2.part; the same command with --resume continues",
    );
    let [kept] = kept[..] else { panic!("{last}") };
    let shown = counts_before(&drawn, " of 1000 frames");
    assert!(shown.is_sorted() && 0 < kept && kept < FRAMES, "{kept} of {shown:?}");
    assert!(drawn.contains("/s, ") && drawn.contains("s left"), "{drawn}");
    place.refused(&of(&["-o", "bar.pc2"]), &["--resume continues with them"]);
    let report = place.done(&of(&["-o", "bar.pc2", "--resume", "--json"])).json();
    let frames = report["frames"].as_array().expect("frames");
    assert_eq!(frames.len(), FRAMES);
    assert!(frames.iter().all(|frame| frame["ms"].as_f64() > Some(0.0)));
    let read = |name: &str| place.bytes(name);
    assert!(read("bar.pc2") == read("whole.pc2") && !folder.join("bar.pc2.part").exists());

    // Numbered models are kept as they are.
    let numbered = stopped_at_a_terminal(folder, &of(&["-o", "frames/", "--parents"]));
    let (code, drawn) = numbered.expect("python3 was here");
    let last = drawn.trim_end().lines().last().unwrap_or_default();
    assert_eq!(code, Some(130), "{last}");
    let there = fs::read_dir(folder.join("frames")).expect("a folder").flatten();
    let models = there
        .filter(|entry| entry.file_name().to_string_lossy().ends_with(".obj"))
        .count();
    assert_eq!(
        counts_before(last, " of 1000 frames are kept in frames"),
        [models],
        "{last}"
    );

    // A picture is not begun before its frames are there.
    let pictured = stopped_at_a_terminal(folder, &of(&["-o", "bar.png", "--tile", "64x64"]));
    let (code, drawn) = pictured.expect("python3 was here");
    assert!(
        code == Some(130) && drawn.contains("nothing is kept") && !folder.join("bar.png").exists(),
        "{drawn}"
    );
}

/// A GLB without one of its nodes.
fn without_node(glb: &[u8], name: &str) -> Vec<u8> {
    let length = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().expect("four bytes")) as usize;
    let (text, rest) = glb[20..].split_at(length(12));
    let mut document: Value = serde_json::from_slice(text).expect("JSON");
    let nodes = document["nodes"].as_array().expect("nodes");
    let gone = nodes.iter().position(|node| node["name"] == name).expect("the node");
    document["scenes"][0]["nodes"]
        .as_array_mut()
        .expect("roots")
        .retain(|root| *root != gone);
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut file = glb[..8].to_vec();
    file.extend((20 + text.len() as u32 + rest.len() as u32).to_le_bytes());
    file.extend((text.len() as u32).to_le_bytes());
    file.extend(&glb[16..20]);
    [&file[..], &text, rest].concat()
}

#[test]
fn a_recording_moves_what_a_skin_places_and_leaves_out_the_rest() {
    let folder = Workplace::empty();
    let figure = BuiltInModel::Figure.glb().to_vec();
    folder.put("figure.glb", &figure);
    let bare = ["hull", "lod1", "lod2"]
        .iter()
        .fold(figure, |glb, node| without_node(&glb, node));
    folder.put("bare.glb", bare);
    folder.put("clip.bvh", BuiltInRecording::ALL[0].bvh_text());
    let reply = |arguments: &str| -> Value { folder.done(&format!("{arguments} --bvh clip.bvh --json")).json() };
    let says = |report: &Value, words: &str| {
        report["warnings"]
            .as_array()
            .is_some_and(|all| all.iter().any(|w| *w == words))
    };
    let rig = reply("rig figure.glb -o figure.json --no-picture");
    let bare_rig = reply("rig bare.glb -o bare.json --no-picture");
    let without = |report: &Value, consequence: &str| {
        let reasons = [
            format!("\"hull\" has no skin, and is {consequence}"),
            format!("\"lod1\", \"lod2\" are coarser levels of detail, and are {consequence}"),
        ];
        reasons.iter().map(|words| says(report, words)).collect::<Vec<bool>>()
    };
    assert_eq!(without(&rig, "left out"), [true, true], "{}", rig["warnings"]);
    assert_eq!(
        (&rig["joints"], &rig["bones"]),
        (&bare_rig["joints"], &bare_rig["bones"])
    );

    // Without a rig, that rig is made; what is measured is the body alone.
    let played = reply("animate figure.glb --frames 5:1");
    let given = reply("animate figure.glb --rig figure.json --frames 5:1");
    let bare = reply("animate bare.glb --frames 5:1");
    assert_eq!(without(&played, "not solved"), [true, true], "{}", played["warnings"]);
    assert_eq!(without(&bare, "not solved"), [false, false]);
    let measured = |report: &Value, names: &[&str]| -> Vec<Value> {
        names.iter().map(|name| report["frames"][0][name].clone()).collect()
    };
    assert_eq!(measured(&played, &["digest"]), measured(&given, &["digest"]));
    let names = ["volumeChange", "flippedTriangles", "maxStretch", "edgeRms", "cycles"];
    assert_eq!(measured(&played, &names), measured(&bare, &names));
    assert_eq!(played["handles"], bare["handles"]);
}

/// An elbow of the built-in body that bends by 160 degrees in so many frames.
fn write_elbow(folder: &Path, frames: usize) {
    fs::write(folder.join("body.glb"), body_glb()).expect("written");
    let mut clip = String::from("HIERARCHY\nROOT chest\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n");
    for (joint, offset) in [("upper", 0.2), ("fore", 0.25), ("hand", 0.25)] {
        let channels = "CHANNELS 3 Zrotation Xrotation Yrotation";
        write!(clip, "JOINT {joint}\n{{\nOFFSET {offset} 0 0\n{channels}\n").expect("text");
    }
    clip += "End Site\n{\nOFFSET 0.16 0 0\n}\n}\n}\n}\n}\nMOTION\n";
    write!(clip, "Frames: {}\nFrame Time: 0.0333333\n", frames + 1).expect("text");
    for k in 0..=frames {
        let bend = 160.0 * k as f64 / frames as f64;
        writeln!(clip, "0 0 0 0 0 0 0 0 {} 0 0 0", -bend).expect("text");
    }
    fs::write(folder.join("elbow.bvh"), clip).expect("written");
    let rig = r#"{"version": 1, "reference": {"frame": 0}, "joints": {"trunk": [0, 1.41, 0], "shoulder": [0.2, 1.41, 0],
        "elbow": [0.45, 1.41, 0], "wrist": [0.7, 1.41, 0], "tip": [0.86, 1.41, 0]}, "bones": [
        {"id": "chest", "from": "trunk", "to": "shoulder", "joint": "chest", "rest": "ORIENTATION", "radius": 0.12},
        {"id": "upper", "from": "shoulder", "to": "elbow", "parent": "chest", "joint": "upper", "rest": "ORIENTATION", "radius": 0.06, "slices": 3},
        {"id": "fore", "from": "elbow", "to": "wrist", "parent": "upper", "joint": "fore", "rest": "ORIENTATION", "radius": 0.05, "slices": 3},
        {"id": "hand", "from": "wrist", "to": "tip", "parent": "fore", "joint": "hand", "rest": "ORIENTATION", "radius": 0.04}]}"#;
    fs::write(folder.join("rig.json"), rig).expect("written");
}

#[test]
fn with_contact_avoid_a_recorded_forearm_stays_outside_of_the_body() {
    let place = Workplace::empty();
    write_elbow(place.path(), 12);
    let report = |more: &[&str]| -> Value {
        let arguments = [
            "animate",
            "body.glb",
            "--bvh",
            "elbow.bvh",
            "--rig",
            "rig.json",
            "--json",
        ];
        place.done(&[&arguments[..], more].concat()).json()
    };
    let [without, with] = [&["--self-intersections"][..], &["--contact", "avoid"]].map(report);
    let totals = |report: &Value, field: &str| report["totals"][field].as_f64().unwrap_or_default();
    let [crossing, left] = [&without, &with].map(|report| totals(report, "newSelfIntersectionsMean"));
    assert!(
        crossing > 30.0,
        "the forearm passes through the arm, {crossing} pairs a frame"
    );
    assert!(left <= 0.05 * crossing, "{left} of {crossing} pairs a frame");
    // The worst frame is named.
    let worst = totals(&without, "worstCrossingFrame") as usize;
    let pairs = |report: &Value, frame: usize| report["frames"][frame]["newSelfIntersections"].as_f64();
    assert_eq!(
        pairs(&without, worst),
        Some(totals(&without, "newSelfIntersectionsWorst"))
    );
    let frames = without["frames"].as_array().expect("frames");
    let crossing = (0..frames.len()).filter(|k| pairs(&without, *k) > Some(0.0)).count();
    assert_eq!(totals(&without, "crossingFrames") as usize, crossing);
    for k in 0..frames.len() {
        let crosses = pairs(&without, k) > Some(0.0);
        let same = without["frames"][k]["digest"] == with["frames"][k]["digest"];
        assert!(crosses || same, "frame {k} does not cross and has other bits");
    }
}

//! An animation that was stopped goes on, and comes to the same bytes.

use super::{BAR, FRAMES, animate, animate_bar, make_bar};
use serde_json::Value;
use std::fs;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::Command;

/// Runs the bar's clip until a file of it has so many blocks of 512 bytes, which kills it.
fn animate_until_killed(folder: &Path, blocks: usize, arguments: &[&str]) {
    let done = Command::new("sh")
        .args(["-c", &format!("ulimit -c 0; ulimit -f {blocks}; exec \"$0\" \"$@\"")])
        .arg(env!("CARGO_BIN_EXE_pliant"))
        .arg("animate")
        .args(BAR)
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.signal().is_some(), "it is killed: {:?} {said}", done.status);
}

fn digests(report: &[u8]) -> Vec<String> {
    let report: Value = serde_json::from_slice(report).expect("a report");
    let frames = report["frames"].as_array().expect("frames");
    frames
        .iter()
        .map(|f| f["digest"].as_str().expect("a digest").to_owned())
        .collect()
}

#[test]
fn a_killed_animation_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    // About four and a half of its twelve frames fit.
    let frame = 12
        * fs::read_to_string(folder.join("bar.obj"))
            .expect("the bar")
            .matches("\nv ")
            .count()
        + 300;
    let blocks = 9 * frame / 1024;
    for name in ["bar.pc2", "bar.mdd", "bar.glb", "bar.usda"] {
        let whole = format!("whole_{name}");
        let all: Vec<&str> = BAR.iter().copied().chain(["-o", &whole, "--json"]).collect();
        let wanted = digests(&animate(folder, &all).stdout);
        assert_eq!(wanted.len(), FRAMES);
        animate_until_killed(folder, blocks, &["-o", name]);
        let part = folder.join(format!("{name}.part"));
        let kept = fs::metadata(&part).expect("a partial file").len();
        assert!(kept > 3 * frame as u64 && kept < 6 * frame as u64, "{kept}");
        assert!(!folder.join(name).exists());

        let again = BAR.iter().copied().chain(["-o", name]);
        let plain = animate(folder, &again.clone().collect::<Vec<&str>>());
        assert!(String::from_utf8_lossy(&plain.stderr).contains("--resume continues with them"));
        let other: Vec<&str> = again.clone().chain(["--resume", "--refine", "0"]).collect();
        let refused = animate(folder, &other);
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            said.contains("of another animation (refine carried, not refine 0)"),
            "{said}"
        );
        assert_eq!(fs::metadata(&part).expect("still there").len(), kept);

        let resumed: Vec<&str> = again.chain(["--resume", "--json"]).collect();
        assert_eq!(digests(&animate(folder, &resumed).stdout), wanted);
        let read = |name: &str| fs::read(folder.join(name)).expect("written");
        assert!(read(name) == read(&whole), "{name} differs");
        assert!(!part.exists());
    }
}

#[test]
fn a_folder_is_filled_up_where_it_was_left() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    animate_bar(folder, &["-o", "whole/", "--parents"]);
    fs::create_dir(folder.join("left")).expect("a folder");
    // The last frame is larger than any other file of the run, so it kills: the rest and the mark are there.
    let sizes = (0..FRAMES).map(|k| {
        fs::metadata(folder.join(format!("whole/frame_{k:05}.obj")))
            .expect("a frame")
            .len()
    });
    let sizes: Vec<u64> = sizes.collect();
    let first = sizes[0].div_ceil(512) as usize;
    let killing = sizes
        .iter()
        .position(|s| s.div_ceil(512) as usize > first)
        .expect("a larger frame");
    animate_until_killed(folder, first, &["-o", "left/"]);
    for k in 0..killing {
        assert!(folder.join(format!("left/frame_{k:05}.obj")).is_file(), "frame {k}");
    }
    let mark = fs::read_to_string(folder.join("left/frames.part")).expect("it says what its frames are of");
    assert!(mark.contains("refine carried"));
    fs::write(folder.join("left/frame_00000.obj"), "# seen\n").expect("written");
    let said = animate_bar(folder, &["-o", "left/", "--resume"]);
    assert!(said.contains("frames were there already"), "{said}");
    let read = |place: &str, k: usize| fs::read(folder.join(format!("{place}/frame_{k:05}.obj"))).expect("a frame");
    assert_eq!(read("left", 0), b"# seen\n", "what was there is not solved again");
    for k in 1..FRAMES {
        assert!(read("left", k) == read("whole", k), "frame {k} differs");
    }
    assert!(!folder.join("left/frames.part").exists());
    let all: Vec<&str> = BAR.iter().copied().chain(["-o", "left/", "--resume"]).collect();
    let refused = animate(folder, &all);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(said.contains("there is no frames.part"), "{said}");
}

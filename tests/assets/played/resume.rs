//! An animation that was stopped goes on, and comes to the same bytes.

use super::{BAR, FRAMES, animate_bar, bar_folder, run_bar};
use crate::support::commands::Workplace;
use crate::support::skinning::list;
use serde_json::Value;
use std::fs;
use std::os::unix::process::ExitStatusExt as _;
use std::process::Command;

/// Runs the bar's clip until a file of it has so many blocks of 512 bytes, which kills it.
fn animate_until_killed(folder: &Workplace, blocks: usize, arguments: &[&str]) {
    let done = Command::new("sh")
        .args(["-c", &format!("ulimit -c 0; ulimit -f {blocks}; exec \"$0\" \"$@\"")])
        .arg(env!("CARGO_BIN_EXE_pliant"))
        .arg("animate")
        .args(BAR)
        .args(arguments)
        .current_dir(folder.path())
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.signal().is_some(), "it is killed: {:?} {said}", done.status);
}

fn digests(report: &Value) -> Vec<String> {
    list(&report["frames"])
        .iter()
        .map(|f| f["digest"].as_str().expect("a digest").to_owned())
        .collect()
}

#[test]
fn a_killed_animation_goes_on_to_the_same_bytes() {
    let folder = &bar_folder();
    // About four and a half of its twelve frames fit.
    let bar = folder.text("bar.obj");
    let frame = 12 * bar.matches("\nv ").count() + 300;
    let blocks = 9 * frame / 1024;
    for name in ["bar.pc2", "bar.mdd", "bar.glb", "bar.usda"] {
        let whole = format!("whole_{name}");
        let wanted = digests(&run_bar(folder, &["-o", &whole, "--json"]).json());
        assert_eq!(wanted.len(), FRAMES);
        animate_until_killed(folder, blocks, &["-o", name]);
        let part = folder.join(format!("{name}.part"));
        let kept = fs::metadata(&part).expect("a partial file").len();
        assert!(kept > 3 * frame as u64 && kept < 6 * frame as u64, "{kept}");
        assert!(!folder.join(name).exists());

        let plain = run_bar(folder, &["-o", name]);
        assert!(plain.err.contains("--resume continues with them"));
        let other = run_bar(folder, &["-o", name, "--resume", "--refine", "0"]).err;
        assert!(
            other.contains("of another animation (refine carried, not refine 0)"),
            "{other}"
        );
        assert_eq!(fs::metadata(&part).expect("still there").len(), kept);

        assert_eq!(
            digests(&run_bar(folder, &["-o", name, "--resume", "--json"]).json()),
            wanted
        );
        let read = |name: &str| folder.bytes(name);
        assert!(read(name) == read(&whole), "{name} differs");
        assert!(!part.exists());
    }
}

#[test]
fn a_folder_is_filled_up_where_it_was_left() {
    let folder = &bar_folder();
    animate_bar(folder, "-o whole/ --parents");
    fs::create_dir(folder.join("left")).expect("a folder");
    // The last frame is larger than any other file of the run, so it kills: the rest and the mark are there.
    let size = |k| {
        fs::metadata(folder.join(format!("whole/frame_{k:05}.obj")))
            .expect("a frame")
            .len()
    };
    let sizes: Vec<u64> = (0..FRAMES).map(size).collect();
    let first = sizes[0].div_ceil(512) as usize;
    let killing = sizes
        .iter()
        .position(|s| s.div_ceil(512) as usize > first)
        .expect("a larger frame");
    animate_until_killed(folder, first, &["-o", "left/"]);
    for k in 0..killing {
        assert!(folder.join(format!("left/frame_{k:05}.obj")).is_file(), "frame {k}");
    }
    let mark = folder.text("left/frames.part");
    assert!(mark.contains("refine carried"));
    folder.put("left/frame_00000.obj", "# seen\n");
    let said = animate_bar(folder, "-o left/ --resume");
    assert!(said.contains("frames were there already"), "{said}");
    let read = |place: &str, k: usize| fs::read(folder.join(format!("{place}/frame_{k:05}.obj"))).expect("a frame");
    assert_eq!(read("left", 0), b"# seen\n", "what was there is not solved again");
    for k in 1..FRAMES {
        assert!(read("left", k) == read("whole", k), "frame {k} differs");
    }
    assert!(!folder.join("left/frames.part").exists());
    let said = run_bar(folder, "-o left/ --resume").err;
    assert!(said.contains("there is no frames.part"), "{said}");
}

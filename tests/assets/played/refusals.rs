//! What `pliant animate` does not write, and what it says then.

use super::{BAR, animate, animate_bar, make_bar};
use std::fs;
use std::path::Path;

/// Runs the bar's clip; the exit code and the last line of stderr.
pub(super) fn refuse(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let all: Vec<&str> = BAR.iter().chain(arguments).copied().collect();
    let done = animate(folder, &all);
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    let last = said.trim_end().lines().last().unwrap_or_default();
    (done.status.code(), last.to_owned())
}

/// Everything in a folder with its bytes.
pub(super) fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.display().to_string();
        all.push((name, fs::read(&path).unwrap_or_default()));
    }
    all.sort();
    all
}

#[test]
fn bad_arguments_say_what_is_allowed_and_write_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    fs::create_dir(folder.join("there")).expect("a folder");
    let before = contents(folder);
    let cases: [(&[&str], &str); 18] = [
        (
            &["-o", "walk"],
            "allowed are .glb, .usda, .pc2, .mdd, .png, .apng and a folder",
        ),
        (
            &["-o", "walk.abc"],
            "allowed are .glb, .usda, .pc2, .mdd, .png, .apng and a folder",
        ),
        (
            &["-o", "walk.usdc"],
            "USD is written as text, and .usdc is not; write a .usda",
        ),
        (
            &["-o", "walk.ply"],
            "a folder of them ends in a slash, with --format ply",
        ),
        (
            &["-o", "there/", "--format", "docx"],
            "--format is \"docx\", allowed are glb,",
        ),
        (
            &["-o", "there/", "--format", "fbx"],
            "--format is \"fbx\", allowed are glb,",
        ),
        (&["-o", "walk.glb", "--format", "obj"], "--format is for folders"),
        (&["-o", "there/", "--as", "morph"], "--as is for .glb"),
        (&["-o", "walk.pc2", "--max-targets", "9"], "--max-targets is for .glb"),
        (
            &["-o", "walk.glb", "--max-targets", "1"],
            "--max-targets is 1, allowed are 2 to 4096",
        ),
        (&["-o", "walk.glb", "--bones", "9"], "--bones is for --as skin"),
        (
            &["-o", "walk.glb", "--as", "skin", "--bones", "0"],
            "--bones is 0, allowed are 1 to 256",
        ),
        (
            &["-o", "walk.glb", "--as", "skin", "--max-targets", "9"],
            "--max-targets is for .glb files with morph targets",
        ),
        (&["-o", "walk.pc2", "--root", "node"], "allowed here are baked and none"),
        (
            &["-o", "walk.glb", "--root", "sideways"],
            "possible values: node, baked, none",
        ),
        (&["--resume"], "--resume needs an --output"),
        (&["-o", "new/walk.glb"], "--parents makes it"),
        (&["-o", "new/"], "--parents makes it"),
    ];
    for (arguments, wanted) in cases {
        let (code, said) = refuse(folder, arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {said}");
        assert!(said.contains(wanted), "{arguments:?}: {said}");
        assert_eq!(contents(folder), before, "{arguments:?}");
    }
}

#[test]
fn nothing_is_replaced_unless_forced() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    fs::create_dir(folder.join("frames")).expect("a folder");
    let there = ["bar.glb", "bar.mdd", "frames/frame_00003.obj"];
    for name in there {
        fs::write(folder.join(name), "mine").expect("written");
    }
    for (output, name) in ["bar.glb", "bar.mdd", "frames/"].into_iter().zip(there) {
        let (code, said) = refuse(folder, &["-o", output, "--frames", "0:4"]);
        assert_eq!(code, Some(2));
        assert!(said.contains("it exists; --force replaces it"), "{said}");
        assert_eq!(fs::read(folder.join(name)).expect("still there"), b"mine");
        animate_bar(folder, &["-o", output, "--frames", "0:4", "--force"]);
        assert_ne!(fs::read(folder.join(name)).expect("a file"), b"mine");
    }
    let frames = fs::read_dir(folder.join("frames")).expect("a folder").count();
    assert_eq!(frames, 4, "and nothing else is left behind");
    let left = contents(folder).into_iter().filter(|(name, _)| name.ends_with(".part"));
    assert_eq!(left.count(), 0);
}

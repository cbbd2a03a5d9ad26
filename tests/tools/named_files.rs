//! What a job or a suite names is read from where it may lie alone, is a regular file, and is never waited for.

use crate::support::commands::{Ran, Workplace, pliant_in};
use crate::support::server::bar_obj;
use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::Path;
use std::process::Command;

const TRIANGLE: &str = "v 9 0 0\nv 9 1 0\nv 9 0 1\nf 1 2 3\n";

/// What a server takes as one upload, and one byte more.
const TOO_LONG: u64 = (1 << 30) + 1;

/// A folder `job` with a bar and a triangle in it, and a triangle beside that folder.
fn workplace() -> Workplace {
    let folder = Workplace::empty();
    fs::create_dir_all(folder.at("job/inside")).expect("a folder");
    fs::create_dir(folder.at("elsewhere")).expect("a folder");
    folder.put("job/bar.obj", bar_obj(8));
    for name in ["job/near.obj", "job/inside/far.obj", "elsewhere/secret.obj"] {
        folder.put(name, TRIANGLE);
    }
    symlink("inside/far.obj", folder.at("job/link.obj")).expect("a link");
    symlink("../elsewhere/secret.obj", folder.at("job/way_out.obj")).expect("a link");
    symlink("../elsewhere", folder.at("job/other")).expect("a link");
    symlink("/dev/zero", folder.at("job/zero.obj")).expect("a link");
    pipe(&folder.at("job/pipe.obj"));
    let long = fs::File::create(folder.at("job/long.obj")).expect("a file");
    long.set_len(TOO_LONG).expect("a file without blocks");
    folder
}

fn pipe(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status().expect("mkfifo runs");
    assert!(made.success(), "{}", path.display());
}

/// Two jobs that name a file: one merges it, and along with the other it rides.
fn jobs(file: &str) -> [(&'static str, String); 2] {
    [
        (
            "steps[1].merge.file",
            format!(
                r#"{{"steps": [{{"edit": {{"merge": {{"file": "near.obj", "how": "LOOSE"}}}}}},
                    {{"edit": {{"merge": {{"file": "{file}", "how": "LOOSE"}}}}}}]}}"#
            ),
        ),
        (
            "passengers[0].file.file",
            format!(r#"{{"create": {{"passengers": [{{"file": {{"file": "{file}", "output": "carried.obj"}}}}]}}}}"#),
        ),
    ]
}

/// Names that lead to no file that may be read, and what is said of them.
fn refused_names(folder: &Path) -> Vec<(String, &'static str)> {
    let absolute = folder.join("elsewhere/secret.obj").display().to_string();
    [
        (absolute.as_str(), "which does not lie in"),
        ("../elsewhere/secret.obj", "which does not lie in"),
        ("inside/../../elsewhere/secret.obj", "which does not lie in"),
        ("way_out.obj", "which does not lie in"),
        ("other/secret.obj", "which does not lie in"),
        ("/dev/zero", "which does not lie in"),
        ("zero.obj", "which does not lie in"),
        ("pipe.obj", "pipe.obj is not a regular file, a file is needed"),
        ("inside", "inside is a folder, a file is needed"),
        ("", "is a folder, a file is needed"),
        (
            "long.obj",
            "long.obj has 1073741825 bytes or more, at most 1073741824 are allowed",
        ),
        ("none.obj", "none.obj: No such file"),
    ]
    .map(|(name, reply)| (name.to_owned(), reply))
    .to_vec()
}

#[test]
fn a_job_reads_only_files_below_its_folder() {
    let folder = workplace();
    for (name, reply) in refused_names(folder.path()) {
        for (field, text) in jobs(&name) {
            folder.put("job/job.json", text);
            let arguments = "deform job/bar.obj --job job/job.json -o out/out.obj";
            let ran = folder.refused(&format!("{arguments} --parents"), &[reply]);
            let err = &ran.err;
            let start = format!("pliant: job/job.json: {field}: ");
            assert!(ran.last().starts_with(&start), "{name}: {start}: {err}");
            assert_eq!(reply.contains("does not lie"), err.contains("--allow"), "{err}");
            assert!(!folder.at("out").exists(), "{name} left something behind");
        }
    }
    for name in ["near.obj", "inside/far.obj", "link.obj", "inside/../near.obj"] {
        for (_, text) in jobs(name) {
            folder.put("job/job.json", text);
            // From the folder of the job too, where its path has no folder in it.
            for (from, model, job, out) in [
                (".", "job/bar.obj", "job/job.json", "out.obj"),
                ("job", "bar.obj", "job.json", "../out.obj"),
            ] {
                let arguments = ["deform", model, "--job", job, "-o", out, "--force"];
                Ran::of(&mut pliant_in(&folder.at(from), &arguments)).exits(0);
            }
        }
    }
}

#[test]
fn folders_can_be_allowed_and_what_is_no_file_in_them_is_refused_all_the_same() {
    let folder = workplace();
    pipe(&folder.at("elsewhere/pipe.obj"));
    fs::create_dir(folder.at("elsewhere_too")).expect("a folder");
    folder.put("elsewhere_too/more.obj", TRIANGLE);
    let deform = |name: &str, allowed: &str| {
        let (_, text) = jobs(name).into_iter().next().expect("one that merges");
        folder.put("job/job.json", text);
        folder.run(&format!(
            "deform job/bar.obj --job job/job.json -o out.obj --force {allowed}"
        ))
    };
    let absolute = folder.at("elsewhere/secret.obj").display().to_string();
    for name in [&absolute, "../elsewhere/secret.obj", "way_out.obj", "near.obj"] {
        deform(name, "--allow elsewhere").exits(0);
    }
    deform("../elsewhere_too/more.obj", "--allow elsewhere --allow elsewhere_too").exits(0);
    for (name, allowed, reply) in [
        // A folder whose name only begins alike is another one.
        ("../elsewhere_too/more.obj", "--allow elsewhere", "does not lie in"),
        ("../elsewhere/pipe.obj", "--allow elsewhere", "is not a regular file"),
        ("/dev/zero", "--allow /dev", "is not a regular file"),
        (
            "near.obj",
            "--allow nowhere",
            "--allow is nowhere, which is not a folder",
        ),
        (
            "near.obj",
            "--allow job/bar.obj",
            "--allow is job/bar.obj, which is not a folder",
        ),
    ] {
        deform(name, allowed).exits(2).gives(&[reply]);
    }
}

#[test]
fn a_suite_reads_only_files_below_its_folder() {
    let folder = workplace();
    let check = |text: &str, arguments: &str| {
        folder.put("job/one.case.json", text);
        folder.run(&format!("check job --bless {arguments}"))
    };
    for (name, reply) in refused_names(folder.path()) {
        for (field, job) in jobs(&name) {
            let text = format!(r#"{{"model": "bar.obj", "job": {job}}}"#);
            let ran = check(&text, "").exits(2);
            ran.gives(&[reply]);
            let err = &ran.err;
            let start = format!("pliant: job/one.case.json: job.{field}: ");
            assert!(ran.last().starts_with(&start), "{name}: {start}: {err}");
        }
    }
    let within = refused_names(folder.path());
    let within = within
        .iter()
        .filter(|(name, _)| !name.contains("..") && !name.starts_with('/'));
    for (name, reply) in within.filter(|(name, _)| !name.is_empty() && name != "none.obj") {
        for text in [
            format!(r#"{{"model": "{name}", "job": {{}}}}"#),
            format!(r#"{{"model": "bar.obj", "job": "{name}"}}"#),
            format!(r#"{{"model": "bar.obj", "animate": {{"bvh": "{name}"}}}}"#),
        ] {
            check(&text, "").exits(2).gives(&[reply]);
        }
    }
    assert!(!folder.at("job/one.golden.json").exists(), "something was stored");

    // A job in a folder below may name what lies elsewhere in the suite.
    let (_, job) = jobs("../near.obj").into_iter().next().expect("one that merges");
    folder.put("job/inside/job.json", job.replacen("near.obj", "../link.obj", 1));
    check(r#"{"model": "bar.obj", "job": "inside/job.json"}"#, "").exits(0);
    let (_, job) = jobs("way_out.obj").into_iter().next().expect("one that merges");
    let text = format!(r#"{{"model": "bar.obj", "job": {job}}}"#);
    check(&text, "--allow elsewhere").exits(0);

    // Goldens and cases are not read through links either, nor the data's models.
    folder.put("elsewhere/golden.json", "{}");
    fs::remove_file(folder.at("job/one.golden.json")).expect("it was stored");
    symlink("../elsewhere/golden.json", folder.at("job/one.golden.json")).expect("a link");
    check(r#"{"model": "bar.obj", "job": {}}"#, "")
        .exits(2)
        .gives(&["one.golden.json", "does not lie in"]);
    assert_eq!(folder.bytes("elsewhere/golden.json"), b"{}");
    fs::remove_file(folder.at("job/one.golden.json")).expect("a link");
    fs::create_dir(folder.at("data")).expect("a folder");
    symlink("../elsewhere/secret.obj", folder.at("data/model.obj")).expect("a link");
    let data = r#"{"model": "data:model.obj", "job": {}}"#;
    let ran = check(data, "--data data").exits(2);
    ran.gives(&["job/one.case.json: model: \"model.obj\" is ", "does not lie in"]);
}

#[test]
fn a_path_that_was_typed_leads_anywhere_and_to_regular_files_alone() {
    let folder = workplace();
    folder.put("job.json", "{}");
    folder.done("inspect job/way_out.obj");
    for (path, reply) in [
        ("job/pipe.obj", "is not a regular file, a file is needed"),
        ("/dev/zero", "is not a regular file, a file is needed"),
        ("job", "is a folder, a file is needed"),
    ] {
        for arguments in [
            &["inspect", path][..],
            &["deform", "job/bar.obj", "--job", path, "-o", "out.obj"],
            &["deform", path, "--job", "job.json", "-o", "out.obj"],
            &["rig", "job/bar.obj", "--bvh", path, "-o", "rig.json"],
            &["skin", "job/bar.obj", "--rig", path, "-o", "out.glb"],
            &["render", path, "-o", "out.png"],
            &["animate", path, "--bvh", path, "--rig", path, "-o", "out.glb"],
        ] {
            folder.refused(arguments, &[&format!("{path} {reply}")]);
        }
    }
}

#[test]
fn a_companion_that_is_a_pipe_is_refused_and_not_waited_for() {
    let folder = workplace();
    let model = r#"{"asset": {"version": "2.0"}, "buffers": [{"byteLength": 12, "uri": "model.bin"}]}"#;
    folder.put("job/model.gltf", model);
    pipe(&folder.at("job/model.bin"));
    folder.refused(
        "inspect job/model.gltf",
        &["job/model.gltf: job/model.bin is not a regular file, a file is needed"],
    );
}

#[test]
fn no_link_under_the_name_of_a_temporary_file_is_written_through() {
    let folder = workplace();
    folder.put("job.json", "{}");
    folder.put("victim", "mine");
    // The number of the process is known before the program runs.
    let script = r#"ln -s victim "out.obj.$$.part"; exec "$0" deform job/bar.obj --job job.json -o out.obj"#;
    let done = Command::new("sh")
        .args(["-c", script, env!("CARGO_BIN_EXE_pliant")])
        .current_dir(folder.path())
        .output()
        .expect("it runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert_eq!(folder.bytes("victim"), b"mine");
    let facts = fs::symlink_metadata(folder.at("out.obj")).expect("written");
    let usual = fs::metadata(folder.at("victim")).expect("there").permissions().mode();
    assert!(facts.is_file());
    assert_eq!(facts.permissions().mode(), usual, "as any file that is made here");
    let left = fs::read_dir(folder.path()).expect("a folder").flatten();
    let left = left.filter(|f| f.file_name().to_string_lossy().ends_with(".part"));
    assert_eq!(left.count(), 1, "only the link is left");

    // The partial file of an animation has a name that is known, and is made again.
    let animate = "animate creature.glb --clip walk -o walk.glb";
    folder.done("sample figure -o creature.glb");
    for target in ["victim", "nowhere"] {
        symlink(target, folder.at("walk.glb.part")).expect("a link");
        folder.refused(animate, &["walk.glb.part"]);
        folder.done(&format!("{animate} --frames 0:2 --force"));
        assert_eq!(folder.bytes("victim"), b"mine");
        assert!(!folder.at("nowhere").exists() && folder.at("walk.glb.part").symlink_metadata().is_err());
        fs::remove_file(folder.at("walk.glb")).expect("it was written");
    }
    pipe(&folder.at("walk.glb.part"));
    folder.refused(&format!("{animate} --resume"), &["walk.glb.part is not a regular file"]);
}

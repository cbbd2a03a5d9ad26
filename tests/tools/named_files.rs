//! What a job or a suite names is read from where it may lie alone, is a regular file, and is never waited for.

use crate::program::told as pliant;
use crate::support::server::bar_obj;
use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::Path;
use std::process::Command;

const TRIANGLE: &str = "v 9 0 0\nv 9 1 0\nv 9 0 1\nf 1 2 3\n";

/// What a server takes as one upload, and one byte more.
const TOO_LONG: u64 = (1 << 30) + 1;

/// A folder `job` with a bar and a triangle in it, and a triangle beside that folder.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("job/inside")).expect("a folder");
    fs::create_dir(at("elsewhere")).expect("a folder");
    fs::write(at("job/bar.obj"), bar_obj(8)).expect("written");
    for name in ["job/near.obj", "job/inside/far.obj", "elsewhere/secret.obj"] {
        fs::write(at(name), TRIANGLE).expect("written");
    }
    symlink("inside/far.obj", at("job/link.obj")).expect("a link");
    symlink("../elsewhere/secret.obj", at("job/way_out.obj")).expect("a link");
    symlink("../elsewhere", at("job/other")).expect("a link");
    symlink("/dev/zero", at("job/zero.obj")).expect("a link");
    pipe(&at("job/pipe.obj"));
    let long = fs::File::create(at("job/long.obj")).expect("a file");
    long.set_len(TOO_LONG).expect("a file without blocks");
    folder
}

fn pipe(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status().expect("mkfifo runs");
    assert!(made.success(), "{}", path.display());
}

fn last(err: &str) -> &str {
    err.trim_end().lines().last().unwrap_or_default()
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
    .map(|(name, told)| (name.to_owned(), told))
    .to_vec()
}

#[test]
fn a_job_reads_only_files_below_its_folder() {
    let folder = workplace();
    let job = folder.path().join("job/job.json");
    for (name, told) in refused_names(folder.path()) {
        for (field, text) in jobs(&name) {
            fs::write(&job, text).expect("written");
            let arguments = ["deform", "job/bar.obj", "--job", "job/job.json", "-o", "out/out.obj"];
            let (code, err) = pliant(folder.path(), &[&arguments[..], &["--parents"]].concat());
            assert_eq!(code, Some(2), "{name}: {err}");
            let start = format!("pliant: job/job.json: {field}: ");
            assert!(
                last(&err).starts_with(&start) && err.contains(told),
                "{name}: {start}: {err}"
            );
            assert_eq!(told.contains("does not lie"), err.contains("--allow"), "{err}");
            assert!(!folder.path().join("out").exists(), "{name} left something behind");
        }
    }
    for name in ["near.obj", "inside/far.obj", "link.obj", "inside/../near.obj"] {
        for (_, text) in jobs(name) {
            fs::write(&job, text).expect("written");
            // From the folder of the job too, where its path has no folder in it.
            for (from, model, job, out) in [
                (".", "job/bar.obj", "job/job.json", "out.obj"),
                ("job", "bar.obj", "job.json", "../out.obj"),
            ] {
                let arguments = ["deform", model, "--job", job, "-o", out, "--force"];
                let (code, err) = pliant(&folder.path().join(from), &arguments);
                assert_eq!(code, Some(0), "{name}: {err}");
            }
        }
    }
}

#[test]
fn folders_can_be_allowed_and_what_is_no_file_in_them_is_refused_all_the_same() {
    let folder = workplace();
    pipe(&folder.path().join("elsewhere/pipe.obj"));
    fs::create_dir(folder.path().join("elsewhere_too")).expect("a folder");
    fs::write(folder.path().join("elsewhere_too/more.obj"), TRIANGLE).expect("written");
    let deform = |name: &str, allowed: &[&str]| {
        let (_, text) = jobs(name).into_iter().next().expect("one that merges");
        fs::write(folder.path().join("job/job.json"), text).expect("written");
        let arguments = ["deform", "job/bar.obj", "--job", "job/job.json", "-o", "out.obj"];
        pliant(folder.path(), &[&arguments[..], &["--force"], allowed].concat())
    };
    let absolute = folder.path().join("elsewhere/secret.obj").display().to_string();
    for name in [&absolute, "../elsewhere/secret.obj", "way_out.obj", "near.obj"] {
        let (code, err) = deform(name, &["--allow", "elsewhere"]);
        assert_eq!(code, Some(0), "{name}: {err}");
    }
    let both = ["--allow", "elsewhere", "--allow", "elsewhere_too"];
    assert_eq!(deform("../elsewhere_too/more.obj", &both).0, Some(0));
    for (name, allowed, told) in [
        // A folder whose name only begins alike is another one.
        (
            "../elsewhere_too/more.obj",
            &["--allow", "elsewhere"][..],
            "does not lie in",
        ),
        (
            "../elsewhere/pipe.obj",
            &["--allow", "elsewhere"],
            "is not a regular file",
        ),
        ("/dev/zero", &["--allow", "/dev"], "is not a regular file"),
        (
            "near.obj",
            &["--allow", "nowhere"],
            "--allow is nowhere, which is not a folder",
        ),
        (
            "near.obj",
            &["--allow", "job/bar.obj"],
            "--allow is job/bar.obj, which is not a folder",
        ),
    ] {
        let (code, err) = deform(name, allowed);
        assert_eq!(code, Some(2), "{name}: {err}");
        assert!(last(&err).contains(told), "{name}: {err}");
    }
}

#[test]
fn a_suite_reads_only_files_below_its_folder() {
    let folder = workplace();
    let at = |name: &str| folder.path().join(name);
    let check = |text: &str, arguments: &[&str]| {
        fs::write(at("job/one.case.json"), text).expect("written");
        pliant(folder.path(), &[&["check", "job", "--bless"], arguments].concat())
    };
    for (name, told) in refused_names(folder.path()) {
        for (field, job) in jobs(&name) {
            let text = format!(r#"{{"model": "bar.obj", "job": {job}}}"#);
            let (code, err) = check(&text, &[]);
            assert_eq!(code, Some(2), "{name}: {err}");
            let start = format!("pliant: job/one.case.json: job.{field}: ");
            assert!(
                last(&err).starts_with(&start) && err.contains(told),
                "{name}: {start}: {err}"
            );
        }
    }
    let within = refused_names(folder.path());
    let within = within
        .iter()
        .filter(|(name, _)| !name.contains("..") && !name.starts_with('/'));
    for (name, told) in within.filter(|(name, _)| !name.is_empty() && name != "none.obj") {
        for text in [
            format!(r#"{{"model": "{name}", "job": {{}}}}"#),
            format!(r#"{{"model": "bar.obj", "job": "{name}"}}"#),
            format!(r#"{{"model": "bar.obj", "animate": {{"bvh": "{name}"}}}}"#),
        ] {
            let (code, err) = check(&text, &[]);
            assert_eq!(code, Some(2), "{text}: {err}");
            assert!(last(&err).contains(told), "{text}: {err}");
        }
    }
    assert!(!at("job/one.golden.json").exists(), "something was stored");

    // A job in a folder below may name what lies elsewhere in the suite.
    let (_, job) = jobs("../near.obj").into_iter().next().expect("one that merges");
    fs::write(at("job/inside/job.json"), job.replacen("near.obj", "../link.obj", 1)).expect("written");
    let (code, err) = check(r#"{"model": "bar.obj", "job": "inside/job.json"}"#, &[]);
    assert_eq!(code, Some(0), "{err}");
    let (_, job) = jobs("way_out.obj").into_iter().next().expect("one that merges");
    let text = format!(r#"{{"model": "bar.obj", "job": {job}}}"#);
    let (code, err) = check(&text, &["--allow", "elsewhere"]);
    assert_eq!(code, Some(0), "{err}");

    // Goldens and cases are not read through links either, nor the data's models.
    fs::write(at("elsewhere/golden.json"), "{}").expect("written");
    fs::remove_file(at("job/one.golden.json")).expect("it was stored");
    symlink("../elsewhere/golden.json", at("job/one.golden.json")).expect("a link");
    let (code, err) = check(r#"{"model": "bar.obj", "job": {}}"#, &[]);
    assert_eq!(code, Some(2), "{err}");
    assert!(
        last(&err).contains("one.golden.json") && last(&err).contains("does not lie in"),
        "{err}"
    );
    assert_eq!(fs::read(at("elsewhere/golden.json")).expect("there"), b"{}");
    fs::remove_file(at("job/one.golden.json")).expect("a link");
    fs::create_dir(at("data")).expect("a folder");
    symlink("../elsewhere/secret.obj", at("data/model.obj")).expect("a link");
    let data = r#"{"model": "data:model.obj", "job": {}}"#;
    let (code, err) = check(data, &["--data", "data"]);
    assert_eq!(code, Some(2), "{err}");
    let told = "job/one.case.json: model: \"model.obj\" is ";
    assert!(
        last(&err).contains(told) && last(&err).contains("does not lie in"),
        "{err}"
    );
}

#[test]
fn a_path_that_was_typed_leads_anywhere_and_to_regular_files_alone() {
    let folder = workplace();
    fs::write(folder.path().join("job.json"), "{}").expect("written");
    let (code, err) = pliant(folder.path(), &["inspect", "job/way_out.obj"]);
    assert_eq!(code, Some(0), "{err}");
    for (path, told) in [
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
            let (code, err) = pliant(folder.path(), arguments);
            assert_eq!(code, Some(2), "{arguments:?}: {err}");
            let wanted = format!("{path} {told}");
            assert!(last(&err).contains(&wanted), "{arguments:?}: {err}");
        }
    }
}

#[test]
fn a_companion_that_is_a_pipe_is_refused_and_not_waited_for() {
    let folder = workplace();
    let model = r#"{"asset": {"version": "2.0"}, "buffers": [{"byteLength": 12, "uri": "model.bin"}]}"#;
    fs::write(folder.path().join("job/model.gltf"), model).expect("written");
    pipe(&folder.path().join("job/model.bin"));
    let (code, err) = pliant(folder.path(), &["inspect", "job/model.gltf"]);
    assert_eq!(code, Some(2), "{err}");
    let told = "job/model.gltf: job/model.bin is not a regular file, a file is needed";
    assert!(last(&err).contains(told), "{err}");
}

#[test]
fn no_link_under_the_name_of_a_temporary_file_is_written_through() {
    let folder = workplace();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("job.json"), "{}").expect("written");
    fs::write(at("victim"), "mine").expect("written");
    // The number of the process is known before the program runs.
    let script = r#"ln -s victim "out.obj.$$.part"; exec "$0" deform job/bar.obj --job job.json -o out.obj"#;
    let done = Command::new("sh")
        .args(["-c", script, env!("CARGO_BIN_EXE_pliant")])
        .current_dir(folder.path())
        .output()
        .expect("it runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert_eq!(fs::read(at("victim")).expect("there"), b"mine");
    let facts = fs::symlink_metadata(at("out.obj")).expect("written");
    let usual = fs::metadata(at("victim")).expect("there").permissions().mode();
    assert!(facts.is_file());
    assert_eq!(facts.permissions().mode(), usual, "as any file that is made here");
    let left = fs::read_dir(folder.path()).expect("a folder").flatten();
    let left = left.filter(|f| f.file_name().to_string_lossy().ends_with(".part"));
    assert_eq!(left.count(), 1, "only the link is left");

    // The partial file of an animation has a name that is known, and is made anew.
    let animate = ["animate", "creature.glb", "--clip", "walk", "-o", "walk.glb"];
    let (code, err) = pliant(folder.path(), &["sample", "figure", "-o", "creature.glb"]);
    assert_eq!(code, Some(0), "{err}");
    for target in ["victim", "nowhere"] {
        symlink(target, at("walk.glb.part")).expect("a link");
        let (code, err) = pliant(folder.path(), &animate);
        assert_eq!(code, Some(2), "{err}");
        assert!(last(&err).contains("walk.glb.part"), "{err}");
        let again = [&animate[..], &["--frames", "0:2", "--force"]].concat();
        let (code, err) = pliant(folder.path(), &again);
        assert_eq!(code, Some(0), "{err}");
        assert_eq!(fs::read(at("victim")).expect("there"), b"mine");
        assert!(!at("nowhere").exists() && at("walk.glb.part").symlink_metadata().is_err());
        fs::remove_file(at("walk.glb")).expect("it was written");
    }
    pipe(&at("walk.glb.part"));
    let resumed = [&animate[..], &["--resume"]].concat();
    let (code, err) = pliant(folder.path(), &resumed);
    assert_eq!(code, Some(2), "{err}");
    assert!(last(&err).contains("walk.glb.part is not a regular file"), "{err}");
}

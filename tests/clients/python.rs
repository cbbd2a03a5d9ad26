//! Clients as their authors write them, against the real server: the tours of README.md and `deploy/docs` with curl and
//! Python, a pipeline script that checks every answer, and the tests of the Python package and of the Blender add-on.
//!
//! The Python packages go into `target/clients` by the commands that `deploy/docs/other-languages.md` shows. What this machine lacks (bash, curl,
//! python3, a network to fetch packages) is said and skipped; everything else must hold.

use crate::support::data::{data_root, report_skipped};
use crate::support::process::{is_pip_offline, root, said};
use crate::support::program::ServedProgram;
use pliant::asset::{FileSet, Limits, Model};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// Whether a program answers to being asked for its version.
fn has(program: &str) -> bool {
    let asked = Command::new(program)
        .arg("--version")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    asked.is_ok_and(|status| status.success())
}

/// The page that shows how stubs are made.
const PAGE: &str = "deploy/docs/other-languages.md";

/// The one code block of that page with that first line.
fn block(first_line: &str) -> String {
    let page = fs::read_to_string(root().join(PAGE)).expect("the page can be read");
    let mut blocks = page
        .split("\n```")
        .skip(1)
        .step_by(2)
        .filter_map(|b| b.split_once('\n'));
    let found = blocks.find(|(_, text)| text.starts_with(first_line));
    found
        .unwrap_or_else(|| panic!("{PAGE} has no code block that begins with {first_line:?}"))
        .1
        .to_owned()
}

/// The Python of `target/clients` with grpcio and the stubs, made by the page's commands; or why there is none.
fn python() -> Result<&'static Path, &'static str> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    PYTHON
        .get_or_init(prepare)
        .as_ref()
        .map(PathBuf::as_path)
        .map_err(String::as_str)
}

fn prepare() -> Result<PathBuf, String> {
    for program in ["bash", "python3"] {
        if !has(program) {
            return Err(format!("there is no {program}"));
        }
    }
    let commands = block("python3 -m venv");
    let read = |name: &str| fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    let stamp = [
        commands.clone(),
        read("tests/clients/requirements.txt"),
        read("proto/pliant/v1/pliant.proto"),
    ]
    .concat();
    let home = root().join("target/clients");
    let python = home.join("bin/python");
    if fs::read_to_string(home.join("stamp")).is_ok_and(|old| old == stamp) && has(&python.to_string_lossy()) {
        return Ok(python);
    }
    for line in commands.lines() {
        let done = Command::new("bash")
            .args(["-c", line])
            .current_dir(root())
            .output()
            .expect("bash runs");
        if done.status.success() {
            continue;
        }
        let said = said(&done);
        let missing = line.contains("-m venv") || (line.contains("/pip ") && is_pip_offline(&said));
        assert!(missing, "`{line}` of {PAGE} failed:\n{said}");
        return Err(format!("`{line}` needs something that this machine lacks:\n{said}"));
    }
    fs::write(home.join("stamp"), stamp).expect("target can be written");
    Ok(python)
}

/// Runs a client to its end and shows what it said.
fn run(command: &mut Command) -> String {
    let done = command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"));
    let said = said(&done);
    println!("{said}");
    assert!(done.status.success(), "{command:?} ended with {}:\n{said}", done.status);
    said
}

/// Vertex positions of a model file.
pub(super) fn positions(path: &Path) -> Vec<[f64; 3]> {
    let bytes = fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let model = Model::read(FileSet::single(name, bytes), None, &Limits::default());
    model
        .unwrap_or_else(|e| panic!("{}: {e}", path.display()))
        .positions
        .iter()
        .map(|p| p.to_array())
        .collect()
}

/// The feet stand bit for bit, and the head has moved.
pub(super) fn assert_bent(rest: &[[f64; 3]], bent: &[[f64; 3]]) {
    assert_eq!(rest.len(), bent.len());
    let feet = rest.iter().zip(bent).filter(|(r, _)| -r[1] >= -0.14);
    assert!(feet.clone().count() > 0);
    assert!(feet.clone().all(|(r, b)| r == b), "the feet are held");
    let moved = rest
        .iter()
        .zip(bent)
        .map(|(r, b)| (0..3).map(|k| (r[k] - b[k]).powi(2)).sum::<f64>().sqrt());
    assert!(moved.fold(0.0, f64::max) > 0.05, "the head moves");
}

#[test]
fn the_tour_of_the_readme() {
    for program in ["bash", "curl", "python3"] {
        if !has(program) {
            return report_skipped("the tour", &format!("there is no {program}"));
        }
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &["--log", "warn"]);
    let at = |name: &str| folder.path().join(name);
    let script = root().join("tests/clients/tour.sh");
    let reply = run(Command::new("bash")
        .arg(&script)
        .arg(&server.url)
        .current_dir(folder.path()));
    let rest = positions(&at("creature.glb"));
    assert!(
        reply.contains(&format!("{} vertices", rest.len())),
        "the tour counts the vertices: {reply}"
    );
    assert_bent(&rest, &positions(&at("bent.glb")));
    assert_eq!(
        positions(&at("bent.obj")).len(),
        rest.len(),
        "OBJ has the same vertices"
    );

    let python = match python() {
        Ok(python) => python,
        Err(reason) => return report_skipped("the Python half of the tour", reason),
    };
    let mut client = Command::new(python);
    client
        .arg(root().join("tests/clients/tour.py"))
        .arg(server.url.trim_start_matches("http://"))
        .current_dir(folder.path());
    let reply = run(client.env("PYTHONPATH", root().join("target/clients")));
    assert!(reply.contains("pose 30: solved"), "the last pose is answered: {reply}");
    assert_bent(&rest, &positions(&at("nodding.glb")));

    let listed = run(Command::new("curl").args(["-sSf", &format!("{}/v1/sessions", server.url)]));
    let listed: serde_json::Value = serde_json::from_str(&listed).expect("JSON");
    assert_eq!(
        listed["sessions"],
        serde_json::json!([]),
        "the tour leaves no session behind"
    );
}

#[test]
fn a_pipeline_script_over_grpc() {
    let python = match python() {
        Ok(python) => python,
        Err(reason) => return report_skipped("the pipeline script", reason),
    };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &["--log", "warn"]);
    let mut client = Command::new(python);
    client.arg(root().join("tests/clients/pipeline.py")).arg(&server.url);
    let reply = run(client.env("PYTHONPATH", root().join("target/clients")));
    assert!(
        reply.contains("50 poses sent") && reply.contains("the session is deleted"),
        "{reply}"
    );
}

/// Its own virtual environment, types, every test and example; two hundred poses of the armadillo beside the command line.
#[test]
#[ignore = "takes minutes; .ci/run runs it"]
fn the_python_package_passes_its_own_tests() {
    // What drives the browser for its notebook widget; the package's tests say what they skip without it.
    let _ = crate::node::install("tests/clients/viewer");
    let Some(said) = run_own_tests("proto/clients/python") else {
        return;
    };
    let armadillo = data_root().join("meshes/armadillo.obj").is_file();
    let skipped = said.contains("there is no folder of test models") || said.contains("armadillo.obj");
    assert!(
        !armadillo || !skipped,
        "the armadillo is there and was not bent:\n{said}"
    );
}

/// Solves, drags, key frames and armatures in Blender without a window, beside the command line; the packed extension is installed.
#[test]
#[ignore = "fetches Blender once; .ci/run runs it"]
fn the_blender_add_on_passes_its_own_tests() {
    run_own_tests("proto/clients/blender");
}

/// Runs `run-tests` of a client with the program of this build; returns what it said, or `None` where nothing could run.
fn run_own_tests(folder: &str) -> Option<String> {
    let mut tests = Command::new("sh");
    tests
        .arg(root().join(folder).join("run-tests"))
        .env("PLIANT_BIN", env!("CARGO_BIN_EXE_pliant"))
        .env_remove("PLIANT_SERVER");
    let done = tests.output().expect("sh runs");
    let said = said(&done);
    // Seen also when the test passes: what was skipped, and why.
    let show = |text: &str| crate::support::process::show(&format!("{folder}: {text}"));
    if done.status.code() == Some(77) {
        show(said.trim());
        return None;
    }
    assert!(done.status.success(), "{said}");
    for line in said
        .lines()
        .filter(|l| l.starts_with("SKIPPED") || l.contains(" passed"))
    {
        show(line);
    }
    Some(said)
}

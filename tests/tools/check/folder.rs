//! A suite in a folder of its own, and the program run on it.

use crate::support::commands::{Arguments, Ran, pliant_in};
use crate::support::server::{bar_obj, ends};
use sha2::{Digest as _, Sha256};
use std::fs;
use std::path::{Path, PathBuf};

/// The suite that people start from.
pub fn sample_suite() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/ci/sample-suite")
}

/// Runs `pliant check` on a suite, in its folder, without the data of this machine.
pub fn check(suite: &Path, arguments: &(impl Arguments + ?Sized)) -> Ran {
    let folder = suite.parent().filter(|p| p.is_dir()).unwrap_or(Path::new("/"));
    let suite = suite.to_str().expect("UTF-8");
    run_in(folder, &[vec!["check", suite], arguments.list()].concat())
}

/// Runs the program in a folder.
pub fn run_in(folder: &Path, arguments: &(impl Arguments + ?Sized)) -> Ran {
    Ran::of(&mut pliant_in(folder, arguments))
}

/// A folder with a suite in it; reports are written beside that.
pub struct Suite {
    folder: tempfile::TempDir,
}

impl Suite {
    /// An empty one.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        fs::create_dir(folder.path().join("suite")).expect("a folder");
        Self { folder }
    }

    pub fn path(&self) -> PathBuf {
        self.folder.path().join("suite")
    }

    pub fn write(&self, name: &str, text: &str) {
        fs::write(self.path().join(name), text).expect("written");
    }

    /// A file of the suite, or a report.
    pub fn read(&self, name: &str) -> String {
        let inside = self.path().join(name);
        let path = if inside.exists() {
            inside
        } else {
            self.folder.path().join(name)
        };
        fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
    }

    pub fn remove(&self, name: &str) {
        fs::remove_file(self.path().join(name)).expect("it was there");
    }

    pub fn check(&self, arguments: &(impl Arguments + ?Sized)) -> Ran {
        check(&self.path(), arguments)
    }

    /// Checks, with this exit code.
    #[track_caller]
    pub fn exits(&self, code: i32, arguments: &(impl Arguments + ?Sized)) -> Ran {
        self.check(arguments).exits(code)
    }

    #[track_caller]
    pub fn passes(&self, arguments: &(impl Arguments + ?Sized)) -> Ran {
        self.exits(0, arguments)
    }

    #[track_caller]
    pub fn fails(&self, arguments: &(impl Arguments + ?Sized)) -> Ran {
        self.exits(1, arguments)
    }

    /// A suite of one case that bends a bar.
    pub fn of_bar() -> Self {
        let suite = Self::new();
        suite.case("bar", "bar.obj");
        suite
    }

    /// A case that bends a bar, with the bar.
    pub fn case(&self, name: &str, model: &str) {
        self.write(model, &bar_obj(20));
        self.job(name, model, 0.8);
    }

    /// The case alone, with the angle of its bend.
    pub fn job(&self, name: &str, model: &str, angle: f64) {
        let handles = ends();
        let text = format!(
            r#"{{"model": "{model}", "job": {{"handles": {handles},
                "steps": [{{"pose": {{"handles": [{{"id": "top", "pose": {{"rotationVector": [0, {angle}, 0]}}}}]}}}}],
                "options": {{"tolerance": 1e-8}}}}}}"#
        );
        self.write(&format!("{name}.case.json"), &text);
    }

    /// A case whose result is its model, with the model.
    pub fn still(&self, name: &str, model: &str) {
        self.write(model, &bar_obj(20));
        let handles = ends();
        let text = format!(r#"{{"model": "{model}", "job": {{"handles": {handles}}}}}"#);
        self.write(&format!("{name}.case.json"), &text);
    }

    /// Lets the golden of a case say that it was made from the model as it is now.
    pub fn pretend_model(&self, case: &str, model: &str) {
        let bytes = fs::read(self.path().join(model)).expect("a model");
        let hash: String = Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
        self.pretend(case, "model", &hash);
    }

    /// Lets the golden of a case say that it was made from the job of this case file.
    pub fn pretend_job(&self, case: &str, text: &str) {
        let read = pliant::check::SuiteCase::from_file("x.case.json", text.as_bytes()).expect("a case");
        let pliant::check::JobSource::Inline(job) = read.job else {
            panic!("the job is in the case");
        };
        self.pretend(case, "job", &pliant::check::job_hash(&job));
    }

    fn pretend(&self, case: &str, input: &str, hash: &str) {
        let name = format!("{case}.golden.json");
        let mut golden: serde_json::Value = serde_json::from_str(&self.read(&name)).expect("a golden");
        golden["inputs"][input] = hash.into();
        self.write(&name, &golden.to_string());
    }
}

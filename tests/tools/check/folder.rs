//! A suite in a folder of its own, and the program run on it.

use sha2::{Digest as _, Sha256};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The suite that people start from.
pub fn sample_suite() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/ci/sample-suite")
}

/// What the program said.
#[derive(Debug)]
pub struct Ran {
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
}

impl Ran {
    /// The last line of stderr.
    pub fn last(&self) -> &str {
        self.err.trim_end().lines().last().unwrap_or_default()
    }

    /// Whether stdout says what the last line of stderr does, where a document was asked for, and nothing else.
    pub fn tells_only_why(&self, asked: bool) -> bool {
        if !asked {
            return self.out.is_empty();
        }
        let error = &self.json()["error"];
        let told = format!("pliant: {}", error["message"].as_str().unwrap_or_default());
        error["exitCode"].as_i64() == self.code.map(i64::from) && told == self.last()
    }

    /// The document on stdout.
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {}{}", self.out, self.err))
    }
}

/// Runs `pliant check` on a suite, in its folder, without the data of this machine.
pub fn check(suite: &Path, arguments: &[&str]) -> Ran {
    let folder = suite.parent().filter(|p| p.is_dir()).unwrap_or(Path::new("/"));
    let suite = suite.to_str().expect("UTF-8");
    run_in(folder, &[&["check", suite], arguments].concat())
}

/// Runs the program in a folder, without the data of this machine.
pub fn run_in(folder: &Path, arguments: &[&str]) -> Ran {
    let done = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .args(arguments)
        .current_dir(folder)
        .env_remove("PLIANT_DATA")
        .env_remove("PLIANT_TOKEN")
        .output()
        .expect("it runs");
    Ran {
        code: done.status.code(),
        out: String::from_utf8(done.stdout).expect("text"),
        err: String::from_utf8(done.stderr).expect("text"),
    }
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

    pub fn check(&self, arguments: &[&str]) -> Ran {
        check(&self.path(), arguments)
    }

    /// A case that bends a bar, with the bar.
    pub fn case(&self, name: &str, model: &str) {
        self.write(model, &crate::support::server::bar_obj(20));
        self.job(name, model, 0.8);
    }

    /// The case alone, with the angle of its bend.
    pub fn job(&self, name: &str, model: &str, angle: f64) {
        let handles = crate::support::server::ends();
        let text = format!(
            r#"{{"model": "{model}", "job": {{"handles": {handles},
                "steps": [{{"pose": {{"handles": [{{"id": "top", "pose": {{"rotationVector": [0, {angle}, 0]}}}}]}}}}],
                "options": {{"tolerance": 1e-8}}}}}}"#
        );
        self.write(&format!("{name}.case.json"), &text);
    }

    /// A case whose result is its model, with the model.
    pub fn still(&self, name: &str, model: &str) {
        self.write(model, &crate::support::server::bar_obj(20));
        let handles = crate::support::server::ends();
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

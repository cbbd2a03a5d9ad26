//! A program that drives sessions with one of the clients, for as long as its input is open.

use super::Driven;
use crate::node::{build_typescript, tell};
use crate::support::server::{HANG, bar_obj};
use crate::workflows::program_of_package;
use std::fs::{self, File};
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc;

/// A running program. Dropping it kills it.
pub(super) struct Driver {
    name: &'static str,
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: Option<BufReader<ChildStdout>>,
    log: PathBuf,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// What the Python client needs, by its own words.
fn python_needs() -> Vec<String> {
    let project = fs::read_to_string(root().join("proto/clients/python/pyproject.toml")).expect("a project");
    let (_, listed) = project.split_once("\ndependencies = [").expect("a list");
    let (listed, _) = listed.split_once(']').expect("its end");
    listed.split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

impl Driver {
    /// The Python client; `None` where Python or its packages cannot be had.
    pub(super) fn python(url: &str, folder: &Path, sessions: usize) -> Option<Self> {
        let needs = python_needs();
        let needs: Vec<&str> = needs.iter().map(String::as_str).collect();
        let mut command = Command::new(program_of_package("python-client-needs", &needs, "python")?);
        command
            .arg(root().join("tests/clients/through_proxy/drive.py"))
            .env("PYTHONPATH", root().join("proto/clients/python"))
            .env("PYTHONDONTWRITEBYTECODE", "1");
        Some(Self::start("Python", command, (url, folder, sessions)))
    }

    /// The TypeScript client; `None` where node or its packages cannot be had.
    pub(super) fn typescript(url: &str, folder: &Path, sessions: usize) -> Option<Self> {
        let _held = crate::hold_typescript_package();
        if let Err(reason) = build_typescript() {
            tell(&format!("SKIPPED: sessions of the TypeScript client: {reason}"));
            return None;
        }
        let mut command = Command::new("node");
        command
            .arg("--experimental-websocket")
            .arg(root().join("tests/clients/through_proxy/drive.mjs"));
        Some(Self::start("TypeScript", command, (url, folder, sessions)))
    }

    /// Starts a program, and waits until all of its sessions are open.
    fn start(name: &'static str, mut command: Command, (url, folder, sessions): (&str, &Path, usize)) -> Self {
        let model = folder.join("bar.obj");
        fs::write(&model, bar_obj(12)).expect("written");
        let log = folder.join(name);
        let mut child = command
            .args([url, model.to_str().expect("UTF-8"), &sessions.to_string()])
            .env_remove("PLIANT_TOKEN")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(File::create(&log).expect("a log"))
            .spawn()
            .expect("it starts");
        let mut driver = Self {
            name,
            stdin: child.stdin.take(),
            stdout: child.stdout.take().map(BufReader::new),
            child,
            log,
        };
        let mut line = String::new();
        let read = driver.stdout.as_mut().expect("piped").read_line(&mut line);
        read.expect("a line");
        assert_eq!(line, "ready\n", "{name}: {}", driver.said());
        driver
    }

    fn said(&self) -> String {
        fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Ends it; its name, and what came back.
    pub(super) fn finish(mut self) -> (&'static str, Vec<Driven>) {
        drop(self.stdin.take());
        let (said, heard) = mpsc::channel();
        let mut stdout = self.stdout.take().expect("piped");
        std::thread::spawn(move || {
            let mut told = String::new();
            let read = stdout.read_to_string(&mut told).map(|_| told);
            drop(said.send(read));
        });
        let told = heard
            .recv_timeout(HANG)
            .unwrap_or_else(|_| panic!("{} does not end: {}", self.name, self.said()))
            .expect("UTF-8");
        let status = self.child.wait().expect("it ends");
        assert!(status.success(), "{}: {status}: {}", self.name, self.said());
        let driven = serde_json::from_str(&told).unwrap_or_else(|e| panic!("{}: {e}: {told}", self.name));
        (self.name, driven)
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

//! A folder like a checkout's root in which the blocks of a page are played as their reader would: commands by a shell,
//! files written, servers left running.
//!
//! What differs from the reader's machine: `cargo run --release --` is the program that the tests were built with, servers
//! take a free port, and `127.0.0.1:7411` is replaced by theirs.

use super::book::{Block, is_like};
use crate::support::process::{is_npm_offline, is_pip_offline, root};
use std::fs;
use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Where the reader's server listens.
const USUAL: &str = "127.0.0.1:7411";

/// What a reader types to start the program; each is the same program.
const PROGRAM: [&str; 2] = ["cargo run --release -- ", "target/release/pliant "];

/// Folders whose small files are copied, so that the port in them can be replaced.
const COPIED: &str = "tests/clients";

/// How a block went.
pub enum Played {
    /// As it should.
    Well,
    /// Something of this machine is missing.
    Skipped(String),
}

/// The folder, and what runs in it.
pub struct Checkout {
    folder: tempfile::TempDir,
    servers: Vec<Child>,
    /// Where the server started last listens.
    address: Option<String>,
    /// What the last commands wrote.
    said: String,
}

impl Checkout {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        for entry in fs::read_dir(root()).expect("the checkout can be read") {
            let name = entry.expect("an entry").file_name();
            let name = name.to_string_lossy();
            if !["target", "tests", ".git"].contains(&name.as_ref()) {
                symlink(root().join(name.as_ref()), at(&name)).expect("a link");
            }
        }
        fs::create_dir_all(at("target/release")).expect("a folder");
        fs::create_dir_all(at(COPIED)).expect("a folder");
        symlink(env!("CARGO_BIN_EXE_pliant"), at("target/release/pliant")).expect("a link");
        let checkout = Self {
            folder,
            servers: Vec::new(),
            address: None,
            said: String::new(),
        };
        checkout.copy_clients();
        checkout
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The URL of the server started last.
    pub fn server(&self) -> Option<String> {
        self.address.as_ref().map(|address| format!("http://{address}"))
    }

    /// Plays one block.
    pub fn play(&mut self, block: &Block) -> Played {
        for program in block
            .word("needs")
            .unwrap_or_default()
            .split(',')
            .filter(|p| !p.is_empty())
        {
            if program == "data" && !has_data() {
                return Played::Skipped("PLIANT_DATA names no folder of model files".into());
            }
            if program != "data" && !has(program) {
                return Played::Skipped(format!("there is no {program}"));
            }
        }
        let text = self.here(&block.text);
        if let Some(name) = block.word("file") {
            let path = self.path(name);
            fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
            fs::write(&path, &text).unwrap_or_else(|e| panic!("{name}: {e}"));
            return Played::Well;
        }
        match block.language.as_str() {
            "sh" | "bash" => self.shell(&block.text),
            "python" => {
                fs::write(self.path("target/block.py"), &text).expect("written");
                self.shell("target/venv/bin/python target/block.py")
            }
            "text" => {
                self.compare(&text);
                Played::Well
            }
            other => panic!(
                "line {}: a block of {other:?} is neither run nor written to a file",
                block.line
            ),
        }
    }

    /// The text with the running server's port.
    fn here(&self, text: &str) -> String {
        match &self.address {
            Some(address) => text.replace(USUAL, address),
            None => text.to_owned(),
        }
    }

    /// Runs commands in order; those that start a server stay.
    fn shell(&mut self, text: &str) -> Played {
        let mut script = String::new();
        for line in text.lines() {
            let line = PROGRAM.iter().fold(line.to_owned(), |line, program| {
                line.replace(program, "target/release/pliant ")
            });
            if let Some(keys) = line.strip_prefix("target/release/pliant serve") {
                self.run(&std::mem::take(&mut script), text);
                self.serve(keys);
            } else if !line.starts_with("cargo test") && !line.starts_with("cargo build") {
                // Those two are what is being done.
                script += &self.here(&line);
                script.push('\n');
            }
        }
        self.run(&script, text)
    }

    fn run(&mut self, script: &str, shown: &str) -> Played {
        if script.trim().is_empty() {
            return Played::Well;
        }
        let done = Command::new("bash")
            .args(["-euo", "pipefail", "-c", script])
            .current_dir(self.folder.path())
            .env_remove("PLIANT_BIN")
            .env_remove("PLIANT_SERVER")
            .stdin(Stdio::null())
            .output()
            .unwrap_or_else(|e| panic!("bash: {e}"));
        self.said = [done.stdout, done.stderr]
            .map(|b| String::from_utf8_lossy(&b).into_owned())
            .concat();
        println!("{shown}{}", self.said);
        let fetches = ["pip install", "pip wheel", "proto/clients/blender/build", "npm "]
            .iter()
            .any(|f| shown.contains(f));
        if !done.status.success() && ((fetches && is_offline(&self.said)) || lacks_venv(shown, &self.said)) {
            return Played::Skipped(format!("packages cannot be fetched:\n{}", self.said));
        }
        assert!(
            done.status.success(),
            "{shown}ended with {}:\n{}",
            done.status,
            self.said
        );
        Played::Well
    }

    fn serve(&mut self, keys: &str) {
        let mut server = Command::new(env!("CARGO_BIN_EXE_pliant"))
            .arg("serve")
            .args(keys.split_whitespace().take_while(|word| *word != "&"))
            .args(["--listen=127.0.0.1:0", "--log=warn"])
            .current_dir(self.folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the server starts");
        let mut stdout = BufReader::new(server.stdout.take().expect("piped"));
        self.servers.push(server);
        let mut line = String::new();
        stdout.read_line(&mut line).expect("the server says where it listens");
        let address = line.trim().strip_prefix("listening on ");
        let address = address.and_then(|url| Some(url.split_once("://")?.1));
        self.address = Some(
            address
                .unwrap_or_else(|| panic!("the server said {line:?} first"))
                .to_owned(),
        );
        // What it writes later is read, so that it never waits.
        std::thread::spawn(move || stdout.read_to_end(&mut Vec::new()));
        self.copy_clients();
    }

    fn copy_clients(&self) {
        for entry in fs::read_dir(root().join(COPIED)).expect("the clients") {
            let from = entry.expect("an entry").path();
            let to = self.path(COPIED).join(from.file_name().expect("a name"));
            if from.is_file() {
                let text = fs::read_to_string(&from).expect("a text");
                let _ = fs::remove_file(&to);
                fs::write(&to, self.here(&text)).expect("written");
                let mode = fs::metadata(&from).expect("its rights").permissions();
                fs::set_permissions(&to, mode).expect("its rights");
            } else if !to.exists() {
                symlink(&from, &to).expect("a link");
            }
        }
    }

    /// Whether the last commands wrote these lines, in this order; `…` stands for anything.
    fn compare(&self, wanted: &str) {
        let mut said = self.said.lines();
        for line in wanted
            .lines()
            .filter(|line| !line.trim().is_empty() && line.trim() != "…")
        {
            let found = said.any(|seen| is_like(seen, &self.here(line)));
            assert!(
                found,
                "the page shows the line\n{line}\nbut what was written is\n{}",
                self.said
            );
        }
    }
}

impl Drop for Checkout {
    fn drop(&mut self) {
        for server in &mut self.servers {
            let _ = server.kill();
            let _ = server.wait();
        }
    }
}

/// Whether there is a folder of model files.
fn has_data() -> bool {
    std::env::var_os("PLIANT_DATA").is_some_and(|folder| Path::new(&folder).is_dir())
}

/// Whether a program can be found, or for `lib:NAME` a library by pkg-config.
pub fn has(program: &str) -> bool {
    let mut command = match program.strip_prefix("lib:") {
        Some(library) => {
            let mut asked = Command::new("pkg-config");
            asked.args(["--exists", library]);
            asked
        }
        None => {
            let mut asked = Command::new("sh");
            asked.args(["-c", &format!("command -v {program}")]);
            asked
        }
    };
    let asked = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
    asked.is_ok_and(|status| status.success())
}

/// Whether pip or npm failed because they reached no package index.
pub fn is_offline(said: &str) -> bool {
    is_pip_offline(said) || is_npm_offline(said) || said.contains("No matching distribution")
}

fn lacks_venv(shown: &str, said: &str) -> bool {
    shown.contains("-m venv") && said.contains("ensurepip")
}

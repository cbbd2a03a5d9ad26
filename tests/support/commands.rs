//! The program as a script runs it, and folders to run it in.

use pliant::asset::sample;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What the program said.
#[derive(Debug)]
pub struct Ran {
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
    arguments: String,
}

impl Ran {
    /// Runs a command to its end.
    pub fn of(command: &mut Command) -> Self {
        let arguments = format!("{:?}", command.get_args().collect::<Vec<_>>());
        let done = command.output().expect("it runs");
        Self {
            code: done.status.code(),
            out: String::from_utf8(done.stdout).expect("text"),
            err: String::from_utf8_lossy(&done.stderr).into_owned(),
            arguments,
        }
    }

    /// The last line of stderr.
    pub fn last(&self) -> &str {
        self.err.trim_end().lines().last().unwrap_or_default()
    }

    /// The document on stdout.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {}{}", self.out, self.err))
    }

    /// Whether stdout says what the last line of stderr does, where a document was asked for, and nothing else.
    pub fn reports_only_why(&self, asked: bool) -> bool {
        if !asked {
            return self.out.is_empty();
        }
        let error = &self.json()["error"];
        let reply = format!("pliant: {}", error["message"].as_str().unwrap_or_default());
        error["exitCode"].as_i64() == self.code.map(i64::from) && reply == self.last()
    }

    /// Asserts exit code 2, with all of these words in the last line of stderr.
    #[track_caller]
    pub fn refused(self, words: &[&str]) -> Self {
        let ran = self.exits(2);
        ran.gives(words);
        ran
    }

    /// Asserts that it ended well.
    #[track_caller]
    pub fn well(self) -> Self {
        self.exits(0)
    }

    /// Asserts the exit code.
    #[track_caller]
    pub fn exits(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{}: {}", self.arguments, self.err);
        self
    }

    /// Asserts that stderr has all of these words.
    #[track_caller]
    pub fn says(&self, words: &[&str]) {
        for word in words {
            assert!(self.err.contains(word), "{}: {word} in {}", self.arguments, self.err);
        }
    }

    /// Asserts that the last line of stderr gives a reason with all of these words.
    #[track_caller]
    pub fn gives(&self, words: &[&str]) {
        let last = self.last();
        assert!(last.starts_with("pliant: "), "{}: {}", self.arguments, self.err);
        for word in words {
            assert!(last.contains(word), "{}: {word} in {last}", self.arguments);
        }
    }
}

/// What follows the name of the program: words, or a line in which none holds a space.
pub trait Arguments {
    fn list(&self) -> Vec<&str>;
}

impl Arguments for str {
    fn list(&self) -> Vec<&str> {
        self.split_whitespace().collect()
    }
}

impl Arguments for String {
    fn list(&self) -> Vec<&str> {
        self.as_str().list()
    }
}

/// The arguments of a command line in which none holds a space.
pub fn words(line: &str) -> Vec<&str> {
    line.list()
}

impl Arguments for [&str] {
    fn list(&self) -> Vec<&str> {
        self.to_vec()
    }
}

impl<const N: usize> Arguments for [&str; N] {
    fn list(&self) -> Vec<&str> {
        self.to_vec()
    }
}

impl Arguments for Vec<&str> {
    fn list(&self) -> Vec<&str> {
        self.clone()
    }
}

/// The program in a folder, with no variable of its own from the surroundings.
pub fn pliant_in(folder: &Path, arguments: &(impl Arguments + ?Sized)) -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_pliant"));
    program.args(arguments.list()).current_dir(folder);
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("PLIANT_")) {
        program.env_remove(name);
    }
    program
}

/// A folder to run the program in.
pub struct Workplace(tempfile::TempDir);

impl std::ops::Deref for Workplace {
    type Target = Path;

    fn deref(&self) -> &Path {
        self.0.path()
    }
}

impl Workplace {
    pub fn empty() -> Self {
        Self(tempfile::tempdir().expect("a folder"))
    }

    /// A folder with creature.glb in it.
    pub fn new() -> Self {
        Self::with("creature.glb", sample::creature_glb())
    }

    /// A folder with a file in it.
    pub fn with(name: &str, bytes: impl AsRef<[u8]>) -> Self {
        let folder = Self::empty();
        folder.put(name, bytes);
        folder
    }

    pub fn path(&self) -> &Path {
        self
    }

    pub fn at(&self, name: &str) -> PathBuf {
        self.join(name)
    }

    /// Writes a file.
    pub fn put(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.at(name), bytes).expect("written");
    }

    pub fn text(&self, name: &str) -> String {
        String::from_utf8(self.bytes(name)).expect("text")
    }

    pub fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.at(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    pub fn run(&self, arguments: &(impl Arguments + ?Sized)) -> Ran {
        Ran::of(&mut pliant_in(self.path(), arguments))
    }

    /// Runs the program, which succeeds.
    #[track_caller]
    pub fn done(&self, arguments: &(impl Arguments + ?Sized)) -> Ran {
        self.run(arguments).exits(0)
    }

    /// Runs the program, which ends with exit code 2 and a reason with these words in its last line.
    #[track_caller]
    pub fn refused(&self, arguments: &(impl Arguments + ?Sized), words: &[&str]) -> Ran {
        self.run(arguments).refused(words)
    }
}

/// Runs the program in a folder by a script of Python that makes a terminal for it: the exit code, and what was drawn there.
pub fn on_a_terminal(folder: &Path, script: &str, arguments: &[&str]) -> Option<(Option<i32>, String)> {
    let mut command = Command::new("python3");
    command
        .args(["-c", script, env!("CARGO_BIN_EXE_pliant")])
        .args(arguments);
    let Ok(done) = command.current_dir(folder).env("TERM", "xterm").output() else {
        println!("SKIPPED: python3 is not here to make a terminal");
        return None;
    };
    Some((done.status.code(), String::from_utf8_lossy(&done.stdout).into_owned()))
}

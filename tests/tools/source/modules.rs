//! The files of the workspace, and which module of which crate each of them is.

use super::tokens::{Token, tokens};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// A source file, read as tokens.
pub struct SourceFile {
    /// From the root of the repository, as `src/mesh/weld.rs`.
    pub place: String,
    /// The folder of its crate's root file, as `src`; two crates never share it.
    pub crate_folder: String,
    /// `["mesh", "weld"]`; empty for the root of a crate.
    pub module: Vec<String>,
    /// How many lines it has.
    pub lines: usize,
    /// Its tokens with their lines.
    pub tokens: Vec<(Token, usize)>,
    /// Whether each token stands in an item that is compiled for tests only.
    pub test_only: Vec<bool>,
}

impl SourceFile {
    /// The word at a token, if it is one.
    pub fn word(&self, i: usize) -> Option<&str> {
        match self.tokens.get(i) {
            Some((Token::Word(word), _)) => Some(word),
            _ => None,
        }
    }

    /// Whether the token is this sign.
    pub fn is_sign(&self, i: usize, sign: char) -> bool {
        matches!(self.tokens.get(i), Some((Token::Sign(s), _)) if *s == sign)
    }

    /// The line of a token.
    pub fn line(&self, i: usize) -> usize {
        self.tokens.get(i).map_or(self.lines, |t| t.1)
    }

    /// The token after the bracket that closes the one at `open`.
    pub fn after_bracket(&self, open: usize) -> usize {
        let mut depth = 0usize;
        for i in open..self.tokens.len() {
            match &self.tokens[i].0 {
                Token::Sign('(' | '[' | '{') => depth += 1,
                Token::Sign(')' | ']' | '}') => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                return i + 1;
            }
        }
        self.tokens.len()
    }
}

/// Every Rust file of a checkout that belongs to the program: its crates, without their tests' folders and examples.
pub fn crate_files(root: &Path) -> Vec<SourceFile> {
    let mut roots = Vec::new();
    find_crates(root, &mut roots);
    // The crate whose folder is deepest owns a file.
    roots.sort_by_key(|folder| std::cmp::Reverse(folder.components().count()));
    let mut files = rust_files(root, &root.join("src"));
    files.extend(rust_files(root, &root.join("loadtest")));
    let mut read: Vec<SourceFile> = files
        .iter()
        .filter(|path| {
            !path
                .iter()
                .any(|part| part == "tests" || part == "examples" || part == "benches")
        })
        .filter_map(|path| {
            let folder = roots.iter().find(|folder| path.starts_with(folder))?;
            Some(read_file(root, path, folder))
        })
        .collect();
    mark_test_files(&mut read);
    read
}

/// Every Rust file of the tests and examples.
pub fn test_files(root: &Path) -> Vec<SourceFile> {
    let folders = [
        "tests",
        "examples",
        "loadtest/tests",
        "src/solver/tests",
        "src/solver/examples",
    ];
    let files = folders.iter().flat_map(|folder| rust_files(root, &root.join(folder)));
    files.map(|path| read_file(root, &path, Path::new("tests"))).collect()
}

/// The Rust files below a folder, from the root of the checkout, without build scripts.
pub fn rust_files(root: &Path, folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let mut found = Vec::new();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() && name != "target" && name != "node_modules" {
            found.extend(rust_files(root, &path));
        } else if name.ends_with(".rs") && name != "build.rs" {
            found.push(path.strip_prefix(root).expect("below the root").to_owned());
        }
    }
    found
}

/// The folders of the root files of all crates, from the root of the checkout.
fn find_crates(root: &Path, found: &mut Vec<PathBuf>) {
    let inside = fs::read_dir(root.join("src")).into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> = inside.map(|entry| Path::new("src").join(entry.file_name())).collect();
    folders.extend(["", "loadtest"].map(PathBuf::from));
    for folder in folders {
        if let Ok(manifest) = fs::read_to_string(root.join(&folder).join("Cargo.toml")) {
            let library = manifest.split("[lib]").nth(1).and_then(|rest| {
                let line = rest
                    .lines()
                    .skip(1)
                    .take_while(|l| !l.starts_with('['))
                    .find(|l| l.starts_with("path"));
                line.and_then(|l| l.split('"').nth(1))
            });
            let file = folder.join(library.unwrap_or("src/lib.rs"));
            found.push(file.parent().unwrap_or(Path::new("")).to_owned());
        }
    }
}

fn read_file(root: &Path, path: &Path, crate_folder: &Path) -> SourceFile {
    let text = fs::read_to_string(root.join(path)).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let inside = path.strip_prefix(crate_folder).unwrap_or(path).with_extension("");
    let mut module: Vec<String> = inside.iter().map(|s| s.to_string_lossy().into_owned()).collect();
    if matches!(module.last().map(String::as_str), Some("mod" | "lib" | "main")) {
        module.pop();
    }
    let mut file = SourceFile {
        place: path.display().to_string(),
        crate_folder: crate_folder.display().to_string(),
        module,
        lines: text.lines().count(),
        tokens: tokens(&text),
        test_only: Vec::new(),
    };
    file.test_only = test_only(&file);
    file
}

/// Whether each token stands below `#[cfg(test)]`.
fn test_only(file: &SourceFile) -> Vec<bool> {
    let mut test_only = vec![false; file.tokens.len()];
    let mut i = 0;
    while i < file.tokens.len() {
        let cfg = file.word(i + 2) == Some("cfg") && file.word(i + 4) == Some("test") && file.is_sign(i + 5, ')');
        if file.is_sign(i, '#') && file.is_sign(i + 1, '[') && cfg {
            // The item ends with its block or a semicolon.
            let mut end = i + 7;
            while end < file.tokens.len() && !file.is_sign(end, ';') && !file.is_sign(end, '{') {
                end = if file.is_sign(end, '[') || file.is_sign(end, '(') {
                    file.after_bracket(end)
                } else {
                    end + 1
                };
            }
            end = if file.is_sign(end, '{') {
                file.after_bracket(end)
            } else {
                end + 1
            };
            test_only[i..end.min(file.tokens.len())].fill(true);
            i = end;
        } else {
            i += 1;
        }
    }
    test_only
}

/// Marks files whole that a `#[cfg(test)] mod name;` declares.
fn mark_test_files(files: &mut [SourceFile]) {
    let mut declared = BTreeSet::new();
    for file in files.iter() {
        for i in 0..file.tokens.len() {
            if file.test_only[i] && file.word(i) == Some("mod") && file.is_sign(i + 2, ';') {
                let mut module = file.module.clone();
                module.extend(file.word(i + 1).map(str::to_owned));
                declared.insert((file.crate_folder.clone(), module));
            }
        }
    }
    for file in files {
        let declared =
            (1..=file.module.len()).any(|k| declared.contains(&(file.crate_folder.clone(), file.module[..k].to_vec())));
        if declared {
            file.test_only.fill(true);
        }
    }
}

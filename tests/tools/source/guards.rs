//! What the source keeps: each guard says what to do about what it found.
//!
//! Where a guard was broken when it was written, a number says how much of that is left. It may only sink: who mends
//! one lowers it, and at 0 the line goes.

use super::functions::{DefinedFunction, defined_functions};
use super::imports::{circles, imported_files, shortest_circle};
use super::modules::crate_files;
use super::types::defined_types;
use std::path::Path;

/// Type names that stand more than once, each with its reason.
const SHARED_TYPE_NAMES: [(&str, &str); 1] = [("Error", "one per module, named by its module: `mesh::Error`")];

/// Type names without a reason that are left.
const SHARED_TYPE_NAMES_LEFT: usize = 0;

/// Files that import in a circle that are left.
const FILES_IN_CIRCLES_LEFT: usize = 0;

/// The longest file, in lines.
const LONGEST_FILE: usize = 600;

/// The longest function, in lines.
const LONGEST_FUNCTION: usize = 100;

/// Longer functions that are left.
const LONG_FUNCTIONS_LEFT: usize = 0;

/// The most parameters of a function, `self` among them.
const MOST_PARAMETERS: usize = 6;

/// Functions with more that are left.
const WIDE_FUNCTIONS_LEFT: usize = 0;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Fails when more is wrong than is known, or less, so that the number follows.
fn check_left(found: usize, left: usize, left_name: &str, advice: &str, problems: &[String]) {
    let list = problems.join("\n");
    assert!(found <= left, "{found}, at most {left} of them known: {advice}\n{list}");
    if found < left {
        println!("{found} of {left} are left: lower {left_name} in {}", file!());
    }
}

#[test]
fn no_file_imports_in_a_circle() {
    let files = crate_files(root());
    let imported = imported_files(&files);
    let tangles = circles(&imported);
    let problems: Vec<String> = tangles
        .iter()
        .map(|tangle| {
            let way = shortest_circle(&imported, tangle[0]);
            let names: Vec<&str> = way.iter().map(|&k| files[k].place.as_str()).collect();
            format!("{} files, such as {}", tangle.len(), names.join(" → "))
        })
        .collect();
    check_left(
        tangles.iter().map(Vec::len).sum(),
        FILES_IN_CIRCLES_LEFT,
        "FILES_IN_CIRCLES_LEFT",
        "files import from each other: move what both need into a file of its own, or pass it as an argument",
        &problems,
    );
}

#[test]
fn no_type_name_stands_twice_without_a_reason() {
    let types = defined_types(&crate_files(root()));
    for (name, _) in SHARED_TYPE_NAMES {
        let shared = types.get(name).is_some_and(|places| places.len() > 1);
        assert!(shared, "{name} stands once now: take it out of SHARED_TYPE_NAMES");
    }
    let problems: Vec<String> = types
        .iter()
        .filter(|(name, places)| places.len() > 1 && !SHARED_TYPE_NAMES.iter().any(|(known, _)| known == name))
        .map(|(name, places)| format!("{name}: {}", places.join(", ")))
        .collect();
    check_left(
        problems.len(),
        SHARED_TYPE_NAMES_LEFT,
        "SHARED_TYPE_NAMES_LEFT",
        "one name for two things: name each by what it is, or give the reason in SHARED_TYPE_NAMES",
        &problems,
    );
}

/// Crates whose results depend on their arguments alone.
const COMPUTING: [&str; 11] = [
    "asset",
    "core",
    "deform",
    "edit",
    "exec",
    "mesh",
    "motion",
    "reference",
    "render",
    "solver",
    "wire",
];

/// Names that computing crates do without outside tests, and what to do instead.
const FOREIGN: [(&str, &str); 15] = [
    ("Instant", "let the caller pass a clock in, as batch::run does"),
    ("SystemTime", "let the caller pass a clock in, as batch::run does"),
    ("std::net", "readers and writers take Read and Write"),
    ("std::fs", "readers and writers take Read and Write; cli opens files"),
    (
        "std::env",
        "settings are arguments; server::config and cli read the environment",
    ),
    ("std::process", "return an error; cli decides about exit codes"),
    ("std::thread", "take a &Pool and run inside it"),
    (
        "HashMap",
        "its order differs between runs; use BTreeMap or a sorted Vec",
    ),
    (
        "HashSet",
        "its order differs between runs; use BTreeSet or a sorted Vec",
    ),
    ("println", "return it, or report it through Progress; cli prints"),
    ("eprintln", "return it, or report it through Progress; cli prints"),
    ("print", "return it, or report it through Progress; cli prints"),
    ("eprint", "return it, or report it through Progress; cli prints"),
    ("dbg", "return it, or report it through Progress; cli prints"),
    (
        "thread_local",
        "no global state; keep scratch in a workspace that the caller owns",
    ),
];

#[test]
fn computing_crates_know_no_clock_network_or_terminal() {
    let mut problems = Vec::new();
    for file in crate_files(root()) {
        let crate_name = file
            .crate_folder
            .strip_prefix("src/")
            .and_then(|c| c.strip_suffix("/src"));
        if !crate_name.is_some_and(|name| COMPUTING.contains(&name)) {
            continue;
        }
        for (name, advice) in FOREIGN {
            let words: Vec<&str> = name.split("::").collect();
            // `std :: fs` is four tokens: two words with two signs between them.
            let names_it = |i: usize| {
                words
                    .iter()
                    .enumerate()
                    .all(|(k, word)| file.word(i + 3 * k) == Some(word))
            };
            let found = (0..file.tokens.len()).find(|&i| !file.test_only[i] && names_it(i));
            problems.extend(found.map(|i| format!("{}:{}: names {name}: {advice}", file.place, file.line(i))));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn no_file_is_too_long() {
    let long = crate_files(root()).into_iter().filter(|f| f.lines > LONGEST_FILE);
    let problems: Vec<String> = long.map(|f| format!("{}: {} lines", f.place, f.lines)).collect();
    assert!(
        problems.is_empty(),
        "files of more than {LONGEST_FILE} lines: give each concept a file of its own\n{}",
        problems.join("\n")
    );
}

#[test]
fn no_function_is_too_long() {
    let problems = too_much(|f| f.lines > LONGEST_FUNCTION, |f| format!("{} lines", f.lines));
    check_left(
        problems.len(),
        LONG_FUNCTIONS_LEFT,
        "LONG_FUNCTIONS_LEFT",
        "give the stages of a long function functions of their own, named by what they do",
        &problems,
    );
}

#[test]
fn no_function_takes_too_many_parameters() {
    let problems = too_much(
        |f| f.parameters > MOST_PARAMETERS,
        |f| format!("{} parameters", f.parameters),
    );
    check_left(
        problems.len(),
        WIDE_FUNCTIONS_LEFT,
        "WIDE_FUNCTIONS_LEFT",
        "parameters that always go together are one thing: give it a type and a name",
        &problems,
    );
}

fn too_much(
    is_too_much: impl Fn(&DefinedFunction) -> bool,
    reported: impl Fn(&DefinedFunction) -> String,
) -> Vec<String> {
    let functions = defined_functions(&crate_files(root()));
    let found = functions.iter().filter(|f| is_too_much(f));
    found
        .map(|f| format!("{} {}: {}", f.place, f.name, reported(f)))
        .collect()
}

/// The reader itself: what it must see.
mod reader {
    use super::super::functions::defined_functions;
    use super::super::imports::{circles, imported_files};
    use super::super::modules::{SourceFile, crate_files};
    use super::super::types::defined_types;
    use std::fs;

    /// A crate of these files.
    fn crate_of(files: &[(&str, &str)]) -> Vec<SourceFile> {
        let name = files.iter().map(|(_, text)| text.len()).sum::<usize>();
        let folder = std::env::temp_dir().join(format!("pliant-source-{}-{name}", std::process::id()));
        fs::create_dir_all(folder.join("src")).expect("a folder");
        fs::write(folder.join("Cargo.toml"), "[package]\n").expect("a file");
        for (place, text) in files {
            let path = folder.join("src").join(place);
            fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
            fs::write(path, text).expect("a file");
        }
        let read = crate_files(&folder);
        fs::remove_dir_all(folder).expect("removed");
        read
    }

    #[test]
    fn names_are_followed_to_the_files_that_define_them() {
        let files = crate_of(&[
            ("lib.rs", "pub mod a; pub mod b; pub mod c;"),
            // A re-export is not a import: `b` uses what `one` defines, and `one` uses nothing of `a/mod.rs`.
            ("a/mod.rs", "mod one; pub use one::One; pub(crate) use self::one::go;"),
            ("a/one.rs", "use crate::c; pub struct One; pub fn go() { c::turn() }"),
            (
                "b.rs",
                "use crate::a::{One, go as start}; pub(crate) struct Back; fn f(_: One) { start() }",
            ),
            (
                "c.rs",
                "pub fn turn() {} #[cfg(test)] mod tests { use crate::b::Back; }",
            ),
        ]);
        let imported = imported_files(&files);
        let at = |place: &str| {
            files
                .iter()
                .position(|f| f.place == format!("src/{place}"))
                .expect("read")
        };
        assert_eq!(imported[at("b.rs")], [at("a/one.rs")].into());
        assert_eq!(imported[at("a/one.rs")], [at("c.rs")].into());
        assert!(imported[at("c.rs")].is_empty() && circles(&imported).is_empty());
    }

    #[test]
    fn circles_are_found_through_modules_and_globs() {
        let files = crate_of(&[
            ("lib.rs", "pub mod a;"),
            ("a/mod.rs", "mod child; pub struct Parent; fn f() { child::work() }"),
            ("a/child.rs", "use super::*; pub fn work() { let _ = Parent; }"),
        ]);
        let found = circles(&imported_files(&files));
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].len(), 2);
    }

    #[test]
    fn types_and_functions_are_counted_as_they_stand() {
        let text = "pub struct A<'a>(&'a str); trait B { type Item; fn b(&self, x: (u8, u8)); }
            impl<T: Fn(u8, u8) -> u8> B for T { type Item = u8; fn b(&self, x: (u8, u8)) {} }
            fn two_words<const N: usize>(
                a: [u8; N], b: std::collections::BTreeMap<u8, u8>,
            ) -> impl Fn(u8) { move |_| { let _ = (a, &b); } }
            #[cfg(test)] mod tests { struct A; }";
        let files = crate_of(&[("lib.rs", text)]);
        let types = defined_types(&files);
        assert_eq!(types.keys().collect::<Vec<_>>(), ["A", "B"]);
        assert_eq!(types["A"].len(), 1);
        let functions = defined_functions(&files);
        let seen: Vec<_> = functions
            .iter()
            .map(|f| (f.name.as_str(), f.parameters, f.lines, f.named_by_trait))
            .collect();
        assert_eq!(
            seen,
            [("b", 2, 1, false), ("b", 2, 1, true), ("two_words", 2, 3, false)]
        );
    }
}

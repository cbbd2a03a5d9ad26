//! The floors of the house, held by a test: who may use whom, what lower floors may not know, how large a file may be.
//!
//! It reads `src/` as tokens, without comments and texts, so it needs no compiler and finds `crate::`, `super::` and
//! grouped `use` alike. Every failure says what to do about it.

use super::source::tokens::{Token, tokens};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The floor of every module of the library. A new module gets its line here, in `src/lib.rs` and in deploy/docs/architecture.md.
const FLOORS: [(&str, u8); 19] = [
    ("mesh", 0),
    ("asset", 0),
    ("pool", 0),
    ("progress", 0),
    ("exec", 0),
    ("stage_clock", 0),
    ("solver", 1),
    ("graph", 1),
    ("render", 1),
    ("deform", 2),
    ("edit", 2),
    ("motion", 2),
    ("engine", 3),
    ("wire", 3),
    ("batch", 4),
    ("session", 4),
    ("check", 4),
    ("server", 5),
    ("cli", 5),
];

/// Rooms of the house that are crates of their own: `src/<room>/src` holds their sources, `tests` and `examples` stand beside it.
/// The modules named after the crate keep a floor of their own, and the library re-exports them at its root.
const CRATES: [(&str, &[&str]); 2] = [
    ("solver", &["pool", "progress", "exec"]),
    (
        "core",
        &[
            "mesh", "asset", "graph", "render", "deform", "edit", "motion", "engine", "solver", "pool", "progress",
            "exec",
        ],
    ),
];

/// Names that floors 0 to 3 must not use outside tests, and what to do instead.
const FOREIGN: [(&str, &str); 22] = [
    ("tokio", "floors 0 to 3 are synchronous; await in session or above"),
    ("tonic", "transports are server's; take and return messages of wire::pb"),
    ("axum", "transports are server's; take and return messages of wire::pb"),
    ("hyper", "transports are server's; take and return messages of wire::pb"),
    ("tower", "transports are server's; take and return messages of wire::pb"),
    ("futures", "floors 0 to 3 are synchronous; await in session or above"),
    (
        "tracing",
        "logs are server's; report through Progress, or return what was noticed as a warning",
    ),
    (
        "Instant",
        "engines read no clock; let the caller pass one in, as batch::run does",
    ),
    (
        "SystemTime",
        "engines read no clock; let the caller pass one in, as batch::run does",
    ),
    (
        "std::net",
        "only asset's readers and writers do input and output, over Read and Write",
    ),
    (
        "std::fs",
        "only asset's readers and writers do input and output, over Read and Write; open files in cli",
    ),
    (
        "std::env",
        "settings are arguments; read the environment in server::config or cli",
    ),
    ("std::process", "return an error; cli decides about exit codes"),
    ("std::thread", "take a &Pool and run inside it"),
    (
        "getrandom",
        "the same inputs give the same bits; a random number belongs to session",
    ),
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
    (
        "thread_local",
        "no global state; keep scratch in a workspace that the caller owns",
    ),
];

/// Places outside `src/server/grpc/` that may name tonic's crates, each with its reason.
const TONIC_TOO: [(&str, &str); 0] = [];

/// Longest file, in lines.
const LONGEST: usize = 600;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A path that a file names, resolved to the crate's root where it starts with `crate`, `self` or `super`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Named {
    /// `["crate", "mesh"]`, `["std", "net"]`, `["tokio"]`.
    path: Vec<String>,
    line: usize,
    /// In a `#[cfg(test)]` item.
    test: bool,
}

/// Every path of a file in module `module` (`["mesh", "weld"]`), and the files that it declares for tests only.
fn paths(source: &str, module: &[String]) -> (Vec<Named>, Vec<String>) {
    let tokens = tokens(source);
    let word = |i: usize| match tokens.get(i) {
        Some((Token::Word(w), _)) => Some(w.as_str()),
        _ => None,
    };
    let sign = |i: usize, c: char| matches!(tokens.get(i), Some((Token::Sign(s), _)) if *s == c);
    let (mut named, mut test_files) = (Vec::new(), Vec::new());
    let mut here = module.to_vec();
    // Depth of braces, and for each open inline module the depth inside it.
    let (mut depth, mut modules, mut tests): (usize, Vec<usize>, Vec<usize>) = (0, Vec::new(), Vec::new());
    // `#[cfg(test)]` was seen and its item has not begun.
    let mut marked = false;
    let mut i = 0;
    while i < tokens.len() {
        let line = tokens[i].1;
        let cfg_test = ["cfg", "test"].iter().zip([2, 4]).all(|(w, k)| word(i + k) == Some(w));
        if sign(i, '#') && sign(i + 1, '[') && cfg_test && sign(i + 3, '(') && sign(i + 5, ')') {
            marked = true;
            i += 7;
            continue;
        }
        if word(i) == Some("mod") && word(i + 1).is_some() {
            if sign(i + 2, '{') {
                here.push(word(i + 1).unwrap_or_default().to_owned());
                modules.push(depth + 1);
                i += 2;
                continue;
            }
            if marked {
                test_files.push(word(i + 1).unwrap_or_default().to_owned());
            }
        }
        if sign(i, '{') {
            depth += 1;
            if std::mem::take(&mut marked) {
                tests.push(depth);
            }
        } else if sign(i, '}') {
            if modules.last() == Some(&depth) {
                modules.pop();
                here.pop();
            }
            if tests.last() == Some(&depth) {
                tests.pop();
            }
            depth = depth.saturating_sub(1);
        }
        let in_test = marked || !tests.is_empty();
        // A path begins at a word, unless what stands before makes it a later part of one, or a field or method. One word
        // alone is a path too.
        let after = |c: char| i >= 2 && sign(i - 1, c) && sign(i - 2, c);
        let continued = after(':') && i >= 3 && (word(i - 3).is_some_and(|w| w != "use") || sign(i - 3, '>'));
        let member = i >= 1 && sign(i - 1, '.') && !after('.');
        if word(i).is_some() && !continued && !member {
            let mut leaves = Vec::new();
            let end = tree(&tokens, i, &[], &mut leaves);
            named.extend(leaves.into_iter().map(|path| Named {
                path: resolve(path, &here),
                line,
                test: in_test,
            }));
            // Braces inside the tree of a `use` are balanced and no blocks.
            i = end.max(i + 1);
        } else {
            i += 1;
        }
        if marked && sign(i, ';') {
            marked = false;
        }
    }
    (named, test_files)
}

/// Reads the path, or tree of paths, that begins at `i`; returns where it ends.
fn tree(tokens: &[(Token, usize)], mut i: usize, before: &[String], leaves: &mut Vec<Vec<String>>) -> usize {
    let sign = |i: usize, c: char| matches!(tokens.get(i), Some((Token::Sign(s), _)) if *s == c);
    let mut path = before.to_vec();
    while let Some((Token::Word(word), _)) = tokens.get(i) {
        path.push(word.clone());
        i += 1;
        if !(sign(i, ':') && sign(i + 1, ':')) {
            break;
        }
        i += 2;
        if sign(i, '{') {
            i += 1;
            while i < tokens.len() && !sign(i, '}') {
                let next = tree(tokens, i, &path, leaves);
                i = if next == i { i + 1 } else { next };
            }
            return i + 1;
        }
    }
    if path.len() > before.len() {
        leaves.push(path);
    }
    // In a group, a new name follows the path.
    let renamed = !before.is_empty() && matches!(tokens.get(i), Some((Token::Word(w), _)) if w == "as");
    if renamed { i + 2 } else { i }
}

/// A path from the crate's root, when it starts with `self` or `super`.
fn resolve(path: Vec<String>, here: &[String]) -> Vec<String> {
    let ups = path.iter().take_while(|w| *w == "super").count();
    let first = path.first().map(String::as_str);
    if ups == 0 && first != Some("self") {
        return path;
    }
    let rest = path
        .iter()
        .skip_while(|w| matches!(w.as_str(), "self" | "super"))
        .cloned();
    let base = here[..here.len().saturating_sub(ups)].iter().cloned();
    std::iter::once("crate".to_owned()).chain(base).chain(rest).collect()
}

/// A file of `src/`.
struct File {
    /// From the root of the repository.
    place: String,
    /// `["mesh", "weld"]`; empty for `lib.rs`.
    module: Vec<String>,
    lines: usize,
    named: Vec<Named>,
    /// Compiled for tests only.
    test: bool,
}

fn sources() -> Vec<File> {
    let src = root().join("src");
    let mut files = Vec::new();
    walk(&src, &mut files);
    let mut read: Vec<(File, Vec<String>)> = files
        .into_iter()
        .map(|path| {
            let text = fs::read_to_string(&path).expect("sources are text");
            let inside = path.strip_prefix(&src).expect("below src");
            let mut module: Vec<String> = inside
                .with_extension("")
                .iter()
                .map(|s| s.to_string_lossy().into_owned())
                .collect();
            if matches!(module.last().map(String::as_str), Some("mod" | "lib")) {
                module.pop();
            }
            let own_crate = CRATES
                .iter()
                .find(|(room, _)| module.first().is_some_and(|m| m == room));
            let beside = own_crate.is_some() && module.get(1).is_none_or(|m| m != "src");
            if own_crate.is_some() {
                module.drain(..if beside { 1 } else { 2 });
            }
            let (mut named, test_files) = paths(&text, &module);
            if let Some((room, floors)) = own_crate {
                named
                    .iter_mut()
                    .for_each(|n| in_the_house(&mut n.path, 1, room, floors));
                in_the_house(&mut module, 0, room, floors);
            }
            let place = format!("src/{}", inside.display());
            (
                File {
                    place,
                    module,
                    lines: text.lines().count(),
                    named,
                    test: beside,
                },
                test_files,
            )
        })
        .collect();
    let test_modules: BTreeSet<Vec<String>> = read
        .iter()
        .flat_map(|(file, names)| {
            names
                .iter()
                .map(|n| file.module.iter().chain([n]).cloned().collect::<Vec<_>>())
        })
        .collect();
    for (file, _) in &mut read {
        file.test |= (1..=file.module.len()).any(|k| test_modules.contains(&file.module[..k]));
    }
    read.into_iter().map(|(file, _)| file).collect()
}

/// Turns a path from the root of a room's own crate into one from the root of the library.
fn in_the_house(path: &mut Vec<String>, root: usize, room: &str, floors: &[&str]) {
    let from_root = root == 0 || path[0] == "crate";
    if floor(room).is_some() && from_root && path.get(root).is_none_or(|m| !floors.contains(&m.as_str())) {
        path.insert(root, room.to_owned());
    }
}

fn walk(folder: &Path, files: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = fs::read_dir(folder)
        .expect("src can be listed")
        .map(|e| e.expect("an entry").path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            walk(&path, files);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
}

fn floor(module: &str) -> Option<u8> {
    FLOORS.iter().find(|(name, _)| *name == module).map(|(_, floor)| *floor)
}

/// The module of a file below the crate's root; `None` for `lib.rs`, the binaries and tests beside a crate of several modules,
/// which may name everything.
fn home(file: &File) -> Option<&str> {
    let first = file.module.first().map(String::as_str);
    first.filter(|m| !matches!(*m, "bin" | "tests" | "examples"))
}

fn report(problems: Vec<String>) {
    assert!(problems.is_empty(), "\n{}\n", problems.join("\n"));
}

/// Uses between modules: (from, to) and where the first one stands.
fn uses(files: &[File]) -> BTreeMap<(String, String), String> {
    let mut uses = BTreeMap::new();
    for file in files {
        let Some(from) = home(file) else { continue };
        for named in &file.named {
            let to = match named.path.as_slice() {
                [first, to, ..] if first == "crate" || first == "pliant" => to,
                _ => continue,
            };
            if to != from && floor(to).is_some() {
                let place = format!("{}:{}", file.place, named.line);
                uses.entry((from.to_owned(), to.clone())).or_insert(place);
            }
        }
    }
    uses
}

#[test]
fn every_module_has_a_floor() {
    let files = sources();
    let modules: BTreeSet<&str> = files.iter().filter_map(home).collect();
    let mut problems = Vec::new();
    for module in &modules {
        if floor(module).is_none() {
            problems.push(format!("src/{module} has no floor: add it to FLOORS in tests/tools/floors.rs, to the table in src/lib.rs and to deploy/docs/architecture.md"));
        }
    }
    for (module, _) in FLOORS {
        if !modules.contains(module) {
            problems.push(format!(
                "FLOORS in tests/tools/floors.rs names {module}, which src/ does not have: take the line out"
            ));
        }
    }
    report(problems);
}

#[test]
fn no_module_uses_a_floor_above_its_own() {
    let mut problems = Vec::new();
    for ((from, to), place) in uses(&sources()) {
        let (Some(low), Some(high)) = (floor(&from), floor(&to)) else {
            continue;
        };
        if low < high {
            problems.push(format!(
                "{place}: {from} (floor {low}) uses {to} (floor {high}), which is above it: move what both need down to floor {low} or below, or let {to} pass it in"
            ));
        }
    }
    report(problems);
}

#[test]
fn no_circle_on_a_floor() {
    let uses = uses(&sources());
    let mut problems = BTreeSet::new();
    for (start, _) in FLOORS {
        // Follows uses on one floor; coming back to the start is a circle.
        let mut open = vec![vec![start.to_owned()]];
        let mut seen = BTreeSet::new();
        while let Some(way) = open.pop() {
            let last = way.last().cloned().unwrap_or_default();
            for ((_, to), place) in uses
                .iter()
                .filter(|((from, to), _)| *from == last && floor(from) == floor(to))
            {
                if to == start {
                    let names = way.join(" → ");
                    problems.insert(format!(
                        "{place}: {names} → {to} is a circle: move what both need into a module of a lower floor"
                    ));
                } else if seen.insert(to.clone()) {
                    open.push(way.iter().cloned().chain([to.clone()]).collect());
                }
            }
        }
    }
    report(problems.into_iter().collect());
}

#[test]
fn engine_floors_know_no_clock_network_or_terminal() {
    let mut problems = Vec::new();
    for file in sources().iter().filter(|f| !f.test) {
        let Some(floor) = home(file).and_then(floor).filter(|&floor| floor <= 3) else {
            continue;
        };
        for named in file.named.iter().filter(|n| !n.test) {
            for (name, advice) in FOREIGN {
                let segments: Vec<&str> = name.split("::").collect();
                let found = match segments.as_slice() {
                    [one] => named.path.iter().any(|w| w == one),
                    many => named.path.windows(many.len()).any(|w| w == many),
                };
                if found {
                    problems.push(format!(
                        "{}:{}: floor {floor} names {name}: {advice}",
                        file.place, named.line
                    ));
                }
            }
        }
    }
    report(problems);
}

#[test]
fn tonic_stays_below_server_grpc() {
    let mut problems = Vec::new();
    for file in sources() {
        if file.place.starts_with("src/server/grpc/") || TONIC_TOO.iter().any(|(place, _)| *place == file.place) {
            continue;
        }
        for named in &file.named {
            if named
                .path
                .first()
                .is_some_and(|w| w == "tonic" || w.starts_with("tonic_"))
            {
                problems.push(format!(
                    "{}:{}: names {}: translate in src/server/grpc/, or list the file in TONIC_TOO with the reason",
                    file.place,
                    named.line,
                    named.path.join("::")
                ));
            }
        }
    }
    report(problems);
}

#[test]
fn sessions_know_no_message() {
    let mut problems = Vec::new();
    for file in sources().iter().filter(|f| f.place.starts_with("src/session/")) {
        for named in file
            .named
            .iter()
            .filter(|n| n.path.iter().any(|w| w == "pb" || w == "prost"))
        {
            problems.push(format!(
                "{}:{}: names {}: take a value that wire has read, and write messages in src/server",
                file.place,
                named.line,
                named.path.join("::")
            ));
        }
    }
    report(problems);
}

#[test]
fn no_file_is_too_long() {
    let long = sources().into_iter().filter(|f| f.lines > LONGEST);
    report(
        long.map(|f| {
            format!(
                "{}: {} lines, at most {LONGEST}: split it by concept, one file each",
                f.place, f.lines
            )
        })
        .collect(),
    );
}

/// The scanner itself: what it must see and what it must not.
#[test]
fn the_scanner_sees_every_way_to_name_a_module() {
    let source = r##"
        //! use crate::cli;
        use crate::{mesh::{Mesh, weld}, pool, progress::Progress as P};
        use super::super::graph::Graph;
        /* crate::server /* nested */ crate::server */
        fn f<'a>(x: &'a str) -> char { let _ = "crate::session"; let _ = r#"crate::"cli" "#; let q = '"'; crate::batch::run(x); q }
        mod inner { use super::neighbour; use super::super::super::solver; }
        #[cfg(test)]
        mod tests { use std::time::Instant; fn g() { println!("{}", 'x'); } }
        #[cfg(test)]
        mod beside;
        fn h() { let t = std::time::Instant::now(); self::here::go(t.elapsed()) }
    "##;
    let module = ["deform".to_owned(), "rig".to_owned()];
    let (named, beside) = paths(source, &module);
    let seen: BTreeSet<String> = named.iter().map(|n| n.path.join("::")).collect();
    let wanted = [
        "crate::mesh::Mesh",
        "crate::mesh::weld",
        "crate::pool",
        "crate::progress::Progress",
        "crate::graph::Graph",
        "crate::batch::run",
        "crate::deform::rig::neighbour",
        "crate::solver",
        "std::time::Instant::now",
        "crate::deform::rig::here::go",
    ];
    for path in wanted {
        assert!(seen.contains(path), "{path} was not seen among {seen:?}");
    }
    for hidden in ["cli", "server", "session"] {
        assert!(
            !seen.iter().any(|path| path.contains(hidden)),
            "{hidden} stands in a comment or a text only"
        );
    }
    let tests: Vec<&Named> = named.iter().filter(|n| n.test).collect();
    assert!(tests.iter().any(|n| n.path.last().is_some_and(|w| w == "println")));
    assert!(tests.iter().all(|n| !n.path.join("::").contains("Instant::now")));
    assert_eq!(beside, ["beside"]);
}

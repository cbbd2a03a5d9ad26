//! What people read is plain English: pages, the schema's comments, help, labels, error texts and comments do without
//! the words and phrases that readers had to read twice.

use super::modules::rust_files;
use std::fs;
use std::path::{Path, PathBuf};

/// What is avoided, and what says it plainly.
const AVOIDED: [(&str, &str); 30] = [
    ("told", "reported, listed, returned"),
    ("tell", "report, list, return"),
    ("tells", "reports, lists, returns"),
    ("telling", "reporting, listing"),
    ("whoever", "each user who, a client that"),
    ("bears", "contains, has"),
    ("heeds", "honours"),
    ("heeded", "honoured"),
    ("nobody", "no one, none, or who acts"),
    ("anew", "again, rebuilt"),
    ("is no", "is not a, there is no"),
    ("for want of", "without"),
    ("at rest", "in the rest pose"),
    ("to the bit", "bit for bit"),
    ("of equal bits", "bit-identical"),
    ("by itself", "automatically, alone"),
    ("for ever", "permanently"),
    ("hang up", "disconnect"),
    ("hangs up", "disconnects"),
    ("hanging up", "disconnecting"),
    ("goes on so", "continues as follows"),
    ("goes along", "is included"),
    ("such as have", "models that have"),
    ("crowded edges", "non-manifold edges"),
    ("stray", "unreferenced"),
    ("spoilt", "stale"),
    ("lone", "single"),
    ("thereby", "so"),
    ("whence", "from where"),
    ("hinders", "affects"),
];

/// The avoided words of a line, with what to write instead.
fn avoided_in(line: &str) -> impl Iterator<Item = &'static (&'static str, &'static str)> {
    let words = line
        .split(|c: char| !c.is_alphanumeric() && c != '_')
        .filter(|word| !word.is_empty());
    let plain = format!(" {} ", words.map(str::to_lowercase).collect::<Vec<_>>().join(" "));
    let plain = plain
        .replace(" there is no ", " ")
        .replace(" is no longer ", " ")
        .replace(" is no more ", " ");
    AVOIDED
        .iter()
        .filter(move |(avoided, _)| plain.contains(&format!(" {avoided} ")))
}

/// What a line of source shows to people: its doc comment, or the texts in quotes without the names in braces.
fn shown_by(line: &str, quotes: &[char]) -> String {
    let line = line.trim_start();
    if ["///", "//!", "/**", "* "].iter().any(|doc| line.starts_with(doc)) {
        return line.to_owned();
    }
    let (mut shown, mut open, mut depth) = (String::new(), None, 0u32);
    for c in line.split("//").next().unwrap_or_default().chars() {
        match (open, c) {
            (None, c) if quotes.contains(&c) => open = Some(c),
            (Some(quote), c) if c == quote => {
                open = None;
                shown.push_str(" | ");
            }
            (Some(_), '{') => depth += 1,
            (Some(_), '}') => depth = depth.saturating_sub(1),
            (Some(_), c) if depth == 0 => shown.push(c),
            _ => {}
        }
    }
    shown
}

/// The files below a folder that end so, without generated and foreign ones.
fn files_below(folder: &Path, ending: &str, found: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let foreign = ["target", "node_modules", "gen", "dist", "vendor", "tests", "examples"];
        if path.is_dir() && !foreign.contains(&name.as_str()) && !name.starts_with('.') {
            files_below(&path, ending, found);
        } else if name.ends_with(ending) && !name.contains("_pb") {
            found.push(path);
        }
    }
}

#[test]
fn what_people_read_is_plain_english() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut problems = Vec::new();
    for (ending, quotes) in [
        (".md", None),
        (".proto", None),
        (".rs", Some(&['"'][..])),
        (".ts", Some(&['"', '\'', '`'][..])),
        (".html", None),
        (".py", Some(&['"', '\''][..])),
    ] {
        let mut files = Vec::new();
        files_below(root, ending, &mut files);
        assert!(!files.is_empty(), "no file ends in {ending}");
        for path in files {
            let text = fs::read_to_string(&path).unwrap_or_default();
            for (number, line) in text.lines().enumerate() {
                let shown = quotes.map_or(line.to_owned(), |quotes| shown_by(line, quotes));
                for (avoided, instead) in avoided_in(&shown) {
                    let place = path.strip_prefix(root).unwrap_or(&path).display();
                    problems.push(format!("{place}:{}: \"{avoided}\": write {instead}", number + 1));
                }
            }
        }
    }
    assert!(
        problems.is_empty(),
        "{} places\n{}",
        problems.len(),
        problems.join("\n")
    );
}

#[test]
fn comments_of_the_source_are_plain_english_too() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let paths = ["src", "loadtest", "tests"].map(|folder| rust_files(root, &root.join(folder)));
    let mut problems = Vec::new();
    for path in paths.iter().flatten() {
        let text = fs::read_to_string(root.join(path)).unwrap_or_default();
        for (number, line) in text.lines().enumerate() {
            let comment = line.trim_start();
            for (avoided, instead) in avoided_in(comment).filter(|_| comment.starts_with("//")) {
                problems.push(format!(
                    "{}:{}: \"{avoided}\": write {instead}",
                    path.display(),
                    number + 1
                ));
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn avoided_words_are_found_where_they_are_shown_alone() {
    let avoided = |line: &str| avoided_in(&shown_by(line, &['"'])).count();
    assert_eq!(avoided("/// Nobody is told."), 2);
    assert_eq!(avoided("let told = told(\"{told} of {}\"); // told"), 0);
    assert_eq!(avoided("refuse(\"that is no number\")"), 1);
    assert_eq!(avoided("\"in the rest pose\""), 0);
}

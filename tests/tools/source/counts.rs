//! What `.ci/counts` prints: the shape of the source in numbers.

use super::functions::defined_functions;
use super::imports::{circles, imported_files, shortest_circle};
use super::modules::{SourceFile, crate_files, test_files};
use super::types::defined_types;
use std::fs;
use std::path::{Path, PathBuf};

/// The checkout that is counted: `PLIANT_COUNTS_OF`, or this one.
fn counted() -> PathBuf {
    std::env::var_os("PLIANT_COUNTS_OF").map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).to_owned(), PathBuf::from)
}

fn share(part: usize, whole: usize) -> String {
    format!("{part} of {whole} ({:.1} %)", 100.0 * part as f64 / whole.max(1) as f64)
}

fn print_types(what: &str, files: &[SourceFile]) {
    let types = defined_types(files);
    let definitions: usize = types.values().map(Vec::len).sum();
    let shared: Vec<_> = types.iter().filter(|(_, places)| places.len() > 1).collect();
    let standing: usize = shared.iter().map(|(_, places)| places.len()).sum();
    println!(
        "{what}: type names that stand twice or more: {}",
        share(shared.len(), types.len())
    );
    println!(
        "{what}: type definitions that share a name: {}",
        share(standing, definitions)
    );
    let names: Vec<String> = shared
        .iter()
        .map(|(name, places)| format!("{name} {}", places.len()))
        .collect();
    println!("  {}", names.join(", "));
}

fn print_functions(files: &[SourceFile]) {
    let functions = defined_functions(files);
    let own: Vec<_> = functions.iter().filter(|f| !f.named_by_trait).collect();
    let one_word = own.iter().filter(|f| !f.name.trim_matches('_').contains('_')).count();
    println!("one-word function names: {}", share(one_word, own.len()));
    let long: Vec<_> = functions.iter().filter(|f| f.lines > 100).collect();
    println!("functions past 100 lines: {}", long.len());
    for function in long {
        println!("  {} {}: {} lines", function.place, function.name, function.lines);
    }
    let wide: Vec<_> = functions.iter().filter(|f| f.parameters >= 7).collect();
    println!("functions with seven or more parameters: {}", wide.len());
    for function in wide {
        println!("  {} {}: {}", function.place, function.name, function.parameters);
    }
}

fn print_circles(files: &[SourceFile]) {
    let imported = imported_files(files);
    let tangles = circles(&imported);
    let tangled: usize = tangles.iter().map(Vec::len).sum();
    println!(
        "files in circles of imports: {} in {} circles",
        share(tangled, files.len()),
        tangles.len()
    );
    for tangle in &tangles {
        let way: Vec<&str> = shortest_circle(&imported, tangle[0])
            .iter()
            .map(|&k| files[k].place.as_str())
            .collect();
        println!("  {} files, such as {}", tangle.len(), way.join(" → "));
        for &file in tangle {
            for other in imported[file].iter().filter(|other| tangle.contains(other)) {
                println!("    {} → {}", files[file].place, files[*other].place);
            }
        }
    }
}

fn count_lines(files: &[SourceFile]) -> usize {
    files.iter().map(|file| file.lines).sum()
}

fn lines_of(root: &Path, name: &str) -> usize {
    fs::read_to_string(root.join(name)).map_or(0, |text| text.lines().count())
}

#[test]
fn counts() {
    let root = counted();
    let (files, tests) = (crate_files(&root), test_files(&root));
    print_types("crates", &files);
    print_types("tests", &tests);
    print_functions(&files);
    print_circles(&files);
    let long = files.iter().filter(|f| f.lines > 600).count();
    println!("files past 600 lines: {long}");
    println!(
        "lines: {} in {} files of crates, {} in {} files of tests and examples, {} of README.md",
        count_lines(&files),
        files.len(),
        count_lines(&tests),
        tests.len(),
        lines_of(&root, "README.md")
    );
    assert!(!files.is_empty(), "{} holds no source", root.display());
}

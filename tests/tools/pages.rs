//! Pages and images, read: the architecture page lists the crates that there are, and nothing here can build an image.

use crate::support::book::*;
use crate::support::process::{file_of_repository, root};
use std::collections::BTreeSet;

#[test]
fn every_crate_is_in_the_table() {
    let page = file_of_repository("deploy/docs/architecture.md");
    let listed: BTreeSet<String> = table(&page, "| crate | what |")
        .into_iter()
        .map(|mut row| row.remove(0))
        .collect();
    let folders = std::fs::read_dir(root().join("src")).expect("src can be listed");
    let crates = folders
        .flatten()
        .filter(|entry| entry.path().join("Cargo.toml").is_file());
    let mut found: BTreeSet<String> = crates
        .map(|c| format!("pliant-{}", c.file_name().to_string_lossy()))
        .collect();
    found.insert("pliant".into());
    assert_eq!(
        listed, found,
        "the table of deploy/docs/architecture.md lists the crates of src"
    );
}

#[test]
fn the_list_of_extensions_is_that_of_the_code() {
    let page = file_of_repository("deploy/docs/formats.md");
    let made = pliant::asset::gltf_extension_table();
    assert!(
        page.contains(&made),
        "deploy/docs/formats.md has another table than this:\n{made}"
    );
}

#[test]
fn blocks_tables_and_places_are_found() {
    let page = "a `src/x.rs` and [that](b/c.md#d)\n```sh needs=a,b\nrun | it\n```\n| h | i |\n|---|---|\n| `a\\|b` | c |\n\n```json\n{}\n```\n";
    let found = blocks(page);
    assert_eq!(
        (found[0].language.as_str(), found[0].word("needs")),
        ("sh", Some("a,b"))
    );
    assert_eq!((found[0].text.as_str(), found[0].line), ("run | it\n", 2));
    assert_eq!(found.len(), 2);
    assert_eq!(table(page, "| h |"), [["a|b", "c"]]);
    assert_eq!(
        places(page),
        (
            vec!["b/c.md".to_owned()],
            vec!["src/x.rs".to_owned(), "a\\|b".to_owned()]
        )
    );
}

#[test]
fn patterns_hold_what_is_between_them() {
    assert!(is_like("a 12 b", "a … b") && is_like("a", "a") && is_like("xyz", "…"));
    assert!(!is_like("a 12 c", "a … b") && !is_like("ab", "a") && !is_like("b a", "a…"));
}

/// What stands after an instruction of a Dockerfile, of each line that has it.
fn instructions<'a>(file: &'a str, name: &str) -> Vec<&'a str> {
    let lines = file.lines().filter_map(|line| line.strip_prefix(name));
    lines.filter_map(|rest| rest.strip_prefix(' ')).collect()
}

#[test]
fn an_image_is_built_by_the_compiler_that_its_first_line_names() {
    let file = file_of_repository("deploy/Dockerfile");
    let images = instructions(&file, "FROM");
    let rust: Vec<&str> = images.iter().filter_map(|image| image.strip_prefix("rust:")).collect();
    let [image] = rust[..] else { panic!("{images:?}") };
    let version = image.split('-').next().expect("a version");
    assert_eq!(version.split('.').count(), 3, "{version} is a whole version");
    // Above what rust-toolchain.toml says, which is copied with the rest.
    let named = format!("RUSTUP_TOOLCHAIN={version}");
    let at = |text: &str| file.find(text).unwrap_or_else(|| panic!("{text} is missing"));
    assert!(at(&named) < at("cargo build"));
    let manifest = file_of_repository("Cargo.toml");
    let least = manifest
        .lines()
        .find_map(|line| line.strip_prefix("rust-version = \""))
        .expect("the least");
    let numbers = |text: &str| -> Vec<u32> {
        text.trim_end_matches('"')
            .split('.')
            .map(|n| n.parse().expect("a number"))
            .collect()
    };
    assert!(numbers(version) >= numbers(least), "{version} is older than {least}");
}

#[test]
fn images_have_a_folder_for_sessions_that_their_user_may_write() {
    let page = file_of_repository("deploy/README.md");
    for words in [
        "-e PLIANT_DATA_DIR=/var/lib/pliant",
        "-v pliant-sessions:/var/lib/pliant",
        "user 10001",
    ] {
        assert!(page.contains(words), "{words}");
    }
    let built = file_of_repository("deploy/Dockerfile");
    assert!(built.contains(
        "useradd --system --uid 10001 pliant && install --directory --owner=pliant --group=pliant /var/lib/pliant"
    ));
    assert_eq!(instructions(&built, "USER"), ["pliant"]);
    let scratch = file_of_repository("deploy/Dockerfile.release");
    assert_eq!(instructions(&scratch, "USER"), ["10001:10001"]);
    assert!(instructions(&scratch, "COPY").contains(&"--chown=10001:10001 sessions /var/lib/pliant"));
    assert!(
        file_of_repository("deploy/release").contains("\"pliant-image/sessions\""),
        "the folder is in the archive"
    );
}

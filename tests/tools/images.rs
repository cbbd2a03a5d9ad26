//! The container images, read: nothing here can build one.

use std::fs;
use std::path::Path;

fn read(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).expect("a file")
}

/// What stands after an instruction of a Dockerfile, of each line that has it.
fn instructions<'a>(file: &'a str, name: &str) -> Vec<&'a str> {
    let lines = file.lines().filter_map(|line| line.strip_prefix(name));
    lines.filter_map(|rest| rest.strip_prefix(' ')).collect()
}

#[test]
fn an_image_is_built_by_the_compiler_that_its_first_line_names() {
    let file = read("deploy/Dockerfile");
    let images = instructions(&file, "FROM");
    let rust: Vec<&str> = images.iter().filter_map(|image| image.strip_prefix("rust:")).collect();
    let [image] = rust[..] else { panic!("{images:?}") };
    let version = image.split('-').next().expect("a version");
    assert_eq!(version.split('.').count(), 3, "{version} is a whole version");
    // Above what rust-toolchain.toml says, which is copied with the rest.
    let named = format!("RUSTUP_TOOLCHAIN={version}");
    let at = |text: &str| file.find(text).unwrap_or_else(|| panic!("{text} is missing"));
    assert!(at(&named) < at("cargo build"));
    let manifest = read("Cargo.toml");
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
    let page = read("deploy/README.md");
    for words in [
        "-e PLIANT_DATA_DIR=/var/lib/pliant",
        "-v pliant-sessions:/var/lib/pliant",
        "user 10001",
    ] {
        assert!(page.contains(words), "{words}");
    }
    let built = read("deploy/Dockerfile");
    assert!(built.contains(
        "useradd --system --uid 10001 pliant && install --directory --owner=pliant --group=pliant /var/lib/pliant"
    ));
    assert_eq!(instructions(&built, "USER"), ["pliant"]);
    let scratch = read("deploy/Dockerfile.release");
    assert_eq!(instructions(&scratch, "USER"), ["10001:10001"]);
    assert!(instructions(&scratch, "COPY").contains(&"--chown=10001:10001 sessions /var/lib/pliant"));
    assert!(
        read("deploy/release").contains("\"pliant-image/sessions\""),
        "the folder is in the archive"
    );
}

//! What the architecture page says of the source is so: it lists the modules that there are.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// The cells of the rows of the table whose head begins with `head`, without backticks.
fn table(readme: &str, head: &str) -> Vec<Vec<String>> {
    let row = |line: &str| {
        line.trim_matches('|')
            .split('|')
            .map(|c| c.trim().replace('`', ""))
            .collect::<Vec<_>>()
    };
    let found = readme.lines().skip_while(|line| !line.starts_with(head));
    found
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(row)
        .collect()
}

#[test]
fn every_module_is_in_the_table() {
    let page = read("deploy/docs/architecture.md");
    let rows = table(&page, "| floor | modules |");
    let listed: BTreeSet<String> = rows
        .iter()
        .filter(|row| row[0] != "crate")
        .flat_map(|row| row[1].split(", "))
        .map(|m| m.trim_end_matches('/').to_owned())
        .collect();
    let libraries = [read("src/lib.rs"), read("src/core/src/lib.rs")];
    let modules: BTreeSet<String> = libraries
        .iter()
        .flat_map(|library| library.lines())
        .filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';'))
        .map(str::to_owned)
        .collect();
    assert_eq!(
        listed, modules,
        "the table of floors in deploy/docs/architecture.md lists the modules of src/lib.rs and src/core/src/lib.rs, no more, no less"
    );
}

//! The table of `deploy/docs/troubleshooting.md`: every text in it is provoked here and compared, and none is left out.
//!
//! What differs from run to run is replaced, session ids by `ID` and the port by 7411, or stands as `…` in the table.

use crate::support::book;
mod program;
mod server;

use std::collections::BTreeSet;
use std::path::Path;

/// What is said, and where it came from, for a failure of this test.
pub struct Said {
    /// What provoked it.
    pub by: &'static str,
    /// The words.
    pub text: String,
}

/// The rows' texts.
fn listed() -> BTreeSet<String> {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/docs/troubleshooting.md");
    let page = std::fs::read_to_string(page).expect("the page");
    let heads: Vec<&str> = page.lines().filter(|line| line.starts_with("| it says |")).collect();
    assert!(!heads.is_empty());
    // One table a section; each begins with the same head.
    let mut rows = BTreeSet::new();
    for section in page.split("\n## ").filter(|section| section.contains(heads[0])) {
        for row in book::table(section, heads[0]) {
            assert_eq!(row.len(), 3, "{row:?}");
            assert!(!row[0].is_empty() && !row[1].is_empty(), "{row:?}");
            assert!(rows.insert(row[0].clone()), "twice: {row:?}");
        }
    }
    rows
}

#[tokio::test(flavor = "multi_thread")]
async fn every_row_is_what_is_said() {
    let mut said = program::provoke();
    said.extend(server::provoke().await);
    let listed = listed();
    // Quotes of code are not in a cell.
    let heard: Vec<(&str, String)> = said.iter().map(|s| (s.by, s.text.replace('`', ""))).collect();
    let missing: Vec<String> = heard
        .iter()
        .filter(|(_, text)| !listed.iter().any(|row| book::is_like(text, row)))
        .map(|(by, text)| format!("{by}: {text}"))
        .collect();
    assert!(
        missing.is_empty(),
        "said, and not in the table:\n{}",
        missing.join("\n")
    );
    let invented = listed
        .iter()
        .filter(|row| !heard.iter().any(|(_, text)| book::is_like(text, row)));
    let invented: Vec<&String> = invented.collect();
    assert!(invented.is_empty(), "in the table, and never said: {invented:#?}");
}

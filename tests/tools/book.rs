//! How pages are read: blocks, tables, places and patterns are found.

use crate::support::book::*;

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

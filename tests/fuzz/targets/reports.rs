//! Reports of `pliant check`, which come from other machines to be joined.

use pliant::check::report::{html_report, json_report, junit_report, merge_reports, read_report};

pub fn reports(bytes: &[u8]) {
    let Ok(report) = read_report("r.json", bytes) else {
        return;
    };
    let written = json_report(&report, true).expect("a document").to_string();
    let again = read_report("r.json", written.as_bytes()).expect("a document that was just written");
    assert_eq!(
        json_report(&again, true).expect("as before").to_string(),
        written,
        "a report changes when it is written again"
    );
    // Whatever it says, it is text in a page and in XML.
    assert!(!html_report(&report).contains("<script"));
    let xml = junit_report(&report).expect("texts in memory");
    assert!(
        String::from_utf8(xml)
            .expect("UTF-8")
            .trim_end()
            .ends_with("</testsuites>")
    );
    let joined = merge_reports(vec![("a".into(), report.clone()), ("b".into(), report)]);
    assert!(joined.is_err(), "one shard, twice");
}

//! Reports of a suite: lines for people, JSON, JUnit XML, and a page with pictures.
//!
//! Reports depend only on the cases' results. They contain no thread count, and times only on request, so equal results
//! give equal reports. The JSON document holds everything; shards are joined from it.

mod html;
mod json;
mod junit;
mod merge;
#[cfg(test)]
mod samples;
mod suite_report;

pub use html::html_report;
pub use json::{json_report, read_report};
pub use junit::junit_report;
pub use merge::merge_reports;
pub use suite_report::{CaseReport, ShardFacts, SuiteReport};
pub use suite_report::{case_line, describe_changes, note_line, summary_line};

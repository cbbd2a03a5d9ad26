//! What is told of a suite: lines for people, JSON, JUnit XML, and a page with pictures.
//!
//! All of it is a pure function of the cases' results: no thread count is in it, and no time unless it is asked for, so two runs that
//! find the same say the same. The JSON document holds everything: the reports of shards are read and joined from it.

mod html;
mod json;
mod junit;
mod merge;
mod page;
#[cfg(test)]
mod samples;
mod suite_report;
mod text;

pub use html::html_report;
pub use json::{json_report, read_report};
pub use junit::junit_report;
pub use merge::merge_reports;
pub use suite_report::{CaseReport, ShardFacts, SuiteReport};
pub use text::{case_line, describe_changes, note_line, summary_line};

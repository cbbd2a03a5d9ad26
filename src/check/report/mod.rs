//! What is told of a suite: lines for people, JSON, JUnit XML, and a page with pictures.
//!
//! All of it is a pure function of the cases' results: no time and no thread count is in it, so two runs that find the
//! same say the same.

mod html;
mod json;
mod junit;
mod page;
#[cfg(test)]
mod samples;
mod suite_report;
mod text;

pub use html::html_report;
pub use json::json_report;
pub use junit::junit_report;
pub use suite_report::{CaseReport, SuiteReport};
pub use text::{case_line, describe_changes, summary_line};

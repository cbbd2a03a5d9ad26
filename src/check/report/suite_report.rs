//! What was found of a suite, case by case.

use super::super::case_pictures::CasePicture;
use super::super::golden::InputHashes;
use super::super::verdict::{CaseStatus, CaseVerdict};

/// A case report tells of a case that was run, or could not be.
#[derive(Debug, Clone)]
pub struct CaseReport {
    /// Its name.
    pub name: String,
    /// What it shows; maybe empty.
    pub title: String,
    /// Its model, as the case names it.
    pub model: String,
    /// What its result depends on; `None` when it was not read.
    pub inputs: Option<InputHashes>,
    /// Digest of its positions; empty when it was not run.
    pub digest: String,
    /// Digest in its golden; empty without one.
    pub stored_digest: String,
    /// How it ended.
    pub verdict: CaseVerdict,
    /// Pictures, for the page.
    pub pictures: Vec<CasePicture>,
    /// What someone should know beside, such as why there is no picture.
    pub notes: Vec<String>,
}

/// A suite report tells of a suite that was run.
#[derive(Debug, Clone)]
pub struct SuiteReport {
    /// The name of its folder.
    pub suite: String,
    /// How its cases were run: `in process` or `on` a server.
    pub how: String,
    /// In the order of their names.
    pub cases: Vec<CaseReport>,
}

impl SuiteReport {
    /// Counts the cases that ended so.
    pub fn count_cases(&self, status: CaseStatus) -> usize {
        self.cases.iter().filter(|c| c.verdict.status == status).count()
    }
}

impl CaseStatus {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
            Self::Blessed => "blessed",
        }
    }
}

/// Rewrites a text without the characters that no XML document may hold, each replaced by U+FFFD.
pub(super) fn printable(text: &str) -> String {
    let allowed = |c: char| {
        matches!(c, '\t' | '\n' | '\r') || (c >= ' ' && !matches!(c, '\u{7f}'..='\u{9f}' | '\u{fffe}' | '\u{ffff}'))
    };
    text.chars().map(|c| if allowed(c) { c } else { '\u{fffd}' }).collect()
}

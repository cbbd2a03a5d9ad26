//! What was found of a suite, case by case.

use super::super::case::CASE_SUFFIX;
use super::super::case_pictures::CasePicture;
use super::super::golden::InputHashes;
use super::super::shard::Shard;
use super::super::verdict::{CaseStatus, CaseVerdict};

/// A case report is the outcome of a case, run or not.
#[derive(Debug, Clone, PartialEq)]
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
    /// How long it took, run beside others; `None` unless requested.
    pub milliseconds: Option<f64>,
}

/// A suite report is the outcome of a suite or of a shard of it.
#[derive(Debug, Clone, PartialEq)]
pub struct SuiteReport {
    /// The name of its folder.
    pub suite: String,
    /// How its cases were run: `in process` or `on` a server.
    pub how: String,
    /// What someone should know of the suite's folder.
    pub notes: Vec<String>,
    /// Of a shard, what it is a part of.
    pub shard: Option<ShardFacts>,
    /// In the order of their names.
    pub cases: Vec<CaseReport>,
}

/// Shard facts say what a shard is a part of, so that nothing is joined that does not belong together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShardFacts {
    /// Which one of how many.
    pub shard: Shard,
    /// How many cases the whole suite has.
    pub cases: usize,
    /// Digest of the suite: of its cases, jobs and goldens.
    pub suite: String,
    /// Digest of the split: of which case is in which shard.
    pub split: String,
    /// The build that ran it.
    pub build: String,
}

impl SuiteReport {
    /// Puts cases into the order in which a suite is run, which is that of the names of their files.
    pub(super) fn sort_cases(&mut self) {
        self.cases.sort_by_cached_key(|c| format!("{}{CASE_SUFFIX}", c.name));
    }

    /// Counts the cases that ended so.
    pub fn count_cases(&self, status: CaseStatus) -> usize {
        self.cases.iter().filter(|c| c.verdict.status == status).count()
    }
}

impl CaseStatus {
    /// Finds the status of a name.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        let all = [Self::Passed, Self::Failed, Self::Skipped, Self::Blessed];
        all.into_iter().find(|status| status.name() == name)
    }

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
        // Marks of direction would show a text as another one.
        let turns = matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
        matches!(c, '\t' | '\n' | '\r')
            || (c >= ' ' && !turns && !matches!(c, '\u{7f}'..='\u{9f}' | '\u{fffe}' | '\u{ffff}'))
    };
    text.chars().map(|c| if allowed(c) { c } else { '\u{fffd}' }).collect()
}

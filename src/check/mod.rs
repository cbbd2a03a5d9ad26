//! Regression checks: a case's result beside its golden, judged and shown.
//!
//! Owns the case file, the golden file, what is measured, when a result passes, and the reports. It opens no file and no
//! connection: who runs the cases, and where, is the command line's.

mod case;
mod distance;
mod document;
mod found;
mod golden;
mod measure;
mod metric;
mod packed;
pub mod pictures;
pub mod report;
mod tolerances;
mod verdict;

pub use case::{CASE_SUFFIX, Case, GOLDEN_SUFFIX, JobSource, Source, SuiteError, job_hash, model_hash};
pub use distance::hausdorff;
pub use found::{Found, Topology};
pub use golden::{Golden, Inputs};
pub use measure::{Comparison, compare};
pub use metric::{Kind, Metric, Unit};
pub use packed::Places;
pub use tolerances::{Tolerance, Tolerances};
pub use verdict::{Measure, Reason, Status, Verdict, judge};

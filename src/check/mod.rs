//! Regression checks: a case's result beside its golden, judged and shown.
//!
//! The module owns the case file, the golden file, what is measured, when a result passes, and the reports. It opens no
//! file and no connection: who runs the cases, and where, is the command line's.
//!
//! ```
//! use pliant::check::{CaseResult, CaseStatus, Golden, InputHashes, Tolerances, judge_result};
//! use pliant::pool::Pool;
//! use glam::DVec3;
//!
//! let pool = Pool::new(1)?;
//! let shape = (vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]);
//! let result = CaseResult {
//!     positions: shape.0.clone(),
//!     triangles: shape.1.clone(),
//!     digest: "xxh3:1".into(),
//!     before: shape,
//!     ..CaseResult::default()
//! };
//! let hashes = InputHashes { model: "of the model".into(), job: "of the job".into() };
//! let golden = Golden::from_result(&result, hashes.clone());
//! let (verdict, _) = judge_result(&result, Some(Ok(golden)), &hashes, &Tolerances::default(), None, &pool);
//! assert!(verdict.status == CaseStatus::Passed && verdict.identical);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod case;
mod case_pictures;
mod case_result;
mod comparison;
mod golden;
mod metric;
mod named;
mod number;
pub mod report;
mod shard;
mod verdict;

pub use case::{
    AnimationCase, CASE_SUFFIX, GOLDEN_SUFFIX, JobSource, ModelSource, SuiteCase, SuiteError, job_hash, model_hash,
};
pub use case_pictures::{CasePicture, PictureCaption, Viewpoint, draw_case_pictures};
pub use case_result::{CaseResult, TopologyDigests};
pub use comparison::{GoldenComparison, compare_with_golden, hausdorff_distance};
pub use golden::{Golden, InputHashes, QuantizedPositions};
pub use metric::{Metric, MetricKind, MetricUnit, Tolerance, Tolerances};
pub use named::Named;
pub use shard::{CaseWork, Shard, digest_texts, measured_costs, split_cases, split_digest};
pub use verdict::{CaseStatus, CaseVerdict, MetricDifference, ReasonCode, VerdictReason, judge_result};

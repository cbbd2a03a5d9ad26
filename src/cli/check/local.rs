//! A case in process.

use crate::asset::FileSet;
use crate::batch;
use crate::check::{CaseResult, Metric};
use crate::engine::DeformerLimits;
use crate::exec::Exec;
use crate::pool::Pool;
use crate::progress::Silent;
use crate::wire::pb;

/// Runs a job on a model. The shape before is the caller's to add.
///
/// # Errors
/// Why it cannot be run.
pub(super) fn run_in_process(files: FileSet, job: &pb::Job, pool: &Pool) -> Result<CaseResult, String> {
    let no_clock = || 0.0;
    let done = batch::run(
        files,
        job,
        None,
        &DeformerLimits::default(),
        &Exec::new(pool, &Silent),
        &no_clock,
    )
    .map_err(|e| e.to_string())?;
    let poses: Vec<&pb::report::Step> = done.report.steps.iter().filter(|s| s.kind == "pose").collect();
    let mut found = CaseResult {
        positions: done.positions.to_vec(),
        triangles: done.triangles,
        digest: done.report.digest,
        unmet: done.unmet,
        ..Default::default()
    };
    found.take_quality(&done.report.quality.unwrap_or_default());
    let bytes = done.report.solver.unwrap_or_default().bytes;
    found.numbers.extend([
        (Metric::ConstraintError, done.constraint_error),
        (Metric::Residual, poses.iter().map(|s| s.residual).fold(0.0, f64::max)),
        (Metric::Cycles, poses.iter().map(|s| f64::from(s.cycles)).sum()),
        (Metric::Bytes, bytes as f64),
    ]);
    Ok(found)
}

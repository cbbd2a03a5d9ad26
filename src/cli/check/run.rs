//! All cases of a suite, several at a time, with a report that does not depend on how many.

use super::remote;
use super::remote::{HttpClient, ServerAddress};
use super::suite::LoadedCase;
use crate::asset::{self, FileSet, Format, Model};
use crate::batch;
use crate::check::report::{CaseReport, describe_changes};
use crate::check::{
    AnimationCase, CaseResult, CaseStatus, CaseVerdict, Golden, InputHashes, Metric, ReasonCode, Viewpoint,
    draw_case_pictures, judge_result, model_hash,
};
use crate::cli::terminal::{CliFailure, StageSpinner};
use crate::engine::{Animation, Deformer, DeformerLimits, digest};
use crate::exec::Exec;
use crate::pool::Pool;
use crate::progress::{Progress as _, Silent};
use crate::session::SessionConfig;
use crate::wire::{self, RootMotion, animate_order, pb, quality_message};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// A check plan says what is to be done with every case.
pub(super) struct CheckPlan<'a> {
    /// Where, if not in process.
    pub server: Option<&'a ServerAddress>,
    /// Make goldens instead of comparing.
    pub bless: bool,
    /// A case that cannot be run here fails.
    pub skip_fails: bool,
    /// Draw pictures.
    pub pictures: bool,
    /// Time each case.
    pub times: bool,
}

/// A checked case is a case that was run, or could not be.
pub(super) struct CheckedCase {
    /// Its report.
    pub report: CaseReport,
    /// The golden's new text, where it is to be written.
    pub golden: Option<String>,
    /// What that changes, line by line.
    pub changes: Vec<String>,
}

/// Runs all cases on `threads` threads together. Cases run side by side, each with its share of the threads; results
/// depend on neither.
pub(super) fn run_all_cases(
    cases: &[LoadedCase],
    plan: &CheckPlan<'_>,
    threads: usize,
    spinner: &StageSpinner,
) -> Result<Vec<CheckedCase>, CliFailure> {
    let workers = threads.min(cases.len()).max(1);
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<(usize, CheckedCase)>> = Mutex::default();
    let work = || -> Result<(), CliFailure> {
        let pool = Pool::new((threads / workers).max(1)).map_err(|e| CliFailure::Internal(e.to_string()))?;
        let client = plan
            .server
            .map(HttpClient::new)
            .transpose()
            .map_err(CliFailure::Internal)?;
        loop {
            let k = next.fetch_add(1, Ordering::Relaxed);
            let Some(case) = cases.get(k) else { return Ok(()) };
            spinner.report("checking", k as f32 / cases.len() as f32);
            let clock = Instant::now();
            let mut one = run_case(case, plan, client.as_ref(), &pool);
            if plan.times && one.report.status != CaseStatus::Skipped {
                one.report.milliseconds = Some(clock.elapsed().as_micros() as f64 / 1000.0);
            }
            done.lock().unwrap_or_else(|e| e.into_inner()).push((k, one));
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let mut ended = workers.into_iter().map(|w| w.join());
        let broken = |_| Err(CliFailure::Internal("a case ended in a defect of the program".into()));
        ended.try_for_each(|e| e.unwrap_or_else(broken))
    })?;
    let mut done = done.into_inner().unwrap_or_else(|e| e.into_inner());
    done.sort_by_key(|(k, _)| *k);
    Ok(done.into_iter().map(|(_, d)| d).collect())
}

fn run_case(loaded: &LoadedCase, plan: &CheckPlan<'_>, client: Option<&HttpClient>, pool: &Pool) -> CheckedCase {
    let case = &loaded.case;
    let stored = loaded.golden.as_ref().and_then(|golden| golden.as_ref().ok());
    let mut done = CheckedCase {
        report: CaseReport {
            name: case.name.clone(),
            title: case.title.clone(),
            model: case.model.to_string(),
            stored_digest: stored.map_or_else(String::new, |golden| golden.digest.clone()),
            ..CaseReport::default()
        },
        golden: None,
        changes: Vec::new(),
    };
    if let Some(why) = loaded.absent_reason() {
        let status = match plan.skip_fails {
            true => CaseStatus::Failed,
            false => CaseStatus::Skipped,
        };
        (done.report).take_verdict(CaseVerdict::without_result(status, ReasonCode::Skipped, why));
        return done;
    }
    let ran = loaded.model_files().and_then(|files| {
        let inputs = InputHashes {
            model: model_hash(&files),
            job: loaded.job_hash(),
        };
        done.report.inputs = Some(inputs.clone());
        Ok((run_model(loaded, files, client, pool)?, inputs))
    });
    let (found, inputs) = match ran {
        Ok(ran) => ran,
        Err(text) => {
            let verdict = CaseVerdict::without_result(CaseStatus::Failed, ReasonCode::NotRun, text);
            done.report.take_verdict(verdict);
            return done;
        }
    };
    done.report.digest = found.digest.clone();
    let expect = loaded.job.expect.as_ref();
    let (verdict, comparison) = judge_result(&found, loaded.golden.clone(), &inputs, &case.tolerances, expect, pool);
    done.report.take_verdict(verdict);
    if plan.bless {
        bless_case(&mut done, loaded, &found, inputs);
    }
    if plan.pictures {
        let eye = Viewpoint {
            view: case.view,
            up: case.up,
        };
        match draw_case_pictures(&found, comparison.as_ref(), eye, pool) {
            Ok(pictures) => done.report.pictures = pictures,
            Err(e) => done.report.notes.push(format!("there are no pictures: {e}")),
        }
    }
    done
}

/// Runs a case's job on its model; the result holds the shape before too.
fn run_model(
    loaded: &LoadedCase,
    files: FileSet,
    client: Option<&HttpClient>,
    pool: &Pool,
) -> Result<CaseResult, String> {
    let create = loaded.animation.as_ref().map(|a| &a.create);
    let create = create.or(loaded.job.create.as_ref());
    let format = create.and_then(|c| Format::from_name(&c.format));
    let read = Model::read(files.clone(), format, &asset::Limits::default());
    let before = read.map_err(|e| e.to_string())?.geometry;
    let mut found = match (client, &loaded.animation) {
        (Some(client), animation) => remote::run_on_server(client, &files, &loaded.job, animation.as_ref())?,
        (None, None) => run_in_process(files, &loaded.job, pool).map_err(|e| e.to_string())?,
        (None, Some(animation)) => animate_in_process(files, animation, pool).map_err(|e| e.to_string())?,
    };
    if found.triangles.is_empty() && found.positions.len() == before.positions.len() {
        found.triangles = before.triangles.clone();
    }
    found.before = (before.positions, before.triangles);
    Ok(found)
}

/// Makes the golden of a result and says what it changes. Nothing is asserted; only what no golden can hold is a failure.
fn bless_case(done: &mut CheckedCase, loaded: &LoadedCase, found: &CaseResult, inputs: InputHashes) {
    if let Some(text) = found.describe_not_finite() {
        let text = format!("{text}; no golden can hold that, and none was written");
        let verdict = CaseVerdict::without_result(CaseStatus::Failed, ReasonCode::NotFinite, text);
        return done.report.take_verdict(verdict);
    }
    let golden = Golden::from_result(found, inputs);
    let old = loaded.golden.as_ref().and_then(|old| old.as_ref().ok());
    if let Some(Err(broken)) = &loaded.golden {
        done.changes.push(format!("the old golden could not be read: {broken}"));
    }
    done.changes
        .extend(describe_changes(old, &golden, &done.report.measures));
    let unmet = found.unmet.iter();
    (done.report.notes).extend(unmet.map(|text| format!("the job expects otherwise: {text}")));
    match golden.to_text() {
        Ok(text) => {
            let same = old == Some(&golden);
            done.golden = (!same).then_some(text);
            done.report.status = CaseStatus::Blessed;
            done.report.reasons.clear();
            done.report.identical = same;
        }
        Err(text) => {
            let verdict = CaseVerdict::without_result(CaseStatus::Failed, ReasonCode::NotRun, text);
            done.report.take_verdict(verdict);
        }
    }
}

/// Runs a job on a model. The shape before is the caller's to add.
fn run_in_process(files: FileSet, job: &pb::Job, pool: &Pool) -> Result<CaseResult, wire::Error> {
    let (limits, exec) = (DeformerLimits::default(), Exec::new(pool, &Silent));
    let done = batch::run(files, job, None, &limits, &exec, &|| 0.0)?;
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

/// Runs an animation of a model. The shape before is the caller's to add.
fn animate_in_process(files: FileSet, animation: &AnimationCase, pool: &Pool) -> Result<CaseResult, wire::Error> {
    let exec = Exec::new(pool, &Silent);
    let limits = DeformerLimits::default();
    let usual = SessionConfig::default();
    let order = animate_order(&animation.options, usual.window, usual.clip_bytes)?;
    let model = Model::read(files, Format::from_name(&animation.create.format), &limits.model)?;
    let deformer = Deformer::of_model(model, &wire::open_options(&animation.create)?, &limits, &exec)?;
    let prepared = Animation::prepare(&deformer, &order.request, &usual.animation_limits(), &exec);
    let animation = prepared.map_err(wire::of_rig)?;
    let mut cursor = animation.cursor(animation.range().clone());
    let mut found = CaseResult::default();
    while cursor.next_index().is_some() {
        let Some(mut frame) = animation.solve_next(&mut cursor, &exec)? else {
            continue;
        };
        found.digest = digest(&frame.positions);
        found.frames.push(found.digest.clone());
        found.take_quality(&quality_message(&animation.quality(&frame.positions, pool)));
        if order.root == RootMotion::Baked {
            frame.bake_root();
        }
        found.positions = frame.positions;
    }
    Ok(found)
}

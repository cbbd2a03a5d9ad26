//! All cases of a suite, several at a time, with a report that does not depend on how many.

use super::http::{Address, Client};
use super::suite::Loaded;
use super::{local, remote};
use crate::asset::{self, FileSet, Model};
use crate::check::pictures::{Eye, draw_case};
use crate::check::report::{CaseReport, changes};
use crate::check::{Found, Golden, Inputs, Status, Verdict, job_hash, judge, model_hash};
use crate::cli::Failure;
use crate::cli::progress::Bar;
use crate::pool::Pool;
use crate::progress::Progress as _;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What is to be done with every case.
pub(super) struct Plan<'a> {
    /// Where, if not in process.
    pub server: Option<&'a Address>,
    /// Make goldens instead of comparing.
    pub bless: bool,
    /// A case that cannot be run here fails.
    pub skip_fails: bool,
    /// Draw pictures.
    pub pictures: bool,
}

/// A case done.
pub(super) struct Done {
    /// What is told of it.
    pub report: CaseReport,
    /// The golden's new text, where it is to be written.
    pub golden: Option<String>,
    /// What that changes, line by line.
    pub changes: Vec<String>,
}

/// Runs all cases on `threads` threads together. Cases run side by side, each with its share of the threads; results
/// depend on neither.
pub(super) fn run_all(cases: &[Loaded], plan: &Plan<'_>, threads: usize, bar: &Bar) -> Result<Vec<Done>, Failure> {
    let workers = threads.min(cases.len()).max(1);
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<(usize, Done)>> = Mutex::default();
    let work = || -> Result<(), Failure> {
        let pool = Pool::new((threads / workers).max(1)).map_err(|e| Failure::Internal(e.to_string()))?;
        let client = plan.server.map(Client::new).transpose().map_err(Failure::Internal)?;
        loop {
            let k = next.fetch_add(1, Ordering::Relaxed);
            let Some(case) = cases.get(k) else { return Ok(()) };
            bar.report("checking", k as f32 / cases.len() as f32);
            let one = run_case(case, plan, client.as_ref(), &pool);
            done.lock().unwrap_or_else(|e| e.into_inner()).push((k, one));
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let mut ended = workers.into_iter().map(|w| w.join());
        let broken = |_| Err(Failure::Internal("a case ended in a defect of the program".into()));
        ended.try_for_each(|e| e.unwrap_or_else(broken))
    })?;
    let mut done = done.into_inner().unwrap_or_else(|e| e.into_inner());
    done.sort_by_key(|(k, _)| *k);
    Ok(done.into_iter().map(|(_, d)| d).collect())
}

fn run_case(loaded: &Loaded, plan: &Plan<'_>, client: Option<&Client>, pool: &Pool) -> Done {
    let case = &loaded.case;
    let mut done = Done {
        report: CaseReport {
            name: case.name.clone(),
            title: case.title.clone(),
            model: case.model.to_string(),
            inputs: None,
            digest: String::new(),
            stored_digest: match &loaded.golden {
                Some(Ok(golden)) => golden.digest.clone(),
                _ => String::new(),
            },
            verdict: Verdict::without_result(Status::Failed, "not-run", ""),
            plates: Vec::new(),
            notes: Vec::new(),
        },
        golden: None,
        changes: Vec::new(),
    };
    if let Some(why) = loaded.absent() {
        let status = if plan.skip_fails {
            Status::Failed
        } else {
            Status::Skipped
        };
        done.report.verdict = Verdict::without_result(status, "skipped", why);
        return done;
    }
    let ran = loaded.files().and_then(|files| {
        let inputs = Inputs {
            model: model_hash(&files),
            job: job_hash(&loaded.job),
        };
        done.report.inputs = Some(inputs.clone());
        Ok((result(loaded, files, client, pool)?, inputs))
    });
    let (found, inputs) = match ran {
        Ok(ran) => ran,
        Err(text) => {
            done.report.verdict = Verdict::without_result(Status::Failed, "not-run", text);
            return done;
        }
    };
    done.report.digest = found.digest.clone();
    let expect = loaded.job.expect.as_ref();
    let (verdict, comparison) = judge(&found, loaded.golden.clone(), &inputs, &case.tolerances, expect, pool);
    done.report.verdict = verdict;
    if plan.bless {
        bless(&mut done, loaded, &found, inputs, pool);
    }
    if plan.pictures {
        let eye = Eye {
            view: case.view,
            up: case.up,
        };
        match draw_case(&found, comparison.as_ref(), eye, pool) {
            Ok(plates) => done.report.plates = plates,
            Err(e) => done.report.notes.push(format!("there are no pictures: {e}")),
        }
    }
    done
}

/// What a case comes to, with the shape before.
fn result(loaded: &Loaded, files: FileSet, client: Option<&Client>, pool: &Pool) -> Result<Found, String> {
    let format = loaded
        .job
        .create
        .as_ref()
        .map(|c| c.format.as_str())
        .unwrap_or_default();
    let read = Model::read(
        files.clone(),
        asset::Format::from_name(format),
        &asset::Limits::default(),
    );
    let before = read.map_err(|e| e.to_string())?.geometry;
    let mut found = match client {
        Some(client) => remote::run(client, &files, &loaded.job)?,
        None => local::run(files, &loaded.job, pool)?,
    };
    if found.triangles.is_empty() && found.positions.len() == before.positions.len() {
        found.triangles = before.triangles.clone();
    }
    found.before = (before.positions, before.triangles);
    Ok(found)
}

/// Makes the golden of a result and says what it changes. Nothing is asserted; only what no golden can hold is a failure.
fn bless(done: &mut Done, loaded: &Loaded, found: &Found, inputs: Inputs, pool: &Pool) {
    let verdict = &mut done.report.verdict;
    if let Some(text) = found.not_finite() {
        let text = format!("{text}; no golden can hold that, and none was written");
        *verdict = Verdict::without_result(Status::Failed, "not-finite", text);
        return;
    }
    let golden = Golden::of(found, inputs);
    let old = match &loaded.golden {
        Some(Ok(old)) => Some(old),
        _ => None,
    };
    if let Some(Err(broken)) = &loaded.golden {
        done.changes.push(format!("the old golden could not be read: {broken}"));
    }
    // A stale golden was not compared with; what its shape says of the change is told all the same.
    if let Some(old) = old.filter(|_| verdict.measures.is_empty()) {
        let (compared, _) = judge(
            found,
            Some(Ok(old.clone())),
            &old.inputs,
            &loaded.case.tolerances,
            None,
            pool,
        );
        verdict.measures = compared.measures;
    }
    done.changes.extend(changes(old, &golden, &verdict.measures));
    done.report.notes.extend(
        found
            .unmet
            .iter()
            .map(|text| format!("the job expects otherwise: {text}")),
    );
    match golden.text() {
        Ok(text) => {
            let same = old == Some(&golden);
            done.golden = (!same).then_some(text);
            verdict.status = Status::Blessed;
            verdict.reasons.clear();
            verdict.identical = same;
        }
        Err(text) => *verdict = Verdict::without_result(Status::Failed, "not-run", text),
    }
}

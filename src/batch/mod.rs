//! Runs a declarative job in process: opens a model, sets handles, solves and edits step by step, writes the result.

mod inspect;
mod riders;

use super::asset::{FileSet, Format, WrittenFiles};
use super::engine::{
    Deformer, DeformerLimits, EditCommand, EditedShape, HandlePose, HandlePoses, ModelShape, SolveMode, digest,
};
use super::exec::Exec;
use super::progress::Progress as _;
use super::wire::{
    DeformOptions, Error, add_found_turns, change_poses, edit, edit_name, edit_result, followed_message,
    found_turns_message, handle_set, open_options, pb, quality_message, session_message, warning_message,
    written_warnings,
};
use crate::exec::stage_clock::StageClock;
use crate::wire::pb::edit_request::Operation;
use crate::wire::pb::step::Step;
use glam::DVec3;
pub use inspect::{ClipContents, MOST_NODES_LISTED, ModelContents, SkinContents, contents_of, inspect};
pub use riders::CarriedFile;
use riders::Riders;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A job done.
#[derive(Debug, Clone)]
pub struct BatchOutcome {
    /// What happened, step by step.
    pub report: pb::Report,
    /// Final positions, one per render vertex.
    pub positions: Arc<Vec<DVec3>>,
    /// Triangles over them.
    pub triangles: Vec<[u32; 3]>,
    /// Largest distance of a vertex that a hard handle holds from where the handle puts it, as a fraction of the bounding
    /// box's diagonal.
    pub constraint_error: f64,
    /// The model in its final shape, in the format asked for.
    pub written: WrittenFiles,
    /// Other models, carried along.
    pub carried: Vec<CarriedFile>,
    /// Expectations of the job that do not hold, one sentence each.
    pub unmet: Vec<String>,
    /// Expectations that only a comparison with a stored result can check.
    pub unchecked: Vec<&'static str>,
}

/// Takes the number of a step and the model after it; `false` ends the job there.
pub type StepTaker<'a> = dyn FnMut(usize, &WrittenFiles) -> bool + 'a;

/// What a job writes.
#[derive(Default)]
pub struct BatchOutput<'a> {
    /// As what; as the model's own format when `None`.
    pub format: Option<Format>,
    /// Takes the model after every step, when not only the last one is wanted.
    pub each_step: Option<&'a mut StepTaker<'a>>,
}

/// Runs `job` on a model and writes the result as `format` (the model's own when `None`).
///
/// # Errors
/// Any [`Error`]; those of a step name it (`steps[1]`).
pub fn run(
    files: FileSet,
    job: &pb::Job,
    format: Option<Format>,
    limits: &DeformerLimits,
    exec: &Exec<'_>,
    millis: &(dyn Fn() -> f64 + Sync),
) -> Result<BatchOutcome, Error> {
    let output = BatchOutput {
        format,
        each_step: None,
    };
    run_and_write(files, job, output, limits, exec, millis)
}

/// As [`run`], with more to say about what is written.
///
/// # Errors
/// Those of [`run`]; [`Error::Cancelled`] when `each_step` returns `false`.
pub fn run_and_write(
    files: FileSet,
    job: &pb::Job,
    output: BatchOutput<'_>,
    limits: &DeformerLimits,
    exec: &Exec<'_>,
    millis: &(dyn Fn() -> f64 + Sync),
) -> Result<BatchOutcome, Error> {
    let options = checked_options(job)?;
    job.expect.as_ref().map_or(Ok(()), |expect| expect.check("expect"))?;
    let todo = steps_of(job)?;
    check_begin(job, &todo)?;
    let BatchOutput { format, mut each_step } = output;
    let stages = StageClock::new(millis, exec.progress);
    let exec = Exec::new(exec.pool, &stages);
    let mut batch = BatchRun::open(files, job, &options, limits, &exec)?;
    let build_ms = stages.take_stage_ms();

    let mut steps = Vec::new();
    for (k, todo_now) in todo.iter().enumerate() {
        let fraction = k as f32 / todo.len() as f32;
        let done = match todo_now {
            Step::Pose(pose) => {
                stages.report("solve", fraction);
                batch.pose(pose, &exec)
            }
            Step::Edit(request) => {
                stages.report("edit", fraction);
                batch.edit(k, request, &exec)
            }
        };
        let mut done = done.map_err(|e| at_step(e, k, &batch.warned))?;
        let mut ms = stages.take_stage_ms();
        ms.insert("build".into(), if k == 0 { build_ms.values().sum() } else { 0.0 });
        let facts = batch.deformer.facts().solver;
        done.ms = ms.into_iter().collect();
        done.levels = facts.levels.len() as u32;
        done.bytes = facts.byte_size;
        done.digest = digest(&batch.shape.positions);
        done.field_cycles = (batch.deformer.handle_system()).map_or(0, |h| h.field_iterations as u32);
        if let Some(take) = &mut each_step {
            stages.report("encode", 0.0);
            let written = batch.write(format, &exec)?;
            done.ms.extend(stages.take_stage_ms());
            if !take(k, &written) {
                return Err(Error::Cancelled);
            }
        }
        steps.push(done);
    }
    let last = steps.last().and_then(|step: &pb::report::Step| step.quality);
    let quality = last.map_or_else(|| batch.quality(&exec), Ok)?;
    let shape = batch.shape.clone();
    batch.riders.move_along(&batch.deformer, &shape.positions, &exec)?;
    stages.report("encode", 0.0);
    let BatchRun {
        deformer,
        poses,
        riders,
        idle,
        shape: ModelShape { positions, turns, .. },
        ..
    } = batch;
    let written = deformer.write(&positions, format.unwrap_or(deformer.model().format), &exec)?;
    if let (Some(step), Some(ms)) = (steps.last_mut(), stages.take_stage_ms().remove("encode")) {
        step.ms.insert("encode".into(), ms);
    }
    let mut facts = session_message(&deformer.facts());
    add_found_turns(&mut facts.handles, &found_turns_message(&turns));
    let (passengers, carried) = riders.write_files(&deformer.carry_nodes(&positions, &exec)?)?;
    let noticed = deformer.shape_warnings(&positions, &poses, &options.solve, &exec)?;
    facts.warnings.extend(large_faces_warning(&quality));
    facts.warnings.extend(noticed.iter().map(warning_message));
    (facts.warnings)
        .extend((idle.iter().map(|id| idle_handle_warning(id))).chain(warnings_of_files(&written, &carried)));
    let report = pb::Report {
        passengers,
        followed: followed_message(&written.followed),
        model: facts.model,
        warnings: facts.warnings,
        quality: Some(quality),
        digest: digest(&positions),
        solver: facts.solver,
        build_ms,
        handles: facts.handles,
        steps,
        output: Vec::new(),
    };
    let (unmet, unchecked) = unmet_expectations(job.expect.as_ref(), &report);
    Ok(BatchOutcome {
        report,
        triangles: deformer.geometry().triangles.clone(),
        constraint_error: deformer.constraint_error(&positions, &poses)?,
        positions,
        written,
        carried,
        unmet,
        unchecked,
    })
}

/// How the poses of a job are solved.
fn checked_options(job: &pb::Job) -> Result<DeformOptions, Error> {
    let options = DeformOptions::check(&job.pose_options(), "options", u32::MAX)?;
    match options.from_revision {
        None => Ok(options),
        Some(_) => {
            let problem = "names a commit of a session, which a job does not have; leave it out";
            Err(Error::invalid("options.fromRevision", problem))
        }
    }
}

/// A job under way.
struct BatchRun<'a> {
    deformer: Deformer,
    options: &'a DeformOptions,
    /// The poses in force.
    poses: HandlePoses,
    shape: ModelShape,
    /// Whether it is solved, not the rest shape.
    is_solved: bool,
    /// What edits warned of.
    warned: Vec<String>,
    /// What is carried with the model.
    riders: Riders,
    /// Handles that a step posed while they held nothing.
    idle: BTreeSet<String>,
}

impl<'a> BatchRun<'a> {
    /// Opens the model and sets the handles.
    fn open(
        files: FileSet,
        job: &pb::Job,
        options: &'a DeformOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let create = open_options(&job.create.clone().unwrap_or_default())?;
        let riders = Riders::read(&create, &limits.model)?;
        let mut deformer = Deformer::open(files, &create, limits, exec)?;
        deformer.set_handles(handle_set(&handles_request(job))?, exec)?;
        Ok(Self {
            poses: deformer.initial_poses(),
            shape: deformer.rest_shape(),
            deformer,
            options,
            is_solved: false,
            warned: Vec::new(),
            riders,
            idle: BTreeSet::new(),
        })
    }

    /// Solves a pose.
    fn pose(&mut self, pose: &pb::Pose, exec: &Exec<'_>) -> Result<pb::report::Step, Error> {
        if pose.more {
            let problem = "is for poses on a stream; a step of a job has the whole pose";
            return Err(Error::invalid("pose.more", problem));
        }
        self.poses = change_poses(&self.deformer, &self.poses, pose)?;
        let facts = self.deformer.facts().handles;
        let posed = facts.into_iter().zip(self.poses.0.iter());
        let idle =
            posed.filter(|(held, pose)| held.vertices + held.interior_nodes == 0 && **pose != HandlePose::default());
        self.idle.extend(idle.map(|(held, _)| held.id));
        let (settings, mode) = (&self.options.solve, SolveMode::Commit);
        let solved = (self.deformer).solve(&self.poses, settings, mode, exec, &mut |_| true)?;
        let stats = solved.stats;
        self.shape = solved;
        self.is_solved = true;
        exec.progress.report("quality", 0.0);
        Ok(pb::report::Step {
            kind: "pose".into(),
            cycles: stats.cycles,
            residual: stats.residual,
            max_error: stats.max_error,
            quality: Some(self.quality(exec)?),
            solver: stats.solver.into(),
            ..Default::default()
        })
    }

    /// Edits the topology; `k` is the number of the step.
    fn edit(&mut self, k: usize, request: &pb::EditRequest, exec: &Exec<'_>) -> Result<pb::report::Step, Error> {
        if !request.session_id.is_empty() {
            let problem = "names a session, but a job edits its own model; leave it out";
            return Err(Error::invalid("edit.sessionId", problem));
        }
        let (edit, on) = edit(request, None)?;
        let command = EditCommand {
            edit: &edit,
            on,
            shape: &self.shape,
            poses: &self.poses,
            settings: self.is_solved.then_some(&self.options.solve),
        };
        if let Some(Operation::Adopt(adopt)) = &request.operation
            && (adopt.more || adopt.first > 0)
        {
            let field = if adopt.more {
                "edit.adopt.more"
            } else {
                "edit.adopt.first"
            };
            let problem = "is for sessions, which take a shape in parts; a job has it whole";
            return Err(Error::invalid(field, problem));
        }
        let seen = self.deformer.shape_to_edit(&command, exec)?;
        if on == EditedShape::Current || edit.kind().gives_shape() {
            // What the edit sees becomes the rest pose, of what rides along too.
            (self.riders).move_along(&self.deformer, &seen.shape.positions, exec)?;
        }
        let outcome = self.deformer.edit_shape(&command, &seen, exec)?;
        self.is_solved &= outcome.solved.is_some();
        let noticed = outcome.report.warnings.iter();
        (self.warned).extend(noticed.map(|w| format!("steps[{k}]: {}: {}", w.code, w.message)));
        self.poses = outcome.poses;
        self.shape = outcome.shape;
        Ok(pb::report::Step {
            kind: "edit".into(),
            edit: Some(edit_result(&outcome.report)),
            ..Default::default()
        })
    }

    /// The model as it is now.
    fn write(&self, format: Option<Format>, exec: &Exec<'_>) -> Result<WrittenFiles, Error> {
        let format = format.unwrap_or(self.deformer.model().format);
        self.deformer.write(&self.shape.positions, format, exec)
    }

    /// Compares the shape with the rest shape.
    fn quality(&self, exec: &Exec<'_>) -> Result<pb::Quality, Error> {
        let count_crossings = self.options.output.self_intersections;
        let quality = (self.deformer).measure(&self.shape.positions, count_crossings, exec)?;
        Ok(quality_message(&quality))
    }
}

/// The request that sets a job's handles.
pub fn handles_request(job: &pb::Job) -> pb::SetHandlesRequest {
    pb::SetHandlesRequest {
        session_id: String::new(),
        handles: job.handles.clone(),
        symmetry_plane: job.symmetry_plane.clone(),
        region_of_interest: job.region_of_interest.clone(),
        stiff: job.stiff.clone(),
    }
}

/// The poses of a job that edits nothing, each naming the handles that it changes. Without steps the poses that the handles
/// come with are one.
///
/// # Errors
/// [`Error::Unimplemented`] for steps that edit, [`Error::Invalid`] for empty ones.
pub fn pose_steps(job: &pb::Job) -> Result<Vec<pb::Pose>, Error> {
    (steps_of(job)?.into_iter().enumerate())
        .map(|(k, step)| match step {
            Step::Pose(pose) => Ok(pose),
            Step::Edit(edit) => Err(Error::Unimplemented(format!("steps[{k}].edit ({})", edit_name(&edit)))),
        })
        .collect()
}

/// The steps of a job. Without any the poses that the handles come with are one.
///
/// # Errors
/// [`Error::Invalid`] for an empty step.
pub(crate) fn steps_of(job: &pb::Job) -> Result<Vec<Step>, Error> {
    if job.steps.is_empty() {
        let posed = job.handles.iter().any(|h| h.pose.is_some());
        return Ok(posed.then(|| Step::Pose(pb::Pose::default())).into_iter().collect());
    }
    let steps = job.steps.iter().enumerate();
    let step = |(k, step): (usize, &pb::Step)| {
        let empty = || Error::invalid(format!("steps[{k}]"), "is empty, allowed is one of pose or edit");
        step.step.clone().ok_or_else(empty)
    };
    steps.map(step).collect()
}

/// Refuses poses that handles come with and that no step would ever solve: the first one edits the shape that is there and takes the
/// handles in it as they are. Only a subdivision for poses looks at them.
fn check_begin(job: &pb::Job, steps: &[Step]) -> Result<(), Error> {
    let Some(Step::Edit(first)) = steps.first() else {
        return Ok(());
    };
    let is_for_poses = match &first.operation {
        Some(Operation::Subdivide(subdivide)) => subdivide.auto,
        _ => false,
    };
    let moves = |h: &pb::Handle| h.pose.as_ref().is_some_and(|pose| *pose != pb::HandlePose::default());
    match job.handles.iter().position(moves) {
        Some(k) if first.on() == pb::edit_request::On::Current && !is_for_poses => {
            let problem = "is given, but the first step is an edit, which would drop it; begin with the step {\"pose\": {}}, give the \
                           pose in a later step, or edit with \"on\": \"REST\"";
            Err(Error::invalid(format!("handles[{k}].pose"), problem))
        }
        _ => Ok(()),
    }
}

/// The error of a step, with what edits before it warned of: mostly that is the reason.
fn at_step(e: Error, k: usize, warned: &[String]) -> Error {
    let before = match warned {
        [] => String::new(),
        warned => format!(" (before it: {})", warned.join("; ")),
    };
    match e {
        Error::Invalid { field, problem } => Error::Invalid {
            field: format!("steps[{k}].{field}"),
            problem: problem + &before,
        },
        Error::Precondition(text) => Error::Precondition(format!("steps[{k}]: {text}{before}")),
        other => other,
    }
}

/// What is said of a handle that a step posed, and that holds nothing that could follow.
fn idle_handle_warning(id: &str) -> pb::Warning {
    pb::Warning {
        code: "idle-handle".into(),
        message: format!(
            "a step moves handle \"{id}\", which holds nothing, so that nothing follows it; make its region larger, or list it \
             after the handles that overlap it; points in no triangle are held by none, and follow the surface around them"
        ),
        r#where: format!("handle \"{id}\""),
        ..Default::default()
    }
}

/// What the final shape says of faces that are too large for its bends.
fn large_faces_warning(quality: &pb::Quality) -> Option<pb::Warning> {
    (quality.faces_too_large > 0).then(|| pb::Warning {
        code: "faces-too-large-for-pose".into(),
        message: format!(
            "{} triangles are bent by more than 30° from one corner to another and show a kink; the edit \"subdivide\" \
             with \"auto\" before the pose divides them",
            quality.faces_too_large
        ),
        ..Default::default()
    })
}

/// What is said of the files of a job's model and of those that it carried.
fn warnings_of_files(written: &WrittenFiles, carried: &[CarriedFile]) -> Vec<pb::Warning> {
    let mut warnings = written_warnings(written);
    for file in carried {
        let own = written_warnings(&file.written).into_iter();
        warnings.extend(own.map(|warning| pb::Warning {
            message: format!("{}: {}", file.path, warning.message),
            ..warning
        }));
    }
    warnings
}

/// The expectations that a report's quality and digest do not meet, one sentence each, and those that need a stored
/// result.
pub fn unmet_expectations(expect: Option<&pb::Expect>, report: &pb::Report) -> (Vec<String>, Vec<&'static str>) {
    let Some(expect) = expect else {
        return Default::default();
    };
    let quality = report.quality.unwrap_or_default();
    let mut unmet = Vec::new();
    let flipped = quality.flipped_triangles;
    if let Some(most) = expect.flipped_triangles.filter(|most| flipped > *most) {
        unmet.push(format!("flippedTriangles is {flipped}, at most {most} expected"));
    }
    match (expect.new_self_intersections, quality.new_self_intersections) {
        (Some(most), Some(crossing)) if crossing > most => {
            unmet.push(format!("newSelfIntersections is {crossing}, at most {most} expected"));
        }
        (Some(_), None) => {
            unmet.push("newSelfIntersections is expected but not counted: the last step must be a pose".into())
        }
        _ => {}
    }
    if let Some(most) = expect.volume_change.filter(|most| quality.volume_change.abs() > *most) {
        // As `{:?}`: what is huge or tiny comes with an exponent.
        unmet.push(format!(
            "volumeChange is {:?}, at most {most:?} either way expected",
            quality.volume_change
        ));
    }
    if !expect.digest.is_empty() && expect.digest != report.digest {
        unmet.push(format!("digest is {}, expected {}", report.digest, expect.digest));
    }
    let stored = [
        ("maxDistance", expect.max_distance.is_some()),
        ("meanDistance", expect.mean_distance.is_some()),
        ("normalDegrees", expect.normal_degrees.is_some()),
    ];
    let asked = stored.into_iter().filter(|(_, asked)| *asked);
    (unmet, asked.map(|(name, _)| name).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expect(text: &str) -> pb::Expect {
        crate::wire::json::from_json(text.as_bytes()).expect("an expectation")
    }

    #[test]
    fn a_bound_that_can_never_fail_or_hold_is_refused() {
        for name in ["maxDistance", "meanDistance", "normalDegrees", "volumeChange"] {
            for bound in ["\"NaN\"", "\"Infinity\"", "\"-Infinity\"", "-1", "-1e-300"] {
                let reported = expect(&format!("{{\"{name}\": {bound}}}")).check("expect");
                let reported = reported.expect_err(bound).to_string();
                assert!(
                    reported.starts_with(&format!("expect.{name}: is ")) && reported.contains("at least 0"),
                    "{reported}"
                );
            }
            for bound in ["0", "1e-3", "1e300"] {
                assert_eq!(expect(&format!("{{\"{name}\": {bound}}}")).check("expect"), Ok(()));
            }
        }
        assert_eq!(pb::Expect::default().check("expect"), Ok(()));
    }

    #[test]
    fn the_volume_counts_either_way() {
        let report = |volume_change: f64| pb::Report {
            quality: Some(pb::Quality {
                volume_change,
                ..Default::default()
            }),
            ..Default::default()
        };
        let unmet = |most: &str, is: f64| {
            let text = format!("{{\"volumeChange\": {most}}}");
            unmet_expectations(Some(&expect(&text)), &report(is)).0
        };
        assert!(unmet("0.1", 0.1).is_empty() && unmet("0.1", -0.1).is_empty() && unmet("0", 0.0).is_empty());
        assert_eq!(
            unmet("0.1", -0.2),
            ["volumeChange is -0.2, at most 0.1 either way expected"]
        );
        assert_eq!(
            unmet("1e-9", 1e300),
            ["volumeChange is 1e300, at most 1e-9 either way expected"]
        );
    }
}

//! `pliant deform`: the engine in process, without a server.

use super::input_files::{
    AllowedFolders, LARGEST, NamedFiles, folder_of, in_file, output_format, read_file, read_model,
};
use super::output_files::{OutputPermission, is_same_place};
use super::terminal::{CliFailure, ComputeArgs, print_json, say};
use crate::asset::{FileSet, FollowedCounts, Format, WrittenFiles};
use crate::batch::{self, BatchOutput};
use crate::engine::DeformerLimits;
use crate::exec::Exec;
use crate::mesh::grouped_count;
use crate::session::SessionConfig;
use crate::wire::{self, pb};
use bytes::Bytes;
use clap::Args;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Arguments of `pliant deform`.
#[derive(Debug, Args)]
pub struct DeformArgs {
    /// Model file: glb (or vrm), gltf, obj, ply, off, stl, 3mf, fbx, splat or spz
    model: PathBuf,
    /// Job file: handles, steps and options as JSON
    #[arg(long)]
    job: PathBuf,
    /// Output file; its extension selects the format
    #[arg(short, long)]
    output: PathBuf,
    /// Folder for the model after each step, as numbered files
    #[arg(long, value_name = "FOLDER")]
    steps: Option<PathBuf>,
    #[command(flatten)]
    allowed: AllowedFolders,
    #[command(flatten)]
    permission: OutputPermission,
    /// Print a report as JSON on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    compute: ComputeArgs,
}

pub(super) fn run_deform(args: &DeformArgs) -> Result<(), CliFailure> {
    let format = output_format(&args.output)?;
    args.permission.check_target(&args.output)?;
    let job = read_job(&args.job, &args.allowed)?;
    let folder = args.output.parent().unwrap_or(Path::new(""));
    check_passenger_outputs(&job, folder, args)?;
    for step in 0..job.steps.len() {
        let Some(path) = args.step_path(step, format) else {
            break;
        };
        if is_same_place(&path, &args.output) {
            let problem = format!("{} is where the result is written", path.display());
            return Err(CliFailure::Input(format!("--steps: {problem}; name another folder")));
        }
        args.permission.check_target(&path)?;
    }
    let pool = args.compute.threads.start_pool()?;
    let files = read_model(&args.model)?;
    let spinner = args.compute.show_stages(args.json);
    let clock = Instant::now();
    let millis = || clock.elapsed().as_secs_f64() * 1e3;
    let limits = DeformerLimits::default();
    let mut written_steps = Vec::new();
    let mut refused = None;
    let mut take = |step: usize, written: &WrittenFiles| {
        let path = args.step_path(step, format).unwrap_or_default();
        let done = args.permission.write_model(&path, written, &args.model, &files);
        done.map(|paths| written_steps.extend(paths))
            .map_err(|e| refused = Some(e))
            .is_ok()
    };
    let output = BatchOutput {
        format: Some(format),
        each_step: args.steps.is_some().then_some(&mut take),
    };
    let exec = Exec::new(&pool, &spinner);
    let outcome = batch::run_and_write(files.clone(), &job, output, &limits, &exec, &millis);
    if let Some(refused) = refused {
        return Err(refused);
    }
    let mut outcome = outcome?;
    spinner.finish();

    let written = args
        .permission
        .write_model(&args.output, &outcome.written, &args.model, &files)?;
    let all = written.iter().chain(&written_steps);
    outcome.report.output = all.map(|p| p.display().to_string()).collect();
    for passenger in &outcome.carried {
        let path = folder.join(&passenger.path);
        let written = args
            .permission
            .write_model(&path, &passenger.written, &path, &FileSet::default())?;
        let paths = written.iter().map(|p| p.display().to_string());
        outcome.report.output.extend(paths);
    }
    if args.json {
        print_json(&outcome.report)?;
    } else {
        print_summary(&outcome.report, &outcome.written.followed, millis());
    }
    for name in &outcome.unchecked {
        say!("expect.{name} needs a stored result and was not checked");
    }
    match outcome.unmet.is_empty() {
        true => Ok(()),
        false => Err(CliFailure::Check(outcome.unmet.join("; "))),
    }
}

impl DeformArgs {
    /// Where the model goes as it is after a step.
    fn step_path(&self, step: usize, format: Format) -> Option<PathBuf> {
        let folder = self.steps.as_ref()?;
        Some(folder.join(format!("step_{step:05}.{format}")))
    }
}

/// Refuses a passenger that is to be written where the result is, or where it may not be written.
fn check_passenger_outputs(job: &pb::Job, folder: &Path, args: &DeformArgs) -> Result<(), CliFailure> {
    let passengers = job.create.iter().flat_map(|create| &create.passengers);
    for (k, passenger) in passengers.enumerate() {
        let Some(pb::passenger::Passenger::File(file)) = &passenger.passenger else {
            continue;
        };
        let path = folder.join(&file.output);
        if path == args.output {
            let problem = format!("is \"{}\", where the result is written", file.output);
            return Err(CliFailure::Input(format!("passengers[{k}].file.output: {problem}")));
        }
        if !file.output.is_empty() {
            args.permission.check_target(&path)?;
        }
    }
    Ok(())
}

/// A change of the volume in words. What an open surface encloses depends on where the origin is, so it has none.
pub(in crate::cli) fn describe_change(is_open: bool, change: f64) -> String {
    match is_open {
        true => "n/a (the surface is open)".into(),
        false => format!("{:+.2} %", 100.0 * change),
    }
}

fn print_summary(report: &pb::Report, followed: &FollowedCounts, millis: f64) {
    let solver = report.solver.clone().unwrap_or_default();
    for w in &report.warnings {
        say!("warning {}: {}", w.code, w.message);
    }
    for (k, step) in report.steps.iter().enumerate() {
        if let Some(edit) = &step.edit {
            let [before, after] = [edit.before, edit.after].map(Option::unwrap_or_default);
            say!(
                "step {k}: edited, {} -> {} vertices, {} -> {} triangles, {:.0} ms",
                grouped_count(before.vertices.into()),
                grouped_count(after.vertices.into()),
                grouped_count(before.faces.into()),
                grouped_count(after.faces.into()),
                step.ms.values().sum::<f64>()
            );
            edit.warnings
                .iter()
                .for_each(|w| say!("warning {}: {}", w.code, w.message));
            continue;
        }
        say!(
            "step {k}: {} cycles, residual {:.1e}, error at most {:.1e} of the diagonal, {:.0} ms",
            step.cycles,
            step.residual,
            step.max_error,
            step.ms.get("solve").copied().unwrap_or_default()
        );
    }
    if report.steps.is_empty() {
        say!("the job has no steps, so the shape stays as it is");
    }
    let quality = report.quality.unwrap_or_default();
    let volume = describe_change(quality.open_surface, quality.volume_change);
    say!(
        "{} solver vertices, {} graph vertices, {} levels; volume {volume}, {} triangles flipped; {:.0} ms in all",
        grouped_count(solver.solver_vertices.into()),
        grouped_count(solver.graph_vertices.into()),
        solver.levels.len(),
        grouped_count(quality.flipped_triangles.into()),
        millis
    );
    if let Some(pairs) = quality.self_intersections {
        let new = quality.new_self_intersections.unwrap_or(pairs);
        say!("{pairs} pairs of triangles cross, {new} of them not in the rest pose");
    }
    if !followed.is_none() {
        say!("followed: {followed}");
    }
    say!("{} -> {}", report.digest, report.output.join(", "));
}

/// Reads a job file and the models that it names, which lie beside it or in folders that are allowed.
pub(super) fn read_job(path: &Path, allowed: &AllowedFolders) -> Result<pb::Job, CliFailure> {
    let text = read_file(path)?;
    job_from_text(&text, path, &NamedFiles::new(folder_of(path), allowed)?)
}

/// Reads a job from the text of its file, and the models that it names.
pub(super) fn job_from_text(text: &[u8], path: &Path, files: &NamedFiles) -> Result<pb::Job, CliFailure> {
    let mut job: pb::Job = wire::json::from_json(text).map_err(|e| in_file(path, e))?;
    read_named_models(&mut job, "", files).map_err(|e| e.in_place(path.display()))?;
    Ok(job)
}

/// Puts the models in that a job names by file. `place` stands before the names of fields where one is wrong.
pub(super) fn read_named_models(job: &mut pb::Job, place: &str, files: &NamedFiles) -> Result<(), CliFailure> {
    use pb::edit_request::{Operation, merge, wrap};
    use pb::passenger::{Passenger, file};
    let mut models = NamedModels {
        files,
        read: BTreeMap::new(),
        bytes: 0,
    };
    for (k, step) in job.steps.iter_mut().enumerate() {
        let Some(pb::step::Step::Edit(edit)) = &mut step.step else {
            continue;
        };
        match &mut edit.operation {
            Some(Operation::Merge(merge)) => {
                if let Some(merge::Source::File(name)) = &merge.source {
                    let bytes = models.read_once(name, || format!("{place}steps[{k}].merge.file"))?;
                    report_format(&mut merge.format, name);
                    merge.source = Some(merge::Source::Model(bytes));
                }
            }
            Some(Operation::Wrap(wrap)) => {
                if let Some(wrap::Target::File(name)) = &wrap.target {
                    let bytes = models.read_once(name, || format!("{place}steps[{k}].wrap.file"))?;
                    report_format(&mut wrap.format, name);
                    wrap.target = Some(wrap::Target::Model(bytes));
                }
            }
            _ => {}
        }
    }
    let passengers = job.create.iter_mut().flat_map(|create| &mut create.passengers);
    for (k, passenger) in passengers.enumerate() {
        let Some(Passenger::File(file)) = &mut passenger.passenger else {
            continue;
        };
        if let Some(file::Source::File(name)) = &file.source {
            let bytes = models.read_once(name, || format!("{place}passengers[{k}].file.file"))?;
            report_format(&mut file.format, name);
            file.source = Some(file::Source::Model(bytes));
        }
    }
    Ok(())
}

/// Models of a job, each read once whatever the number of steps that name it.
struct NamedModels<'a> {
    files: &'a NamedFiles,
    read: BTreeMap<String, Bytes>,
    bytes: u64,
}

impl NamedModels<'_> {
    fn read_once(&mut self, name: &str, field: impl Fn() -> String) -> Result<Bytes, CliFailure> {
        if let Some(bytes) = self.read.get(name) {
            return Ok(bytes.clone());
        }
        let read = self.files.read_named(name, largest_named());
        let bytes: Bytes = read.map_err(|e| CliFailure::from(e).in_place(field()))?.into();
        self.bytes = self.bytes.saturating_add(bytes.len() as u64);
        if self.bytes > LARGEST {
            let problem = format!("the files that the job names have more than {LARGEST} bytes together");
            return Err(CliFailure::Input(problem).in_place(field()));
        }
        self.read.insert(name.to_owned(), bytes.clone());
        Ok(bytes)
    }
}

/// Largest file that a job or a suite names: a server's default limit of one upload.
pub(super) fn largest_named() -> u64 {
    SessionConfig::default().upload_bytes
}

/// Takes the format from a file's name, unless the job says it.
pub(super) fn report_format(format: &mut String, name: &str) {
    if format.is_empty() {
        let reported = Format::from_file_name(name);
        *format = reported.map_or_else(String::new, |f| f.name().to_owned());
    }
}

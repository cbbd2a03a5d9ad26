//! `pliant wrap`: a model takes the shape of another one, mostly a scan, and keeps its topology and all that hangs on it.

pub(super) mod landmarks;

use super::deform::report_format;
use super::input_files::{in_file, read_file, read_model};
use super::result_args::{ResultArgs, SheetLayout, captioned, read_shape};
use super::terminal::{CliFailure, print_json, say};
use crate::asset::{FileSet, WrittenFiles};
use crate::batch::{self, BatchOutput};
use crate::engine::DeformerLimits;
use crate::exec::Exec;
use crate::mesh::grouped_count;
use crate::pool::Pool;
use crate::wire::{self, pb};
use clap::Args;
use landmarks::{in_names_of_file, landmarks_from_json};
use std::path::PathBuf;
use std::time::Instant;

/// Sides of one view of a picture, pixels.
const SIDES: [u32; 2] = [480, 640];

/// Arguments of `pliant wrap`.
#[derive(Debug, Args)]
pub struct WrapArgs {
    /// Model to wrap: glb (or vrm), gltf, obj, ply, off, stl or fbx
    template: PathBuf,
    /// Model or scan to wrap it onto
    target: PathBuf,
    /// Landmarks: a JSON list of {"template": PLACE, "target": PLACE}, where a place is a vertex number or [x, y, z]
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    /// What of the model the target does not pull: a region as JSON, as jobs have it
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
    /// Leave the result in the place and of the size of the model; without, it is where the target is
    #[arg(long)]
    in_place: bool,
    #[command(flatten)]
    result: ResultArgs,
}

pub(super) fn run_wrap(args: &WrapArgs) -> Result<(), CliFailure> {
    let format = args.result.checked_format()?;
    let pool = args.result.compute.threads.start_pool()?;
    let files = read_model(&args.template)?;
    args.result.spare(&args.template, &files)?;
    let target = read_file(&args.target)?;
    let job = args.job(target.clone())?;
    let spinner = args.result.compute.show_stages(args.result.json);
    let clock = Instant::now();
    let millis = || clock.elapsed().as_secs_f64() * 1e3;
    let output = BatchOutput {
        format: Some(format),
        each_step: None,
    };
    let limits = DeformerLimits::default();
    let exec = Exec::new(&pool, &spinner);
    let outcome = batch::run_and_write(files.clone(), &job, output, &limits, &exec, &millis);
    let mut outcome = outcome.map_err(|e| in_names_of_file(e, [["own", "template"], ["target", "target"]]))?;
    spinner.finish();
    outcome.report.output = (args.result).write_model(&outcome.written, &args.template, &files)?;
    args.result.write_report(&outcome.report)?;
    if let Some(path) = &args.result.picture {
        args.draw(
            path,
            [files, FileSet::single(args.target.display().to_string(), target)],
            &outcome.written,
            &pool,
        )?;
    }
    match args.result.json {
        true => print_json(&outcome.report)?,
        false => print_summary(&outcome.report, &outcome.written, millis()),
    }
    Ok(())
}

impl WrapArgs {
    /// The job that wraps.
    fn job(&self, target: Vec<u8>) -> Result<pb::Job, CliFailure> {
        use pb::edit_request::{Operation, Wrap, wrap};
        let landmarks = match &self.landmarks {
            Some(path) => landmarks_from_json(&read_file(path)?, "template").map_err(|e| in_file(path, e))?,
            None => Vec::new(),
        };
        let mask = match &self.mask {
            Some(path) => Some(wire::json::from_json::<pb::Region>(&read_file(path)?).map_err(|e| in_file(path, e))?),
            None => None,
        };
        let mut wrap = Wrap {
            mask,
            target: Some(wrap::Target::Model(target.into())),
            landmarks,
            in_place: self.in_place,
            ..Wrap::default()
        };
        report_format(&mut wrap.format, &self.target.to_string_lossy());
        let edit = pb::EditRequest {
            operation: Some(Operation::Wrap(wrap)),
            ..pb::EditRequest::default()
        };
        let step = pb::Step {
            step: Some(pb::step::Step::Edit(edit)),
        };
        // A wrap solves on the surface; nodes inside would be built twice for nothing.
        let volume_graph = pb::create_options::VolumeGraph {
            mode: pb::create_options::volume_graph::Mode::Off.into(),
            ..pb::create_options::VolumeGraph::default()
        };
        let create = pb::CreateOptions {
            volume_graph: Some(volume_graph),
            ..pb::CreateOptions::default()
        };
        Ok(pb::Job {
            create: Some(create),
            steps: vec![step],
            ..pb::Job::default()
        })
    }

    /// Draws model, target and result.
    fn draw(
        &self,
        path: &std::path::Path,
        [template, target]: [FileSet; 2],
        written: &WrittenFiles,
        pool: &Pool,
    ) -> Result<(), CliFailure> {
        let shapes = [
            captioned("template", &read_shape(template, &self.template)?, &self.template, pool)?,
            captioned("target", &read_shape(target, &self.target)?, &self.target, pool)?,
            captioned("wrapped", &self.result.result(written)?, &self.result.output, pool)?,
        ];
        let layout = SheetLayout {
            sides: SIDES,
            columns: 3,
            is_one_view: false,
        };
        self.result.draw(path, &shapes, &layout, pool)
    }
}

fn print_summary(report: &pb::Report, written: &WrittenFiles, millis: f64) {
    for w in &report.warnings {
        say!("warning {}: {}", w.code, w.message);
    }
    let edit = report
        .steps
        .first()
        .and_then(|step| step.edit.clone())
        .unwrap_or_default();
    for w in &edit.warnings {
        say!("warning {}: {}", w.code, w.message);
    }
    let told = edit.wrap.unwrap_or_default();
    let percent = |d: Option<pb::wrap_report::Distances>| {
        let d = d.unwrap_or_default();
        format!("{:.3} / {:.3} / {:.2} %", 100.0 * d.p50, 100.0 * d.p95, 100.0 * d.max)
    };
    say!(
        "to the target {}, from it {} of its diagonal (p50 / p95 / max)",
        percent(told.to_target),
        percent(told.from_target)
    );
    if told.landmarks.is_some_and(|d| d.max > 0.0) {
        say!("landmarks {}", percent(told.landmarks));
    }
    say!(
        "{} of {} vertices not pulled, {} triangles flipped, edges uneven by {:.1} %, {} pairs of triangles cross ({} before); \
         {millis:.0} ms in all",
        grouped_count(told.unpulled_vertices.into()),
        grouped_count(told.vertices.into()),
        grouped_count(told.flipped_triangles.into()),
        100.0 * told.edge_distortion,
        grouped_count(told.crossings),
        grouped_count(told.crossings_before),
    );
    if !written.followed.is_none() {
        say!("followed: {}", written.followed);
    }
    say!("{} -> {}", report.digest, report.output.join(", "));
}

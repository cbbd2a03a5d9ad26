//! `pliant fit`: an outfit of a body comes to another body, and stays outside of it.

use super::input_files::{in_file, read_file, read_model};
use super::result_args::{ResultArgs, SheetLayout, captioned, read_shape};
use super::terminal::{CliFailure, print_json, say};
use super::wrap::landmarks::landmarks_from_json;
use crate::asset::{FileSet, Format, WrittenFiles};
use crate::deform::VolumeMode;
use crate::engine::{Deformer, DeformerLimits, OpenOptions, OtherModel, Transferred};
use crate::exec::Exec;
use crate::mesh::grouped_count;
use crate::pool::Pool;
use crate::wire::{self, pb};
use clap::Args;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Sides of one picture of a sheet, pixels.
const SIDES: [u32; 2] = [420, 560];

/// Arguments of `pliant fit`.
#[derive(Debug, Args)]
pub struct FitArgs {
    /// Outfit, where it fits the first body: glb (or vrm), gltf, obj, ply, off, stl or fbx
    outfit: PathBuf,
    /// Body that it fits
    body: PathBuf,
    /// Body that it is to fit; its triangles may be others
    other_body: PathBuf,
    /// Landmarks of the bodies: a JSON list of {"source": PLACE, "target": PLACE}, where a place is a vertex number or [x, y, z]
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    /// What the outfit keeps from the other body at most, model units. Default: 0.005 of its diagonal
    #[arg(long, value_name = "LENGTH")]
    clearance: Option<f64>,
    #[command(flatten)]
    result: ResultArgs,
}

pub(super) fn run_fit(args: &FitArgs) -> Result<(), CliFailure> {
    let format = args.result.checked_format()?;
    let pool = args.result.compute.threads.start_pool()?;
    let outfit = read_model(&args.outfit)?;
    let bodies = [read_model(&args.body)?, read_model(&args.other_body)?];
    args.result.spare(&args.outfit, &outfit)?;
    let spinner = args.result.compute.show_stages(args.result.json);
    let clock = Instant::now();
    let came = args.fit(&outfit, &bodies, format, &Exec::new(&pool, &spinner))?;
    spinner.finish();
    let report = wire::transfer_report(&came.report);
    let written = (args.result).write_model(&came.files, &args.outfit, &outfit)?;
    args.result.write_report(&report)?;
    if let Some(path) = &args.result.picture {
        args.draw(path, outfit, bodies, &came.files, &pool)?;
    }
    for w in &came.files.warnings {
        say!("warning {}: {}", w.code, w.message);
    }
    if args.result.json {
        return print_json(&report);
    }
    print_summary(&report, clock.elapsed().as_secs_f64());
    say!("-> {}", written.join(", "));
    Ok(())
}

impl FitArgs {
    fn fit(
        &self,
        outfit: &FileSet,
        [body, other]: &[FileSet; 2],
        format: Format,
        exec: &Exec<'_>,
    ) -> Result<Transferred, CliFailure> {
        let landmarks = match &self.landmarks {
            Some(path) => landmarks_from_json(&read_file(path)?, "source").map_err(|e| in_file(path, e))?,
            None => Vec::new(),
        };
        let request = pb::TransferRequest {
            source: Some(pb::transfer_request::Source::Model(vec![0].into())),
            shape: vec![0].into(),
            landmarks,
            fit: Some(pb::transfer_request::Fit {
                clearance: self.clearance,
            }),
            ..pb::TransferRequest::default()
        };
        let mut command = wire::transfer_order(&request, Some(format))?.command;
        let of = |files: &FileSet| OtherModel {
            files: files.clone(),
            ..OtherModel::default()
        };
        command.source = of(body);
        command.shape = Some(of(other));
        let mut options = OpenOptions::default();
        options.body.volume = VolumeMode::Off;
        let deformer = Deformer::open(outfit.clone(), &options, &DeformerLimits::default(), exec)?;
        Ok(deformer.transfer(deformer.rest(), &command, exec)?)
    }

    /// Draws each body alone and in the outfit, the first one above.
    fn draw(
        &self,
        path: &Path,
        outfit: FileSet,
        [body, other]: [FileSet; 2],
        written: &WrittenFiles,
        pool: &Pool,
    ) -> Result<(), CliFailure> {
        let shapes = [
            captioned("body", &read_shape(body, &self.body)?, &self.body, pool)?,
            captioned("outfit", &read_shape(outfit, &self.outfit)?, &self.outfit, pool)?,
            captioned(
                "other body",
                &read_shape(other, &self.other_body)?,
                &self.other_body,
                pool,
            )?,
            captioned(
                "fitted outfit",
                &self.result.result(written)?,
                &self.result.output,
                pool,
            )?,
        ];
        let layout = SheetLayout {
            sides: SIDES,
            columns: 2,
            is_one_view: true,
        };
        self.result.draw(path, &shapes, &layout, pool)
    }
}

fn print_summary(report: &pb::TransferReport, seconds: f64) {
    if let Some(on) = report.wrap.and_then(|wrap| wrap.to_target) {
        say!(
            "the first body lies on the other to {:.3} / {:.3} / {:.2} % of its diagonal (p50 / p95 / max)",
            100.0 * on.p50,
            100.0 * on.p95,
            100.0 * on.max
        );
    }
    let fit = report.fit.unwrap_or_default();
    let count = |count: u32| grouped_count(count.into());
    say!(
        "{} of {} vertices that were outside are inside ({} as carried), {} new pairs of triangles cross ({}); {} were inside before; \
         {seconds:.1} s",
        count(fit.inside),
        count(fit.vertices),
        count(fit.inside_carried),
        grouped_count(fit.crossings),
        grouped_count(fit.crossings_carried),
        count(fit.inside_at_rest),
    );
}

//! `pliant fit`: an outfit of a body comes to another body, and stays outside of it.

use super::drawing::{DrawnShape, NormalChoice, UpAxisChoice, ViewList, parse_views};
use super::input_files::{in_file, output_format, read_file, read_model};
use super::output_files::{OutputPermission, check_ending, spare_companions};
use super::terminal::{CliFailure, StageSpinner, ThreadArgs, pretty_text, print_json, say};
use super::wrap::landmarks::landmarks_from_json;
use crate::asset::{FileSet, Format, Limits, Model, WrittenFiles};
use crate::deform::VolumeMode;
use crate::engine::{Deformer, DeformerLimits, OpenOptions, OtherModel, Transferred};
use crate::exec::Exec;
use crate::mesh::grouped_count;
use crate::pool::Pool;
use crate::render::{PictureSize, SheetShape, ViewSheet};
use crate::wire::{self, pb};
use clap::Args;
use glam::DVec3;
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
    /// Output file; its extension selects the format
    #[arg(short, long)]
    output: PathBuf,
    /// Landmarks of the bodies: a JSON list of {"source": PLACE, "target": PLACE}, where a place is a vertex number or [x, y, z]
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    /// What the outfit keeps from the other body at most, model units. Default: 0.005 of its diagonal
    #[arg(long, value_name = "LENGTH")]
    clearance: Option<f64>,
    /// Write the report as JSON
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Draw the outfit on both bodies (.png)
    #[arg(long, value_name = "PICTURE")]
    picture: Option<PathBuf>,
    /// View of the picture, as in `pliant render`
    #[arg(long, value_name = "VIEW", default_value = "front", value_parser = parse_views)]
    #[arg(allow_hyphen_values = true)]
    view: ViewList,
    /// Up axis of the models in the picture
    #[arg(long, value_enum, default_value_t = UpAxisChoice::Y)]
    up: UpAxisChoice,
    #[command(flatten)]
    permission: OutputPermission,
    /// Print the report as JSON on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    threads: ThreadArgs,
}

pub(super) fn run_fit(args: &FitArgs) -> Result<(), CliFailure> {
    let format = output_format(&args.output)?;
    args.permission.check_target(&args.output)?;
    if let Some(picture) = &args.picture {
        check_ending(picture, "png", "a picture")?;
    }
    for path in args.report.iter().chain(&args.picture) {
        if *path == args.output {
            let problem = format!("{} is where the result is written; name another file", path.display());
            return Err(CliFailure::Input(problem));
        }
        args.permission.check_target(path)?;
    }
    let pool = args.threads.start_pool()?;
    let outfit = read_model(&args.outfit)?;
    let bodies = [read_model(&args.body)?, read_model(&args.other_body)?];
    for path in args.report.iter().chain(&args.picture) {
        spare_companions(path, &args.outfit, &outfit)?;
    }
    let spinner = StageSpinner::new(args.json);
    let clock = Instant::now();
    let came = args.fit(&outfit, &bodies, format, &Exec::new(&pool, &spinner))?;
    spinner.finish();
    let report = wire::transfer_report(&came.report);
    let written = (args.permission).write_model(&args.output, &came.files, &args.outfit, &outfit)?;
    if let Some(path) = &args.report {
        let text = pretty_text(&wire::json::to_json(&report)?)?;
        args.permission.write_file(path, text.as_bytes())?;
    }
    if let Some(path) = &args.picture {
        args.draw(path, outfit, bodies, &came.files, &pool)?;
    }
    for w in &came.files.warnings {
        say!("warning {}: {}", w.code, w.message);
    }
    if args.json {
        return print_json(&report);
    }
    print_summary(&report, clock.elapsed().as_secs_f64());
    let written: Vec<String> = written.iter().map(|p| p.display().to_string()).collect();
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
        let mut result = FileSet::single(self.output.display().to_string(), written.main.clone());
        for (uri, bytes) in &written.companions {
            result.companions.insert(uri.clone(), bytes.clone().into());
        }
        let read = |files: FileSet, of: &Path| Model::read(files, None, &Limits::default()).map_err(|e| in_file(of, e));
        let mut drawn = Vec::new();
        for (files, of) in [
            (body, &self.body),
            (outfit, &self.outfit),
            (other, &self.other_body),
            (result, &self.output),
        ] {
            let mut shape = DrawnShape::of_model(&read(files, of)?, NormalChoice::File).map_err(|e| in_file(of, e))?;
            shape.wear_materials()?;
            drawn.push(shape.surface(None, DVec3::ZERO, pool)?);
        }
        let captions = ["body", "outfit", "other body", "fitted outfit"];
        let shapes = drawn.iter().zip(captions).map(|(surface, caption)| SheetShape {
            surface,
            caption: caption.to_owned(),
            marks: Vec::new(),
            near: None,
        });
        let sheet = ViewSheet {
            shapes: shapes.collect(),
            views: &self.view.directions(self.up)?[..1],
            size: PictureSize::new(SIDES[0], SIDES[1])?,
            columns: Some(2),
            fits_each: true,
            key: None,
        };
        self.permission.write_file(path, &sheet.draw_views(pool)?.encode_png()?)
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

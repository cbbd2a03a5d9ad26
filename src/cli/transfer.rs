//! `pliant transfer`: blend shapes of a model come to another one; or what a model does from one shape to another.

use super::drawing::{DrawnShape, NormalChoice, UpAxisChoice, ViewList, parse_views};
use super::input_files::{in_file, output_format, read_file, read_model};
use super::output_files::{OutputPermission, check_ending, spare_companions};
use super::terminal::{CliFailure, StageSpinner, ThreadArgs, pretty_text, print_json, say};
use super::wrap::landmarks::{in_names_of_file, landmarks_from_json};
use crate::asset::{FileSet, Format, Limits, Model, WrittenFiles};
use crate::deform::VolumeMode;
use crate::engine::{Deformer, DeformerLimits, OpenOptions, Transferred};
use crate::exec::Exec;
use crate::pool::Pool;
use crate::render::{PictureSize, SheetShape, ViewSheet};
use crate::wire::pb::edit_request::wrap::Landmark;
use crate::wire::{self, pb};
use clap::Args;
use glam::DVec3;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Sides of one picture of a sheet, pixels.
const SIDES: [u32; 2] = [360, 420];
/// Shapes that are drawn at most.
const MOST_DRAWN: usize = 6;

/// Arguments of `pliant transfer`.
#[derive(Debug, Args)]
pub struct TransferArgs {
    /// Model with blend shapes, or in one of two shapes: glb (or vrm), gltf or fbx; with --shape any format
    source: PathBuf,
    /// Model that they come to
    target: PathBuf,
    /// Output file: a glb; with --shape, its extension selects the format
    #[arg(short, long)]
    output: PathBuf,
    /// The source in another shape, with the same vertices and triangles: the target takes on what leads there
    #[arg(long, value_name = "MODEL")]
    shape: Option<PathBuf>,
    /// Landmarks: a JSON list of {"source": PLACE, "target": PLACE}, where a place is a vertex number or [x, y, z]
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    /// Write the report as JSON
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Draw the shapes that move most, on the source and below on the target (.png)
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

pub(super) fn run_transfer(args: &TransferArgs) -> Result<(), CliFailure> {
    let format = output_format(&args.output)?;
    if args.shape.is_none() && format != Format::GLB {
        return Err(CliFailure::Input(
            "--output: blend shapes are written as glb alone".into(),
        ));
    }
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
    let [source, target] = [&args.source, &args.target].map(|path| read_model(path));
    let (source, target) = (source?, target?);
    let shape = args.shape.as_ref().map(|path| read_model(path)).transpose()?;
    for path in args.report.iter().chain(&args.picture) {
        spare_companions(path, &args.target, &target)?;
    }
    let spinner = StageSpinner::new(args.json);
    let clock = Instant::now();
    let came = args.transfer(
        [Some(&source), Some(&target), shape.as_ref()],
        format,
        &Exec::new(&pool, &spinner),
    )?;
    spinner.finish();
    let report = wire::transfer_report(&came.report);
    let written = (args.permission).write_model(&args.output, &came.files, &args.target, &target)?;
    if let Some(path) = &args.report {
        let text = pretty_text(&wire::json::to_json(&report)?)?;
        args.permission.write_file(path, text.as_bytes())?;
    }
    if let Some(path) = &args.picture {
        args.draw(path, [Some(source), Some(target), shape], &came.files, &pool)?;
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

impl TransferArgs {
    fn transfer(
        &self,
        [source, target, shape]: [Option<&FileSet>; 3],
        format: Format,
        exec: &Exec<'_>,
    ) -> Result<Transferred, CliFailure> {
        let landmarks = match &self.landmarks {
            Some(path) => landmarks_from_json(&read_file(path)?, "source").map_err(|e| in_file(path, e))?,
            None => Vec::new(),
        };
        // In the request own places are on the model that takes, which is the target here.
        let landmarks = landmarks.into_iter().map(|of_wrap| Landmark {
            name: of_wrap.name,
            own_vertex: of_wrap.target_vertex,
            own_point: of_wrap.target_point,
            target_vertex: of_wrap.own_vertex,
            target_point: of_wrap.own_point,
        });
        let request = pb::TransferRequest {
            source: Some(pb::transfer_request::Source::Model(vec![0].into())),
            landmarks: landmarks.collect(),
            ..pb::TransferRequest::default()
        };
        let mut command = wire::transfer_order(&request, None)?.command;
        command.source.files = source.cloned().unwrap_or_default();
        command.format = Some(format);
        command.shape = shape.map(|files| crate::engine::OtherModel {
            files: files.clone(),
            ..crate::engine::OtherModel::default()
        });
        let mut options = OpenOptions::default();
        options.body.volume = VolumeMode::Off;
        let target = target.cloned().unwrap_or_default();
        let deformer = Deformer::open(target, &options, &DeformerLimits::default(), exec)?;
        let came = deformer.transfer(deformer.rest(), &command, exec);
        Ok(came.map_err(|e| in_names_of_file(e, [["own", "target"], ["target", "source"]]))?)
    }

    /// Draws source and target in their rest poses and in some shapes.
    fn draw(
        &self,
        path: &Path,
        [source, target, shape]: [Option<FileSet>; 3],
        written: &WrittenFiles,
        pool: &Pool,
    ) -> Result<(), CliFailure> {
        let mut result = FileSet::single(self.output.display().to_string(), written.main.clone());
        for (uri, bytes) in &written.companions {
            result.companions.insert(uri.clone(), bytes.clone().into());
        }
        let read = |files: FileSet, of: &Path| Model::read(files, None, &Limits::default()).map_err(|e| in_file(of, e));
        let source = read(source.unwrap_or_default(), &self.source)?;
        let result = read(result, &self.output)?;
        let rows = match shape {
            Some(shape) => {
                let target = read(target.unwrap_or_default(), &self.target)?;
                let posed = read(shape, &self.source)?;
                let (posed, now) = (posed.positions.clone(), result.positions.clone());
                [
                    (source, vec![("posed".to_owned(), posed)]),
                    (target, vec![("posed".to_owned(), now)]),
                ]
            }
            None => {
                let names = most_moving(&source)?;
                let shapes = [shapes_named(&source, &names)?, shapes_named(&result, &names)?];
                let [of_source, of_result] = shapes;
                [(source, of_source), (result, of_result)]
            }
        };
        let mut shapes = Vec::new();
        let mut surfaces = Vec::new();
        for ((model, all), name) in rows.iter().zip(["source", "target"]) {
            let mut drawn = DrawnShape::of_model(model, NormalChoice::File).map_err(|e| in_file(&self.source, e))?;
            drawn.wear_materials()?;
            surfaces.push((name.to_owned(), drawn.surface(None, DVec3::ZERO, pool)?));
            for (caption, positions) in all {
                let fits = positions.len() == model.positions.len();
                surfaces.push((
                    caption.clone(),
                    drawn.surface(fits.then_some(positions), DVec3::ZERO, pool)?,
                ));
            }
        }
        shapes.extend(surfaces.iter().map(|(caption, surface)| SheetShape {
            surface,
            caption: caption.clone(),
            marks: Vec::new(),
            near: None,
        }));
        let columns = shapes.len() / 2;
        let sheet = ViewSheet {
            shapes,
            views: &self.view.directions(self.up)?[..1],
            size: PictureSize::new(SIDES[0], SIDES[1])?,
            columns: Some(columns as u32),
            fits_each: true,
            key: None,
        };
        self.permission.write_file(path, &sheet.draw_views(pool)?.encode_png()?)
    }
}

/// The names of the shapes that move most, in the model's order.
fn most_moving(model: &Model) -> Result<Vec<String>, CliFailure> {
    let blend = model.blend_shapes().map_err(crate::engine::Error::from)?;
    let moves = |shape: &crate::asset::BlendShape| shape.moves.iter().map(|m| m.length_squared()).sum::<f32>();
    let mut order: Vec<usize> = (0..blend.shapes.len()).collect();
    order.sort_by(|a, b| {
        moves(&blend.shapes[*b])
            .total_cmp(&moves(&blend.shapes[*a]))
            .then(a.cmp(b))
    });
    order.truncate(MOST_DRAWN);
    order.sort_unstable();
    Ok(order.into_iter().map(|k| blend.shapes[k].name.clone()).collect())
}

/// Where a model is in shapes of these names.
fn shapes_named(model: &Model, names: &[String]) -> Result<Vec<(String, Vec<DVec3>)>, CliFailure> {
    let blend = model.blend_shapes().map_err(crate::engine::Error::from)?;
    let found = names.iter().map(|name| {
        let shape = blend.shapes.iter().find(|shape| shape.name == *name);
        let place = |(k, p): (usize, &DVec3)| *p + shape.map_or(DVec3::ZERO, |shape| shape.moves[k].as_dvec3());
        (name.clone(), model.positions.iter().enumerate().map(place).collect())
    });
    Ok(found.collect())
}

fn print_summary(report: &pb::TransferReport, seconds: f64) {
    if let Some(on) = report.wrap.and_then(|wrap| wrap.to_target) {
        say!(
            "the source lies on the target to {:.3} / {:.3} / {:.2} % of its diagonal (p50 / p95 / max)",
            100.0 * on.p50,
            100.0 * on.p95,
            100.0 * on.max
        );
    }
    let flipped: u32 = report.shapes.iter().map(|shape| shape.flipped_triangles).sum();
    let in_source: u32 = report.shapes.iter().map(|shape| shape.flipped_in_source).sum();
    say!(
        "{} shapes and {} clips came; they turn {flipped} triangles over, {in_source} on the source; {seconds:.1} s",
        report.shapes.len(),
        report.clips
    );
}

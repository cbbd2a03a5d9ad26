//! `pliant transfer`: blend shapes of a model come to another one; or what a model does from one shape to another.

use super::drawing::{DrawnShape, NormalChoice};
use super::input_files::{in_file, read_file, read_model};
use super::result_args::{ResultArgs, SheetLayout, read_shape};
use super::terminal::{CliFailure, print_json, say};
use super::wrap::landmarks::{in_names_of_file, landmarks_from_json};
use crate::asset::{FileSet, Format, Model, WrittenFiles};
use crate::deform::VolumeMode;
use crate::engine::{Deformer, DeformerLimits, OpenOptions, Transferred};
use crate::exec::Exec;
use crate::pool::Pool;
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
    /// The source in another shape, with the same vertices and triangles: the target takes on what leads there
    #[arg(long, value_name = "MODEL")]
    shape: Option<PathBuf>,
    /// Landmarks: a JSON list of {"source": PLACE, "target": PLACE}, where a place is a vertex number or [x, y, z]
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    #[command(flatten)]
    result: ResultArgs,
}

pub(super) fn run_transfer(args: &TransferArgs) -> Result<(), CliFailure> {
    let format = args.result.checked_format()?;
    if args.shape.is_none() && format != Format::GLB {
        return Err(CliFailure::Input(
            "--output: blend shapes are written as glb alone".into(),
        ));
    }
    let pool = args.result.compute.threads.start_pool()?;
    let [source, target] = [&args.source, &args.target].map(|path| read_model(path));
    let (source, target) = (source?, target?);
    let shape = args.shape.as_ref().map(|path| read_model(path)).transpose()?;
    args.result.spare(&args.target, &target)?;
    let spinner = args.result.compute.show_stages(args.result.json);
    let clock = Instant::now();
    let came = args.transfer(
        [Some(&source), Some(&target), shape.as_ref()],
        format,
        &Exec::new(&pool, &spinner),
    )?;
    spinner.finish();
    let report = wire::transfer_report(&came.report);
    let written = (args.result).write_model(&came.files, &args.target, &target)?;
    args.result.write_report(&report)?;
    if let Some(path) = &args.result.picture {
        args.draw(path, [Some(source), Some(target), shape], &came.files, &pool)?;
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
        let source = read_shape(source.unwrap_or_default(), &self.source)?;
        let result = self.result.result(written)?;
        let rows = match shape {
            Some(shape) => {
                let target = read_shape(target.unwrap_or_default(), &self.target)?;
                let posed = read_shape(shape, &self.source)?;
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
        let layout = SheetLayout {
            sides: SIDES,
            columns: surfaces.len() / 2,
            is_one_view: true,
        };
        self.result.draw(path, &surfaces, &layout, pool)
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

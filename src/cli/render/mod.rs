//! `pliant render`: a picture of a model or several, drawn without a display.

mod colours;
mod cutaway;
mod input;

use super::drawing::{
    CloseUp, NormalChoice, SeenShape, UpAxisChoice, ViewList, bounds_of, parse_close_up, parse_size, parse_views,
};
use super::output_files::{OutputPermission, check_ending, spare_companions};
use super::terminal::{CliFailure, ThreadArgs, say};
use crate::mesh::BoundingBox;
use crate::pool::Pool;
use crate::render::{self, CloseView, Picture, PictureSize, RingMark, SheetShape, ViewDirection, ViewSheet};
use clap::Args;
use colours::{ColourChoice, ColourScale, Measured, choose_colours};
use cutaway::draw_cutaway;
use input::ModelToDraw;
use std::path::PathBuf;

/// Marked places are at least this share of the diagonal apart.
const APART: f64 = 0.06;
/// Most models of one picture.
const MOST_MODELS: usize = 64;

/// Arguments of `pliant render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Model files: glb (or vrm), gltf, obj, ply, off, stl, 3mf, fbx, splat or spz; several, up to 64, are drawn side by side by one camera
    #[arg(required = true, value_name = "MODEL")]
    models: Vec<PathBuf>,
    /// Output picture (.png)
    #[arg(short, long, value_name = "PICTURE")]
    output: PathBuf,
    #[command(flatten)]
    permission: OutputPermission,
    /// Earlier state of the models, drawn beside them by the same camera
    #[arg(long, value_name = "REST", alias = "rest")]
    before: Option<PathBuf>,
    /// Draw only this primitive, by name or by its number in `pliant inspect`; repeatable. Without, coarser levels of detail and hulls
    /// for collisions, by their names, are left out
    #[arg(long, value_name = "NAME", conflicts_with = "rig")]
    primitive: Vec<String>,
    /// Meaning of the colours [default: distortion with --before if the vertices match, else material if the model has base
    /// colours, else plain]
    #[arg(long, value_enum, alias = "colour")]
    color: Option<ColourChoice>,
    /// Normals that shade the surface
    #[arg(long, value_enum, default_value_t = NormalChoice::File)]
    normals: NormalChoice,
    /// Size of one view in pixels, 16 to 8192 each way
    #[arg(long, value_name = "WxH", default_value = "800x600", value_parser = parse_size)]
    size: PictureSize,
    /// Views: degrees around the up axis and above the horizon, or front, back, left, right (side), top, bottom, three-quarter;
    /// several, up to 64, with commas between them
    #[arg(long, value_name = "VIEWS", default_value = "30,20", value_parser = parse_views)]
    #[arg(allow_hyphen_values = true)]
    view: ViewList,
    /// Up axis of the model
    #[arg(long, value_enum, default_value_t = UpAxisChoice::Y)]
    up: UpAxisChoice,
    /// Number of views, in a strip, once around the up axis
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=64))]
    turntable: Option<u32>,
    /// Models in a row [default: as many as make a picture of usual sides; 1 with several views]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    columns: Option<u32>,
    /// Let each model fill its own views; without, all have one scale
    #[arg(long)]
    fit_each: bool,
    /// Show only the surroundings of a place: worst (where colours stand for the most), vertex:N, X,Y,Z, the name of a node or
    /// primitive, each with a radius in model units behind a comma if wanted, or box:X,Y,Z,X,Y,Z
    #[arg(long, value_name = "PLACE", value_parser = parse_close_up, allow_hyphen_values = true)]
    close_up: Option<CloseUp>,
    /// Draw the triangle edges too
    #[arg(long)]
    wire: bool,
    /// Distance (difference) or factor (distortion) at the end of the colour scale; use one value to compare pictures
    /// [default: the largest distance; 1.5]
    #[arg(long, value_name = "NUMBER", value_parser = parse_above_zero)]
    range: Option<f64>,
    /// Rig file: draw a cut-away with the nodes that the rig drives, rotations green and positions orange
    #[arg(long, value_name = "RIG")]
    #[arg(conflicts_with_all = ["before", "color", "turntable", "wire", "range", "marks", "columns", "fit_each", "close_up"])]
    rig: Option<PathBuf>,
    /// Number of rings around the places that differ most
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=9))]
    marks: u32,
    #[command(flatten)]
    threads: ThreadArgs,
}

fn parse_above_zero(text: &str) -> Result<f64, String> {
    let number = text.trim().parse::<f64>().ok().filter(|x| x.is_finite() && *x > 0.0);
    number.ok_or_else(|| "a finite number above 0 is needed".into())
}

pub(super) fn run_render(args: &RenderArgs) -> Result<(), CliFailure> {
    check_ending(&args.output, "png", "a picture")?;
    args.permission.check_target(&args.output)?;
    if args.models.len() > MOST_MODELS {
        let problem = format!(
            "{} models are named, at most {MOST_MODELS} are drawn",
            args.models.len()
        );
        return Err(CliFailure::Input(problem));
    }
    let pool = args.threads.start_pool()?;
    let views = args.views()?;
    if let Some(rig) = &args.rig {
        let (picture, reported) = match (args.models.as_slice(), views.as_slice()) {
            ([model], [view]) => draw_cutaway(model, rig, *view, args.size, &pool)?,
            _ => return Err(CliFailure::Input("--rig draws one model from one side".into())),
        };
        return args.write_picture(&picture, &format!(", {reported}"));
    }
    let open = |path| ModelToDraw::open(path, args.normals);
    let mut models = args.models.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    let mut before = args.before.as_ref().map(open).transpose()?;
    for drawn in before.iter().chain(&models) {
        spare_companions(&args.output, drawn.path, &drawn.model.files)?;
    }
    let mut colour = choose_colours(args.color, &models, before.as_ref())?;
    if colour == ColourChoice::Material {
        for drawn in before.iter_mut().chain(&mut models) {
            drawn.wear_materials()?;
        }
        if args.color.is_none() && models.iter().all(|m| m.shape.is_bare()) {
            colour = ColourChoice::Plain;
        }
    }
    for drawn in before.iter_mut().chain(&mut models) {
        drawn.keep_primitives(&args.primitive)?;
    }
    let (picture, words) = args.draw_sheet(&models, before.as_ref(), colour, &views, &pool)?;
    args.write_picture(&picture, &words)
}

impl RenderArgs {
    /// Draws all shapes from all sides; the text counts what crosses.
    fn draw_sheet(
        &self,
        models: &[ModelToDraw<'_>],
        before: Option<&ModelToDraw<'_>>,
        colour: ColourChoice,
        views: &[ViewDirection],
        pool: &Pool,
    ) -> Result<(Picture, String), CliFailure> {
        let has_rest = before.is_some();
        let measure = |m: &ModelToDraw<'_>| Measured::of(m, before, colour, pool);
        let measured = models.iter().map(measure).collect::<Result<Vec<_>, _>>()?;
        let scale = ColourScale::of(colour, &measured, self.range, has_rest)?;
        let shown: Vec<&ModelToDraw<'_>> = before.into_iter().chain(models).collect();
        let own = |k: usize| k.checked_sub(shown.len() - models.len()).map(|k| &measured[k]);
        let names = captions(&models.iter().map(|m| m.path.display().to_string()).collect::<Vec<_>>());
        let sizes: Vec<Vec<f64>> = (0..shown.len())
            .map(|k| own(k).map_or(Vec::new(), |m| m.sizes(shown[k])))
            .collect();
        let near = self.near_places(&shown, &sizes)?;
        let mut surfaces = Vec::with_capacity(shown.len());
        for (k, drawn) in shown.iter().enumerate() {
            let surface = own(k).unwrap_or(&Measured::Nothing).paint(drawn, &scale, pool)?;
            let has_wires = self.wire || colour == ColourChoice::Wire;
            surfaces.push(if has_wires { surface.with_wires() } else { surface });
        }
        let mut words = String::new();
        let mut shapes = Vec::with_capacity(shown.len());
        for (k, (drawn, surface)) in shown.iter().zip(&surfaces).enumerate() {
            let (mut caption, counted) = match own(k) {
                None => ("before".to_owned(), None),
                Some(own) if models.len() > 1 => (names[k + models.len() - shown.len()].clone(), own.words(has_rest)),
                Some(own) if has_rest => ("after".to_owned(), own.words(has_rest)),
                Some(own) => (String::new(), own.words(has_rest)),
            };
            if let Some(counted) = counted {
                words += &format!(", {counted}");
                caption = if caption.is_empty() {
                    counted
                } else {
                    format!("{caption}: {counted}")
                };
            }
            shapes.push(SheetShape {
                surface,
                caption,
                marks: self.marks_of(drawn, own(k).map(|_| &sizes[k]))?,
                near: near[k],
            });
        }
        let sheet = ViewSheet {
            shapes,
            views,
            size: self.size,
            columns: self.columns,
            fits_each: self.fit_each,
            key: scale.key,
        };
        Ok((sheet.draw_views(pool)?, words))
    }

    /// Rings around the places of a shape where its sizes are largest; `None` for the shape that others are compared with.
    fn marks_of(&self, drawn: &ModelToDraw<'_>, sizes: Option<&Vec<f64>>) -> Result<Vec<RingMark>, CliFailure> {
        match (self.marks, sizes) {
            (0, _) | (_, None) => Ok(Vec::new()),
            (_, Some(sizes)) if sizes.is_empty() => {
                let problem =
                    "--marks points at where two shapes differ; ask for --color difference, distortion or crossings";
                Err(CliFailure::Input(problem.into()))
            }
            (count, Some(sizes)) => {
                let positions = &drawn.model.positions;
                let apart = APART * BoundingBox::of(positions).diagonal();
                Ok(RingMark::at_largest_values(positions, sizes, count as usize, apart))
            }
        }
    }

    /// The place of each shape that is shown from near by; all with one radius, so that they can be compared.
    fn near_places(
        &self,
        shown: &[&ModelToDraw<'_>],
        sizes: &[Vec<f64>],
    ) -> Result<Vec<Option<CloseView>>, CliFailure> {
        let Some(wanted) = &self.close_up else {
            return Ok(vec![None; shown.len()]);
        };
        let mut places = Vec::with_capacity(shown.len());
        let bounds = bounds_of(shown.iter().map(|drawn| &drawn.model.positions[..]));
        // What has no worst place of its own shows that of the first that has one.
        let measured = sizes.iter().position(|own| !own.is_empty());
        for (k, drawn) in shown.iter().enumerate() {
            let nodes = drawn.nodes()?;
            let of = |k: usize, marks| SeenShape {
                positions: &shown[k].model.positions,
                primitives: &shown[k].model.primitives,
                values: &sizes[k],
                marks,
                bounds,
            };
            let settled = match measured {
                Some(other) if sizes[k].is_empty() => wanted.settled_in(&of(other, &[]))?,
                _ => wanted.clone(),
            };
            places.push(
                settled
                    .place_in(&of(k, &nodes))
                    .map_err(|e| e.in_place(drawn.path.display()))?,
            );
        }
        let radius = places.iter().map(|place| place.radius).fold(0.0, f64::max);
        let one = |place: CloseView| match self.fit_each {
            true => place,
            false => CloseView { radius, ..place },
        };
        Ok(places.into_iter().map(|place| Some(one(place))).collect())
    }

    /// All directions, those of a turntable from the first view on.
    fn views(&self) -> Result<Vec<ViewDirection>, CliFailure> {
        let named = self.view.directions(self.up)?;
        match (self.turntable, named.as_slice()) {
            (None, _) => Ok(named),
            (Some(count), [first]) => Ok((0..count)
                .map(|k| first.turned_by(360.0 * f64::from(k) / f64::from(count)))
                .collect()),
            (Some(_), _) => Err(CliFailure::Input("--turntable begins at one --view".into())),
        }
    }

    /// Writes and reports the picture.
    fn write_picture(&self, picture: &Picture, more: &str) -> Result<(), CliFailure> {
        self.permission.write_file(&self.output, &picture.encode_png()?)?;
        let drawn = match self.models.as_slice() {
            [one] => one.display().to_string(),
            several => format!("{} models", several.len()),
        };
        say!(
            "{drawn} -> {}, {}x{} pixels{more}",
            self.output.display(),
            picture.width(),
            picture.height()
        );
        Ok(())
    }
}

/// What each path is called on a sheet: the names of the files, or the paths where two have one name.
fn captions(paths: &[String]) -> Vec<String> {
    let name = |path: &String| path.rsplit('/').next().unwrap_or(path).to_owned();
    let names: Vec<String> = paths.iter().map(name).collect();
    let is_alone = |k: usize| names.iter().filter(|n| **n == names[k]).count() == 1;
    (0..paths.len())
        .map(|k| {
            if is_alone(k) {
                names[k].clone()
            } else {
                paths[k].clone()
            }
        })
        .collect()
}

impl From<render::Error> for CliFailure {
    fn from(e: render::Error) -> Self {
        match e {
            render::Error::Png(_) => Self::Internal(e.to_string()),
            other => Self::Input(other.to_string()),
        }
    }
}

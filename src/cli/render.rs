//! `pliant render`: a picture of a model, drawn without a display.

use super::files::{read_model, write_file};
use super::{Failure, Threads};
use crate::asset::{Limits, Model};
use crate::mesh::BoundingBox;
use crate::pool::Pool;
use crate::render::{
    self, Key, Mark, Plate, Ramp, STRETCH_RANGE, Size, Surface, Up, View, displacements, edge_stretch,
};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

/// Marked places are at least this share of the diagonal apart.
const APART: f64 = 0.06;

/// Arguments of `pliant render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// The model: glb, gltf, obj, ply, off or stl
    model: PathBuf,
    /// Where to write the picture, a png file
    #[arg(short, long, value_name = "PICTURE")]
    output: PathBuf,
    /// The model as it was before: drawn beside, by the same camera
    #[arg(long, value_name = "REST")]
    before: Option<PathBuf>,
    /// What colours show [default: distortion with --before where the vertices agree, else plain]
    #[arg(long, value_enum, alias = "colour")]
    color: Option<Color>,
    /// Pixels of one view, 16 to 8192 each way
    #[arg(long, value_name = "WxH", default_value = "800x600", value_parser = size)]
    size: Size,
    /// Degrees around the up axis and above the horizon
    #[arg(long, value_name = "AZIMUTH,ELEVATION", default_value = "30,20", value_parser = angles)]
    #[arg(allow_hyphen_values = true)]
    view: [f64; 2],
    /// The axis of the model that points up
    #[arg(long, value_enum, default_value_t = Axis::Y)]
    up: Axis,
    /// A strip of N views, once around the up axis
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=64))]
    turntable: Option<u32>,
    /// Draw the edges of the triangles too, over any colours
    #[arg(long)]
    wire: bool,
    /// The distance (difference) or factor (distortion) at the end of the colours, so that pictures can be compared
    /// [default: the largest distance; 1.5]
    #[arg(long, value_name = "NUMBER", value_parser = above_zero)]
    range: Option<f64>,
    /// Rings around the N places that differ most
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=9))]
    marks: u32,
    #[command(flatten)]
    threads: Threads,
}

/// What colours show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Color {
    /// Edges longer (red) or shorter (blue) than before
    Distortion,
    /// How far vertices lie from where they were before
    Difference,
    /// Nothing but the shape
    Plain,
    /// The shape and its triangles
    Wire,
}

/// An axis that can point up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Axis {
    Y,
    Z,
}

fn size(text: &str) -> Result<Size, String> {
    let sides = text.split_once(['x', 'X']);
    let number = |side: &str| side.trim().parse::<u32>().ok();
    match sides.and_then(|(w, h)| Some((number(w)?, number(h)?))) {
        Some((w, h)) => Size::new(w, h).map_err(|e| e.to_string()),
        None => Err("two whole numbers with an x between them are needed, such as 800x600".into()),
    }
}

fn above_zero(text: &str) -> Result<f64, String> {
    let number = text.trim().parse::<f64>().ok().filter(|x| x.is_finite() && *x > 0.0);
    number.ok_or_else(|| "a finite number above 0 is needed".into())
}

fn angles(text: &str) -> Result<[f64; 2], String> {
    let parts = text.split_once(',');
    let number = |part: &str| part.trim().parse::<f64>().ok();
    match parts.and_then(|(a, e)| Some([number(a)?, number(e)?])) {
        // Whether they are in range does not depend on the up axis.
        Some([a, e]) => View::new(a, e, Up::Y).map(|_| [a, e]).map_err(|e| e.to_string()),
        None => Err("two numbers with a comma between them are needed, such as 30,20".into()),
    }
}

/// A model and where it came from, for texts.
struct Read<'a> {
    path: &'a Path,
    model: Model,
}

impl<'a> Read<'a> {
    fn open(path: &'a Path) -> Result<Self, Failure> {
        let files = read_model(path)?;
        let model = Model::read(files, None, &Limits::default())
            .map_err(|e| Failure::Input(format!("{}: {e}", path.display())))?;
        Ok(Self { path, model })
    }

    fn vertices(&self) -> usize {
        self.model.positions.len()
    }

    fn surface(&self, pool: &Pool) -> Result<Surface, Failure> {
        let surface = Surface::new(&self.model.positions, &self.model.triangles, pool);
        surface.map_err(|e| Failure::Input(format!("{}: {e}", self.path.display())))
    }
}

/// Runs the command.
pub(super) fn run(args: &RenderArgs) -> Result<(), Failure> {
    let is_png = args.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
    if !is_png {
        let problem = "a picture is written as png, its extension must say so";
        return Err(Failure::Input(format!("{}: {problem}", args.output.display())));
    }
    let pool = args.threads.pool()?;
    let model = Read::open(&args.model)?;
    let before = args.before.as_deref().map(Read::open).transpose()?;
    let colour = choose(args.color, &model, before.as_ref())?;
    let Coloured { mut shape, key, values } = coloured(&model, before.as_ref(), colour, args.range, &pool)?;
    let marks = match args.marks {
        0 => Vec::new(),
        _ if values.is_empty() => {
            let problem = "--marks points at where two shapes differ; ask for --color difference or distortion";
            return Err(Failure::Input(problem.into()));
        }
        count => {
            let positions = &model.model.positions;
            let apart = APART * BoundingBox::of(positions).diagonal();
            let sizes: Vec<f64> = values.iter().map(|x| x.abs()).collect();
            Mark::largest(positions, &sizes, count as usize, apart)
        }
    };
    let mut before = before.as_ref().map(|b| b.surface(&pool)).transpose()?;
    if args.wire || colour == Color::Wire {
        shape = shape.with_wires();
        before = before.map(Surface::with_wires);
    }
    let up = match args.up {
        Axis::Y => Up::Y,
        Axis::Z => Up::Z,
    };
    let first = View::new(args.view[0], args.view[1], up)?;
    let count = args.turntable.unwrap_or(1);
    let views: Vec<View> = (0..count)
        .map(|k| first.turned(360.0 * f64::from(k) / f64::from(count)))
        .collect();
    let plate = Plate {
        before: before.as_ref(),
        shape: &shape,
        views: &views,
        size: args.size,
        key,
        marks,
    };
    let picture = plate.draw(&pool)?;
    write_file(&args.output, &picture.png()?)?;
    eprintln!(
        "{} -> {}, {}x{} pixels",
        args.model.display(),
        args.output.display(),
        picture.width(),
        picture.height()
    );
    Ok(())
}

/// The colours to draw: those asked for where they make sense.
fn choose(asked: Option<Color>, model: &Read<'_>, before: Option<&Read<'_>>) -> Result<Color, Failure> {
    let needs_before = |colour: &Color| matches!(colour, Color::Distortion | Color::Difference);
    let agree = before.is_some_and(|b| b.vertices() == model.vertices());
    match (asked, before) {
        (Some(colour), None) if needs_before(&colour) => {
            let name = if colour == Color::Distortion {
                "distortion"
            } else {
                "difference"
            };
            Err(Failure::Input(format!(
                "--color {name} compares two shapes; name the other one with --before REST"
            )))
        }
        (Some(colour), Some(before)) if needs_before(&colour) && !agree => Err(Failure::Input(format!(
            "{} has {} vertices and {} has {}; colours compare models with as many vertices in the same order",
            model.path.display(),
            model.vertices(),
            before.path.display(),
            before.vertices()
        ))),
        (Some(colour), _) => Ok(colour),
        (None, Some(_)) if agree => Ok(Color::Distortion),
        (None, _) => Ok(Color::Plain),
    }
}

/// A shape in its colours.
struct Coloured {
    shape: Surface,
    key: Option<Key>,
    /// What the colours say, one for each vertex; empty without colours.
    values: Vec<f64>,
}

fn coloured(
    model: &Read<'_>,
    before: Option<&Read<'_>>,
    colour: Color,
    range: Option<f64>,
    pool: &Pool,
) -> Result<Coloured, Failure> {
    let shape = model.surface(pool)?;
    let (now, triangles) = (&model.model.positions, &model.model.triangles);
    let (values, ramp, unit, key) = match (colour, before) {
        (Color::Distortion, Some(before)) => {
            let factor = range.unwrap_or(STRETCH_RANGE);
            if factor <= 1.0 {
                let problem = "of distortion it is a factor, which must be above 1";
                return Err(Failure::Input(format!("--range is {factor}; {problem}")));
            }
            let values = edge_stretch(&before.model.positions, now, triangles)?;
            // Values are logarithms to the base of STRETCH_RANGE.
            let unit = libm::log(factor) / libm::log(STRETCH_RANGE);
            (values, Ramp::Stretch, unit, Key::stretch(factor))
        }
        (Color::Difference, Some(before)) => {
            let values = displacements(&before.model.positions, now)?;
            let most = range.unwrap_or_else(|| values.iter().copied().fold(0.0, f64::max));
            let unit = if most > 0.0 { most } else { 1.0 };
            (values, Ramp::Amount, unit, Key::distance(most))
        }
        _ => {
            return Ok(Coloured {
                shape,
                key: None,
                values: Vec::new(),
            });
        }
    };
    let colours: Vec<_> = values.iter().map(|x| ramp.light(x / unit)).collect();
    Ok(Coloured {
        shape: shape.coloured(&colours)?,
        key: Some(key),
        values,
    })
}

impl From<render::Error> for Failure {
    fn from(e: render::Error) -> Self {
        match e {
            render::Error::Png(_) => Self::Internal(e.to_string()),
            other => Self::Input(other.to_string()),
        }
    }
}

//! `pliant render`: a picture of a model, drawn without a display.

use super::input_files::{in_file, open_model, read_file};
use super::output_files::{OutputPermission, check_ending, spare_companions};
use super::terminal::{CliFailure, ThreadArgs, listed};
use crate::asset::{Geometry, Model, Primitive, SurfaceLook};
use crate::engine::{Deformer, DeformerLimits, OpenOptions, RigNodes, left_out_passengers};
use crate::exec::Exec;
use crate::mesh::BoundingBox;
use crate::pool::Pool;
use crate::progress::Silent;
use crate::render::{
    self, Camera, ColourKey, ColourRamp, DrawnBall, POSITION_COLOUR, Picture, PictureSize, ROTATION_COLOUR, RingMark,
    STRETCH_RANGE, ShadedSurface, SurfaceDress, UpAxis, ViewDirection, ViewSheet, draw_surface, edge_stretch,
    open_surface, vertex_displacements,
};
use crate::wire;
use clap::{Args, ValueEnum};
use glam::DVec3;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Marked places are at least this share of the diagonal apart.
const APART: f64 = 0.06;

/// Arguments of `pliant render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Model file: glb, gltf, obj, ply, off, stl or fbx
    model: PathBuf,
    /// Output picture (.png)
    #[arg(short, long, value_name = "PICTURE")]
    output: PathBuf,
    #[command(flatten)]
    permission: OutputPermission,
    /// Earlier state of the model, drawn beside it by the same camera
    #[arg(long, value_name = "REST")]
    before: Option<PathBuf>,
    /// Draw only this primitive, by name or by its number in `pliant inspect`; repeatable
    #[arg(long, value_name = "NAME", conflicts_with = "rig")]
    primitive: Vec<String>,
    /// Meaning of the colours [default: distortion with --before if the vertices match, else material if the model has base
    /// colours, else plain]
    #[arg(long, value_enum, alias = "colour")]
    color: Option<ColourChoice>,
    /// Size of one view in pixels, 16 to 8192 each way
    #[arg(long, value_name = "WxH", default_value = "800x600", value_parser = parse_size)]
    size: PictureSize,
    /// View: degrees around the up axis and above the horizon, or a name such as front
    #[arg(long, value_name = "AZIMUTH,ELEVATION", default_value = "30,20", value_parser = parse_angles)]
    #[arg(allow_hyphen_values = true)]
    view: [f64; 2],
    /// Up axis of the model
    #[arg(long, value_enum, default_value_t = UpAxisChoice::Y)]
    up: UpAxisChoice,
    /// Number of views, in a strip, once around the up axis
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=64))]
    turntable: Option<u32>,
    /// Draw the triangle edges too
    #[arg(long)]
    wire: bool,
    /// Distance (difference) or factor (distortion) at the end of the colour scale; use one value to compare pictures
    /// [default: the largest distance; 1.5]
    #[arg(long, value_name = "NUMBER", value_parser = parse_above_zero)]
    range: Option<f64>,
    /// Rig file: draw a cut-away with the nodes that the rig drives, rotations green and positions orange
    #[arg(long, value_name = "RIG", conflicts_with_all = ["before", "color", "turntable", "wire", "range", "marks"])]
    rig: Option<PathBuf>,
    /// Number of rings around the places that differ most
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=9))]
    marks: u32,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// What colours show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ColourChoice {
    /// Edges longer (red) or shorter (blue) than before
    Distortion,
    /// Distance of each vertex from its place before
    Difference,
    /// The model's own base colours: materials, textures, vertex colours
    Material,
    /// The shape only
    Plain,
    /// The shape and its triangles
    Wire,
}

/// An axis that can point up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum UpAxisChoice {
    Y,
    Z,
}

pub(super) fn parse_size(text: &str) -> Result<PictureSize, String> {
    let sides = text.split_once(['x', 'X']);
    let number = |side: &str| side.trim().parse::<u32>().ok();
    match sides.and_then(|(w, h)| Some((number(w)?, number(h)?))) {
        Some((w, h)) => PictureSize::new(w, h).map_err(|e| e.to_string()),
        None => Err("two whole numbers with an x between them are needed, such as 800x600".into()),
    }
}

fn parse_above_zero(text: &str) -> Result<f64, String> {
    let number = text.trim().parse::<f64>().ok().filter(|x| x.is_finite() && *x > 0.0);
    number.ok_or_else(|| "a finite number above 0 is needed".into())
}

/// Views by the names that modelling programs have for them; right is the side that faces +x.
const NAMED_VIEWS: [(&str, [f64; 2]); 7] = [
    ("front", [0.0, 0.0]),
    ("back", [180.0, 0.0]),
    ("side", [90.0, 0.0]),
    ("right", [90.0, 0.0]),
    ("left", [-90.0, 0.0]),
    ("top", [0.0, 90.0]),
    ("bottom", [0.0, -90.0]),
];

pub(super) fn parse_angles(text: &str) -> Result<[f64; 2], String> {
    if let Some((_, angles)) = NAMED_VIEWS.iter().find(|(name, _)| *name == text) {
        return Ok(*angles);
    }
    let parts = text.split_once(',');
    let number = |part: &str| part.trim().parse::<f64>().ok();
    match parts.and_then(|(a, e)| Some([number(a)?, number(e)?])) {
        // Whether they are in range does not depend on the up axis.
        Some([a, e]) => ViewDirection::new(a, e, UpAxis::Y)
            .map(|_| [a, e])
            .map_err(|e| e.to_string()),
        None => {
            let names = NAMED_VIEWS.map(|(name, _)| name).join(", ");
            Err(format!(
                "allowed are two numbers with a comma between them, such as 30,20, and {names}"
            ))
        }
    }
}

/// A model to draw, with the path that it came from, for texts.
struct ModelToDraw<'a> {
    path: &'a Path,
    model: Model,
    /// What it looks like, and the model that this is said of; `None` when it says nothing of looks.
    look: Option<(Model, SurfaceLook)>,
}

impl<'a> ModelToDraw<'a> {
    fn open_model(path: &'a Path) -> Result<Self, CliFailure> {
        Ok(Self {
            path,
            model: open_model(path)?,
            look: None,
        })
    }

    /// Finds out what the model looks like.
    fn read_look(&mut self) -> Result<(), CliFailure> {
        let look = self.model.surface_look();
        self.look = look.map_err(|e| in_file(self.path, e))?;
        Ok(())
    }

    /// Takes all primitives but those that are named out of sight.
    fn keep_primitives(&mut self, names: &[String]) -> Result<(), CliFailure> {
        if names.is_empty() {
            return Ok(());
        }
        let refuse = |e: CliFailure| e.in_place(self.path.display());
        let chosen = choose_primitives(&self.model.primitives, names).map_err(refuse)?;
        if let Some((drawn, _)) = &mut self.look {
            // Read from what the model was written as, it may have others.
            let same = drawn.primitives.len() == self.model.primitives.len();
            let theirs = if same {
                chosen.clone()
            } else {
                choose_primitives(&drawn.primitives, names).map_err(refuse)?
            };
            keep_in_sight(&mut drawn.geometry, &theirs);
        }
        keep_in_sight(&mut self.model.geometry, &chosen);
        Ok(())
    }

    fn vertex_count(&self) -> usize {
        self.model.positions.len()
    }

    fn make_surface(&self, pool: &Pool) -> Result<ShadedSurface, CliFailure> {
        let surface = ShadedSurface::new(&self.model.positions, &self.model.triangles, pool);
        surface.map_err(|e| in_file(self.path, e))
    }

    /// The surface in its own base colours, where it has any.
    fn make_dressed_surface(&self, pool: &Pool) -> Result<ShadedSurface, CliFailure> {
        let Some((model, look)) = &self.look else {
            return self.make_surface(pool);
        };
        let refuse = |e: render::Error| in_file(self.path, e);
        let surface = ShadedSurface::new(&model.positions, &model.triangles, pool).map_err(refuse)?;
        let mut faults = Vec::new();
        let dress = SurfaceDress::of_model(look, &model.primitives, &model.triangles, &mut faults).map_err(refuse)?;
        for fault in faults {
            eprintln!("warning: {}: {fault}", self.path.display());
        }
        Ok(surface.with_dress(dress))
    }
}

pub(super) fn run_render(args: &RenderArgs) -> Result<(), CliFailure> {
    check_ending(&args.output, "png", "a picture")?;
    args.permission.check_target(&args.output)?;
    let pool = args.threads.start_pool()?;
    if let Some(rig) = &args.rig {
        let (picture, reported) = draw_cutaway(&args.model, rig, args.first_view()?, args.size, &pool)?;
        return args.write_picture(&picture, &format!(", {reported}"));
    }
    let mut model = ModelToDraw::open_model(&args.model)?;
    let mut before = args.before.as_deref().map(ModelToDraw::open_model).transpose()?;
    for drawn in before.iter().chain([&model]) {
        spare_companions(&args.output, drawn.path, &drawn.model.files)?;
    }
    let mut colour = choose_colours(args.color, &model, before.as_ref())?;
    if colour == ColourChoice::Material {
        for drawn in before.iter_mut().chain([&mut model]) {
            drawn.read_look()?;
        }
        if args.color.is_none() && model.look.is_none() {
            colour = ColourChoice::Plain;
        }
    }
    for drawn in before.iter_mut().chain([&mut model]) {
        drawn.keep_primitives(&args.primitive)?;
    }
    let ColouredShape { mut shape, key, values } = colour_shape(&model, before.as_ref(), colour, args.range, &pool)?;
    let marks = match args.marks {
        0 => Vec::new(),
        _ if values.is_empty() => {
            let problem = "--marks points at where two shapes differ; ask for --color difference or distortion";
            return Err(CliFailure::Input(problem.into()));
        }
        count => {
            let positions = &model.model.positions;
            let apart = APART * BoundingBox::of(positions).diagonal();
            let sizes: Vec<f64> = values.iter().map(|x| x.abs()).collect();
            RingMark::at_largest_values(positions, &sizes, count as usize, apart)
        }
    };
    let in_own_colours = colour == ColourChoice::Material;
    let make_before = |b: &ModelToDraw<'_>| match in_own_colours {
        true => b.make_dressed_surface(&pool),
        false => b.make_surface(&pool),
    };
    let mut before = before.as_ref().map(make_before).transpose()?;
    if args.wire || colour == ColourChoice::Wire {
        shape = shape.with_wires();
        before = before.map(ShadedSurface::with_wires);
    }
    let first = args.first_view()?;
    let count = args.turntable.unwrap_or(1);
    let views: Vec<ViewDirection> = (0..count)
        .map(|k| first.turned_by(360.0 * f64::from(k) / f64::from(count)))
        .collect();
    let sheet = ViewSheet {
        before: before.as_ref(),
        shape: &shape,
        views: &views,
        size: args.size,
        key,
        marks,
    };
    let picture = sheet.draw_views(&pool)?;
    args.write_picture(&picture, "")
}

impl RenderArgs {
    /// The direction of the first view.
    fn first_view(&self) -> Result<ViewDirection, CliFailure> {
        let up = match self.up {
            UpAxisChoice::Y => UpAxis::Y,
            UpAxisChoice::Z => UpAxis::Z,
        };
        Ok(ViewDirection::new(self.view[0], self.view[1], up)?)
    }

    /// Writes and reports the picture.
    fn write_picture(&self, picture: &Picture, more: &str) -> Result<(), CliFailure> {
        self.permission.write_file(&self.output, &picture.encode_png()?)?;
        eprintln!(
            "{} -> {}, {}x{} pixels{more}",
            self.model.display(),
            self.output.display(),
            picture.width(),
            picture.height()
        );
        Ok(())
    }
}

/// Chooses the colours to draw: those asked for where they make sense.
fn choose_colours(
    asked: Option<ColourChoice>,
    model: &ModelToDraw<'_>,
    before: Option<&ModelToDraw<'_>>,
) -> Result<ColourChoice, CliFailure> {
    let needs_before = |colour: &ColourChoice| matches!(colour, ColourChoice::Distortion | ColourChoice::Difference);
    let agree = before.is_some_and(|b| b.vertex_count() == model.vertex_count());
    match (asked, before) {
        (Some(colour), None) if needs_before(&colour) => {
            let name = match colour {
                ColourChoice::Distortion => "distortion",
                _ => "difference",
            };
            Err(CliFailure::Input(format!(
                "--color {name} compares two shapes; name the other one with --before REST"
            )))
        }
        (Some(colour), Some(before)) if needs_before(&colour) && !agree => Err(CliFailure::Input(format!(
            "{} has {} vertices and {} has {}; colours compare models with as many vertices in the same order",
            model.path.display(),
            model.vertex_count(),
            before.path.display(),
            before.vertex_count()
        ))),
        (Some(colour), _) => Ok(colour),
        (None, Some(_)) if agree => Ok(ColourChoice::Distortion),
        (None, _) => Ok(ColourChoice::Material),
    }
}

/// A coloured shape is a surface with the key to its colours.
struct ColouredShape {
    shape: ShadedSurface,
    key: Option<ColourKey>,
    /// What the colours say, one for each vertex; empty without colours.
    values: Vec<f64>,
}

fn colour_shape(
    model: &ModelToDraw<'_>,
    before: Option<&ModelToDraw<'_>>,
    colour: ColourChoice,
    range: Option<f64>,
    pool: &Pool,
) -> Result<ColouredShape, CliFailure> {
    let shape = match colour {
        ColourChoice::Material => model.make_dressed_surface(pool)?,
        _ => model.make_surface(pool)?,
    };
    let (now, triangles) = (&model.model.positions, &model.model.triangles);
    let (values, ramp, unit, key) = match (colour, before) {
        (ColourChoice::Distortion, Some(before)) => {
            let factor = range.unwrap_or(STRETCH_RANGE);
            if factor <= 1.0 {
                let problem = "of distortion it is a factor, which must be above 1";
                return Err(CliFailure::Input(format!("--range is {factor}; {problem}")));
            }
            let values = edge_stretch(&before.model.positions, now, triangles)?;
            // Values are logarithms to the base of STRETCH_RANGE.
            let unit = libm::log(factor) / libm::log(STRETCH_RANGE);
            (values, ColourRamp::Stretch, unit, ColourKey::for_stretch(factor))
        }
        (ColourChoice::Difference, Some(before)) => {
            let values = vertex_displacements(&before.model.positions, now)?;
            let most = range.unwrap_or_else(|| values.iter().copied().fold(0.0, f64::max));
            let unit = if most > 0.0 { most } else { 1.0 };
            (values, ColourRamp::Amount, unit, ColourKey::for_distance(most))
        }
        _ => {
            return Ok(ColouredShape {
                shape,
                key: None,
                values: Vec::new(),
            });
        }
    };
    let colours: Vec<_> = values.iter().map(|x| ramp.linear_colour(x / unit)).collect();
    Ok(ColouredShape {
        shape: shape.with_colours(&colours)?,
        key: Some(key),
        values,
    })
}

impl From<render::Error> for CliFailure {
    fn from(e: render::Error) -> Self {
        match e {
            render::Error::Png(_) => Self::Internal(e.to_string()),
            other => Self::Input(other.to_string()),
        }
    }
}

/// Radii of nodes, in diagonals of the model.
const ROTATION_BALL: f64 = 0.006;
const POSITION_BALL: f64 = 0.008;
/// Pictures smaller than this have no words.
const WORDS: u32 = 160;

/// Draws a model and the nodes that a rig holds in it; the text counts them.
pub(super) fn draw_cutaway(
    model: &Path,
    rig: &Path,
    view: ViewDirection,
    size: PictureSize,
    pool: &Pool,
) -> Result<(Picture, String), CliFailure> {
    let bones = wire::rig_from_json(&read_file(rig)?).map_err(|e| in_file(rig, e))?;
    let limits = DeformerLimits::default();
    let read = open_model(model)?;
    // As in an animation of the model's own clip, what no skin places has no part in it.
    let options = OpenOptions {
        passengers: left_out_passengers(&read).map_err(|e| in_file(model, e))?,
        ..Default::default()
    };
    let exec = Exec::new(pool, &Silent);
    let deformer = Deformer::of_model(read, &options, &limits, &exec).map_err(|e| in_file(model, e))?;
    let held = deformer.nodes_of_rig(&bones, &exec);
    let RigNodes { rotations, positions } = held.map_err(|e| in_file(rig, e))?;

    let rest = deformer.rest();
    let geometry = deformer.geometry();
    let is_passenger = |vertex: u32| {
        let own = geometry
            .primitives
            .iter()
            .find(|p| p.vertices().contains(&(vertex as usize)));
        own.is_some_and(|p| p.is_passenger)
    };
    let solved = geometry.triangles.iter().filter(|t| !is_passenger(t[0]));
    let triangles: Vec<[u32; 3]> = solved.copied().collect();
    let diagonal = BoundingBox::of(rest).diagonal();
    let drawn = |places: &[DVec3], share: f64, colour| -> Vec<DrawnBall> {
        let ball = |center: &DVec3| DrawnBall {
            center: *center,
            radius: share * diagonal,
            colour,
        };
        places.iter().map(ball).collect()
    };
    let balls = [
        drawn(&rotations, ROTATION_BALL, ROTATION_COLOUR),
        drawn(&positions, POSITION_BALL, POSITION_COLOUR),
    ]
    .concat();
    let closed = ShadedSurface::new(rest, &triangles, pool)?;
    let camera = &Camera::around_surfaces(&[&closed], &[view], size)[0];
    let open = open_surface(rest, &triangles, camera.towards_eye(), &balls, pool)?;
    let mut picture = draw_surface(&open, camera, pool);
    if size.width().min(size.height()) >= WORDS {
        let dot = (size.width().min(size.height()) / 160).clamp(1, 4);
        let below = Picture::text_size(dot, "x").1 + 3 * dot;
        picture.write_text(4 * dot, 4 * dot, dot, "rotations", ROTATION_COLOUR);
        picture.write_text(4 * dot, 4 * dot + below, dot, "positions", POSITION_COLOUR);
    }
    let reported = format!(
        "rotations of {} nodes and positions of {}",
        rotations.len(),
        positions.len()
    );
    Ok((picture, reported))
}

/// The primitives that are named, in the order of the model; a number, as `pliant inspect` counts them, where none is named so.
///
/// # Errors
/// A name that none has, with those that there are; primitives without a triangle.
pub(super) fn choose_primitives(primitives: &[Primitive], names: &[String]) -> Result<Vec<usize>, CliFailure> {
    let refuse = |name: &str, problem: String| CliFailure::Input(format!("--primitive {name}: {problem}"));
    let mut chosen = BTreeSet::new();
    for name in names {
        let mut named: Vec<usize> = (0..primitives.len()).filter(|&k| primitives[k].name == *name).collect();
        if named.is_empty() {
            named.extend(name.parse::<usize>().ok().filter(|&k| k < primitives.len()));
        }
        if named.is_empty() {
            let names = primitives
                .iter()
                .enumerate()
                .map(|(k, p)| format!("{k} \"{}\"", p.name));
            let there = listed(names, ", which pliant inspect --json lists");
            return Err(refuse(name, format!("no primitive is named so; {there}")));
        }
        if named.iter().all(|&k| primitives[k].index_count == 0) {
            return Err(refuse(name, "it has no triangle to draw".into()));
        }
        chosen.extend(named);
    }
    Ok(chosen.into_iter().collect())
}

/// Takes all other primitives out of sight: their vertices come to lie at one of those that are chosen, so that every vertex keeps its
/// number and a camera has nothing else to look at.
pub(super) fn keep_in_sight(geometry: &mut Geometry, chosen: &[usize]) {
    let runs = geometry.triangles_of_primitives().enumerate();
    let corner = runs
        .filter(|(k, _)| chosen.contains(k))
        .find_map(|(_, (_, run))| run.first());
    let Some(place) = corner.and_then(|corner| geometry.positions.get(corner[0] as usize).copied()) else {
        return;
    };
    for (k, primitive) in geometry.primitives.iter().enumerate() {
        if !chosen.contains(&k)
            && let Some(hidden) = geometry.positions.get_mut(primitive.vertices())
        {
            hidden.fill(place);
        }
    }
}

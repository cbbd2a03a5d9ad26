//! What the colours of a picture show, and what they are.

use super::input::ModelToDraw;
use crate::cli::drawing::{Contacts, crossing_words, crossings_by_triangle, heat_colours};
use crate::cli::input_files::in_file;
use crate::cli::terminal::CliFailure;
use crate::mesh::Crossing;
use crate::pool::Pool;
use crate::render::{self, ColourKey, ColourRamp, STRETCH_RANGE, ShadedSurface, edge_stretch, vertex_displacements};
use clap::ValueEnum;
use glam::DVec3;

/// What colours show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ColourChoice {
    /// Edges longer (red) or shorter (blue) than before; also called stretch
    #[value(alias = "stretch")]
    Distortion,
    /// Distance of each vertex from its place before
    Difference,
    /// Triangles that cross others (red); amber if those pairs crossed before too
    Crossings,
    /// How deep triangles cross others; of those pairs alone that did not cross before
    Contact,
    /// The model's own base colours: materials, textures, vertex colours
    Material,
    /// The shape only
    Plain,
    /// The shape and its triangles
    Wire,
}

/// Chooses the colours to draw: those asked for where they make sense.
pub(super) fn choose_colours(
    asked: Option<ColourChoice>,
    models: &[ModelToDraw<'_>],
    before: Option<&ModelToDraw<'_>>,
) -> Result<ColourChoice, CliFailure> {
    let needs_before = |colour: ColourChoice| matches!(colour, ColourChoice::Distortion | ColourChoice::Difference);
    let compares = |colour: ColourChoice| {
        needs_before(colour) || matches!(colour, ColourChoice::Crossings | ColourChoice::Contact)
    };
    let other = |b: &&ModelToDraw<'_>| models.iter().find(|m| m.vertex_count() != b.vertex_count());
    match (asked, before, before.as_ref().and_then(other)) {
        (Some(colour), None, _) if needs_before(colour) => {
            let name = match colour {
                ColourChoice::Distortion => "distortion",
                _ => "difference",
            };
            Err(CliFailure::Input(format!(
                "--color {name} compares two shapes; name the other one with --before REST"
            )))
        }
        (Some(colour), Some(before), Some(model)) if compares(colour) => Err(CliFailure::Input(format!(
            "{} has {} vertices and {} has {}; colours compare models with as many vertices in the same order",
            model.path.display(),
            model.vertex_count(),
            before.path.display(),
            before.vertex_count()
        ))),
        (Some(colour), ..) => Ok(colour),
        (None, Some(_), None) => Ok(ColourChoice::Distortion),
        (None, ..) => Ok(ColourChoice::Material),
    }
}

/// What is measured of a shape to be shown as colours.
pub(super) enum Measured {
    /// Nothing: the shape has its own colours, or none.
    Nothing,
    /// A number for each vertex.
    Values(Vec<f64>),
    /// For each triangle what it crosses.
    Crossings(Vec<Crossing>),
    /// For each vertex how deep it crosses, with what a caption says.
    Depths(Vec<f64>, String),
}

impl Measured {
    pub(super) fn of(
        model: &ModelToDraw<'_>,
        before: Option<&ModelToDraw<'_>>,
        colour: ColourChoice,
        pool: &Pool,
    ) -> Result<Self, CliFailure> {
        let (now, triangles) = (&model.model.positions, &model.model.triangles);
        let rest = before.map(|b| b.model.positions.as_slice());
        let refuse = |e: render::Error| in_file(model.path, e);
        Ok(match (colour, rest) {
            (ColourChoice::Distortion, Some(rest)) => Self::Values(edge_stretch(rest, now, triangles).map_err(refuse)?),
            (ColourChoice::Difference, Some(rest)) => Self::Values(vertex_displacements(rest, now).map_err(refuse)?),
            (ColourChoice::Crossings, rest) => {
                Self::Crossings(crossings_by_triangle(now, rest, triangles, pool).map_err(refuse)?)
            }
            (ColourChoice::Contact, rest) => {
                let contacts = Contacts::of(now, rest, triangles, pool).map_err(refuse)?;
                Self::Depths(contacts.depths(now.len(), triangles), contacts.words())
            }
            _ => Self::Nothing,
        })
    }

    /// How bad each vertex is that is seen, for what points at the worst; empty where nothing is measured.
    pub(super) fn sizes(&self, model: &ModelToDraw<'_>) -> Vec<f64> {
        let mut sizes = vec![0.0; model.vertex_count()];
        match self {
            Self::Nothing => return Vec::new(),
            Self::Values(values) | Self::Depths(values, _) => sizes.clone_from(values),
            Self::Crossings(crossings) => {
                for (t, crossing) in model.model.triangles.iter().zip(crossings) {
                    let size = f64::from(*crossing as u8);
                    t.iter().for_each(|&v| sizes[v as usize] = size.max(sizes[v as usize]));
                }
            }
        }
        let seen = model.shape.seen_vertices();
        let visible = sizes.iter().zip(seen).map(|(x, seen)| if seen { x.abs() } else { 0.0 });
        visible.collect()
    }

    /// What a caption says of it.
    pub(super) fn words(&self, has_rest: bool) -> Option<String> {
        match self {
            Self::Crossings(crossings) => Some(crossing_words(crossings, has_rest)),
            Self::Depths(_, words) => Some(words.clone()),
            _ => None,
        }
    }

    /// The surface of the model in these colours.
    pub(super) fn paint(
        &self,
        model: &ModelToDraw<'_>,
        scale: &ColourScale,
        pool: &Pool,
    ) -> Result<ShadedSurface, CliFailure> {
        let refuse = |e: render::Error| in_file(model.path, e);
        let surface = model.shape.surface(None, DVec3::ZERO, pool).map_err(refuse)?;
        let painted = match self {
            Self::Nothing => Ok(surface),
            Self::Values(values) | Self::Depths(values, _) => {
                let colours = heat_colours(values, scale.ramp, scale.unit);
                model.shape.colour_vertices(surface, &colours)
            }
            Self::Crossings(crossings) => model.shape.mark_crossings(surface, crossings),
        };
        painted.map_err(refuse)
    }
}

/// Which number is at the end of the colours, for all shapes of a picture.
pub(super) struct ColourScale {
    ramp: ColourRamp,
    unit: f64,
    pub(super) key: Option<ColourKey>,
}

impl ColourScale {
    /// The scale for what is measured of all shapes; `range` is the end that was asked for.
    pub(super) fn of(
        colour: ColourChoice,
        measured: &[Measured],
        range: Option<f64>,
        has_rest: bool,
    ) -> Result<Self, CliFailure> {
        match colour {
            ColourChoice::Distortion => {
                let factor = range.unwrap_or(STRETCH_RANGE);
                if factor <= 1.0 {
                    let problem = "of distortion it is a factor, which must be above 1";
                    return Err(CliFailure::Input(format!("--range is {factor}; {problem}")));
                }
                Ok(Self {
                    ramp: ColourRamp::Stretch,
                    // Values are logarithms to the base of STRETCH_RANGE.
                    unit: libm::log(factor) / libm::log(STRETCH_RANGE),
                    key: Some(ColourKey::for_stretch(factor)),
                })
            }
            ColourChoice::Difference | ColourChoice::Contact => {
                let values = measured.iter().filter_map(|m| match m {
                    Measured::Values(values) | Measured::Depths(values, _) => Some(values),
                    _ => None,
                });
                let most = range.unwrap_or_else(|| values.flatten().copied().fold(0.0, f64::max));
                Ok(Self {
                    ramp: ColourRamp::Amount,
                    unit: if most > 0.0 { most } else { 1.0 },
                    key: Some(match colour {
                        ColourChoice::Contact => ColourKey::for_depth(most),
                        _ => ColourKey::for_distance(most),
                    }),
                })
            }
            other => Ok(Self {
                ramp: ColourRamp::Amount,
                unit: 1.0,
                key: (other == ColourChoice::Crossings).then(|| ColourKey::for_crossings(has_rest)),
            }),
        }
    }
}

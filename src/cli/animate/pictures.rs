//! Frames as one picture: a sheet of some of them side by side, or a picture that moves.

use super::picture_args::{FrameColour, FramePicture};
use super::play::{FrameTaker, PlayedAnimation};
use crate::cli::drawing::{
    CloseUp, Contacts, DrawnShape, SeenShape, bounds_of, crossing_words, crossings_by_triangle, heat_colours,
};
use crate::cli::terminal::{CliFailure, say};
use crate::engine::{AnimatedFrame, bind_model, influences_of_skin};
use crate::exec::Exec;
use crate::mesh::BoundingBox;
use crate::motion::BoneInfluences;
use crate::motion::rig::{RigSkeleton, RigidMotion};
use crate::pool::Pool;
use crate::render::{
    Camera, Caption, CloseView, ColourKey, ColourRamp, POSITION_COLOUR, Picture, ROTATION_COLOUR, STRETCH_RANGE,
    ShadedSurface, background_end, draw_surface, edge_stretch, encode_moving_png, sheet_columns,
};
use crate::wire::{Error, pb};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Most frames of a picture that moves.
const MOST_MOVING: usize = 1000;
/// Pixels below a sheet for the key to its colours.
const KEY: u32 = 40;
/// Tiles with sides shorter than this have no words.
const WORDS: u32 = 96;

/// A shape that is drawn, and what linear blend skinning makes of the same pose.
struct ShownShape {
    /// The frame; `None` for the rest shape, which comes first.
    frame: Option<usize>,
    /// By bone of the rig, its motion from the rest pose.
    motions: Vec<RigidMotion>,
    solved: Vec<DVec3>,
    skinned: Option<Vec<DVec3>>,
}

/// Takes the frames that a picture shows.
pub(super) struct PicturedFrames<'a> {
    picture: FramePicture,
    played: PlayedAnimation<'a>,
    /// Weights by vertex of what frames are compared with.
    skin: Option<Vec<BoneInfluences>>,
    /// What of the model is drawn, in which look.
    drawn: DrawnShape,
    colour: FrameColour,
    /// The triangles of what is solved; others have one corner three times. What no skin places would hide the rest, or stand about:
    /// hulls for collisions, floors.
    triangles: Vec<[u32; 3]>,
    shapes: Vec<ShownShape>,
}

/// A shape in its colours.
struct PaintedShape {
    surface: ShadedSurface,
    /// How bad each vertex is; empty without colours for it.
    sizes: Vec<f64>,
    words: String,
}

impl<'a> PicturedFrames<'a> {
    /// Checks that not too many frames are asked for, and that there is what is to be seen.
    pub(super) fn begin(picture: FramePicture, played: PlayedAnimation<'a>) -> Result<Self, CliFailure> {
        if picture.moves && played.animation.range().len() > MOST_MOVING {
            let problem = format!(
                "a .apng shows at most {MOST_MOVING} frames, not {}",
                played.animation.range().len()
            );
            return Err(CliFailure::Input(problem));
        }
        let skin = picture.beside.map(|_| influences_of(&played));
        let mut drawn = DrawnShape::of_model(played.deformer.model(), picture.normals).map_err(Error::from)?;
        let usual = if drawn.is_bare() {
            FrameColour::Plain
        } else {
            FrameColour::Material
        };
        let colour = picture.colour.unwrap_or(usual);
        if colour == FrameColour::Material {
            for fault in drawn.wear_materials()? {
                say!("warning: {}: {fault}", played.model.display());
            }
        }
        let solved = played.solved_vertices();
        let is_solved = |v: u32| solved.binary_search(&(v as usize)).is_ok();
        let mut triangles = played.deformer.geometry().triangles.clone();
        triangles
            .iter_mut()
            .filter(|t| !is_solved(t[0]))
            .for_each(|t| *t = [t[0]; 3]);
        drawn.keep_triangles(|t| triangles[t][0] != triangles[t][1]);
        let mut frames = Self {
            skin: skin.transpose()?,
            drawn,
            colour,
            triangles,
            picture,
            played,
            shapes: Vec::new(),
        };
        if frames.picture.has_rest {
            let still = vec![RigidMotion::IDENTITY; frames.played.animation.moving_rig().bones.len()];
            frames.add_shape(None, still, frames.played.deformer.rest().to_vec());
        }
        Ok(frames)
    }

    fn add_shape(&mut self, frame: Option<usize>, motions: Vec<RigidMotion>, solved: Vec<DVec3>) {
        let rest = self.played.deformer.rest();
        let pool = self.played.exec.pool;
        let skin = self.skin.as_ref();
        let skinned = skin.map(|skin| pool.install(|| blend_vertices(skin, rest, &motions)));
        self.shapes.push(ShownShape {
            frame,
            motions,
            solved,
            skinned,
        });
    }

    /// Whether a frame is one of those shown: evenly over the range, the first and the last among them.
    fn is_shown(&self, frame: usize) -> bool {
        let Range { start, end } = self.played.animation.range().clone();
        let last = end - start - 1;
        let tiles = self.picture.tiles - usize::from(self.picture.has_rest);
        let tiles = tiles.min(last + 1);
        if self.picture.moves || tiles == last + 1 {
            return true;
        }
        (0..tiles).any(|k| (k * last) / (tiles - 1).max(1) == frame - start)
    }

    /// Draws all shapes with one scale, each in the middle of its own picture; what it is compared with goes left of it, or above it
    /// where pictures are wide.
    fn draw_shapes(&self) -> Result<Vec<Picture>, CliFailure> {
        let pool = self.played.exec.pool;
        let solved = self.played.solved_vertices();
        let mut painted = Vec::with_capacity(self.shapes.len());
        let mut centers = Vec::with_capacity(self.shapes.len());
        for shown in &self.shapes {
            // The mean moves less from frame to frame than a box does, whose sides are where hands and feet are.
            let center = solved.iter().map(|v| shown.solved[*v]).sum::<DVec3>() / solved.len().max(1) as f64;
            centers.push(center);
            for shape in shown.skinned.iter().chain([&shown.solved]) {
                painted.push(self.paint_shape(shape, center, pool)?);
            }
        }
        let all: Vec<&ShadedSurface> = painted.iter().map(|p| &p.surface).collect();
        let whole = Camera::around_surfaces(&all, &self.picture.views, self.picture.size);
        let bounds = bounds_of(self.shapes.iter().map(|shown| &shown.solved[..]));
        let each = if self.skin.is_some() { 2 } else { 1 };
        let mut pictures = Vec::with_capacity(self.shapes.len());
        for (number, (own, shown)) in painted.chunks(each).zip(&self.shapes).enumerate() {
            let near = match (&self.picture.close_up, own.last()) {
                (Some(wanted), Some(solved)) => Some(self.near_place(wanted, shown, solved, bounds)?),
                _ => None,
            };
            let mut views = Vec::with_capacity(whole.len());
            for (v, camera) in whole.iter().enumerate() {
                let camera = match near {
                    Some(near) => camera.close_up(near.at - centers[number], near.radius),
                    None => camera.clone(),
                };
                let drawn: Vec<Picture> = own.iter().map(|p| self.draw_tile(p, &camera, v == 0, pool)).collect();
                let has_words = v == 0 && (self.picture.moves || number == 0);
                views.push(match <[Picture; 2]>::try_from(drawn) {
                    Ok(pair) => self.join_pair(pair, has_words)?,
                    Err(mut one) => one.swap_remove(0),
                });
            }
            pictures.push(join_views(views)?);
        }
        Ok(pictures)
    }

    /// A shape in its colours, with `center` in the middle.
    fn paint_shape(&self, positions: &[DVec3], center: DVec3, pool: &Pool) -> Result<PaintedShape, CliFailure> {
        let rest = self.played.deformer.rest();
        let surface = self.drawn.surface(Some(positions), -center, pool)?;
        let (mut sizes, mut words) = (Vec::new(), String::new());
        let surface = match self.colour {
            FrameColour::Plain | FrameColour::Material => surface,
            FrameColour::Distortion => {
                let values = edge_stretch(rest, positions, &self.triangles)?;
                let colours = heat_colours(&values, ColourRamp::Stretch, 1.0);
                sizes = values;
                self.drawn.colour_vertices(surface, &colours)?
            }
            FrameColour::Crossings => {
                let crossings = crossings_by_triangle(positions, Some(rest), &self.triangles, pool)?;
                sizes.resize(positions.len(), 0.0);
                for (t, crossing) in self.triangles.iter().zip(&crossings) {
                    t.iter()
                        .for_each(|&v| sizes[v as usize] = f64::from(*crossing as u8).max(sizes[v as usize]));
                }
                words = crossing_words(&crossings, true);
                self.drawn.mark_crossings(surface, &crossings)?
            }
            FrameColour::Contact => {
                let contacts = Contacts::of(positions, Some(rest), &self.triangles, pool)?;
                sizes = contacts.depths(positions.len(), &self.triangles);
                words = contacts.words();
                let colours = heat_colours(&sizes, ColourRamp::Amount, self.mean_edge());
                self.drawn.colour_vertices(surface, &colours)?
            }
        };
        Ok(PaintedShape { surface, sizes, words })
    }

    /// The mean length of edges in the rest pose, which depths are shown against in all frames alike.
    fn mean_edge(&self) -> f64 {
        let rest = self.played.deformer.rest();
        let sides = self.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let sum: f64 = sides.map(|[a, b]| rest[a as usize].distance(rest[b as usize])).sum();
        let mean = sum / (3 * self.triangles.len()).max(1) as f64;
        if mean > 0.0 { mean } else { 1.0 }
    }

    /// The place of a frame that is shown from near by.
    fn near_place(
        &self,
        wanted: &CloseUp,
        shown: &ShownShape,
        solved: &PaintedShape,
        bounds: BoundingBox,
    ) -> Result<CloseView, CliFailure> {
        let rig = self.played.animation.moving_rig();
        let mut marks: Vec<(String, DVec3)> = Vec::new();
        for (bone, motion) in rig.bones.iter().zip(&shown.motions) {
            let begins = motion.place(bone.from);
            marks.extend([(bone.id.clone(), begins), (bone.joint.clone(), begins)]);
        }
        wanted.place_in(&SeenShape {
            positions: &shown.solved,
            primitives: &self.played.deformer.geometry().primitives,
            values: &solved.sizes,
            marks: &marks,
            bounds,
        })
    }

    /// One picture of one shape, with its words where they are wanted.
    fn draw_tile(&self, painted: &PaintedShape, camera: &Camera, has_words: bool, pool: &Pool) -> Picture {
        let mut picture = draw_surface(&painted.surface, camera, pool);
        let [width, height] = [picture.width(), picture.height()];
        if has_words && !painted.words.is_empty() && width.min(height) >= WORDS {
            let dot = (width / 240).clamp(1, 3);
            let words = Caption::fitting(&painted.words, width - 8 * dot, height / 3, dot);
            words.draw_on(&mut picture, 4 * dot, height - words.height() - 2 * dot);
        }
        picture
    }

    /// One picture of two: linear blend skinning and what was solved.
    fn join_pair(&self, pair: [Picture; 2], has_words: bool) -> Result<Picture, CliFailure> {
        let [width, height] = [self.picture.size.width(), self.picture.size.height()];
        let [right, down] = if width > height { [0, height] } else { [width, 0] };
        let mut joined = Picture::new(u64::from(width + right), u64::from(height + down), background_end())?;
        let dot = (width.min(height) / 64).clamp(1, 3);
        let words = [("LBS", POSITION_COLOUR), ("pliant", ROTATION_COLOUR)];
        for (k, (picture, (word, colour))) in (0u32..).zip(pair.iter().zip(words)) {
            let [x, y] = [k * right, k * down];
            joined.paste_picture(picture, x, y);
            if has_words && width.min(height) >= WORDS {
                joined.write_text(x + 4 * dot, y + 4 * dot, dot, word, colour);
            }
        }
        Ok(joined)
    }

    /// Puts pictures side by side, in about as many rows as fit a page.
    fn join_sheet(&self, pictures: &[Picture]) -> Result<Picture, CliFailure> {
        let size = pictures.first().map_or([1, 1], |p| [p.width(), p.height()]);
        let [width, height] = size;
        let columns = sheet_columns(pictures.len(), f64::from(width) / f64::from(height));
        let rows = pictures.len().div_ceil(columns);
        let shown_key = match self.colour {
            FrameColour::Plain | FrameColour::Material => None,
            FrameColour::Distortion => Some(ColourKey::for_stretch(STRETCH_RANGE)),
            FrameColour::Crossings => Some(ColourKey::for_crossings(true)),
            FrameColour::Contact => Some(ColourKey::for_depth(self.mean_edge())),
        };
        let key = if shown_key.is_some() { KEY } else { 0 };
        let side = |n: usize, pixels: u32| n as u64 * u64::from(pixels);
        let mut sheet = Picture::new(
            side(columns, width),
            side(rows, height) + u64::from(key),
            background_end(),
        )?;
        for (k, picture) in pictures.iter().enumerate() {
            sheet.paste_picture(picture, (k % columns) as u32 * width, (k / columns) as u32 * height);
        }
        if let Some(shown) = shown_key {
            shown.draw_on(&mut sheet, rows as u32 * height, key);
        }
        Ok(sheet)
    }
}

impl FrameTaker for PicturedFrames<'_> {
    fn missing(&self) -> Vec<Range<usize>> {
        vec![self.played.animation.range().clone()]
    }

    fn take(&mut self, frame: &AnimatedFrame, _: &pb::animation_report::FrameReport) -> Result<(), CliFailure> {
        if self.is_shown(frame.index) {
            let motions = bone_motions(&self.played, frame);
            self.add_shape(Some(frame.index), motions, frame.positions.clone());
        }
        Ok(())
    }

    fn stop(&mut self) -> String {
        "stopped before the last frame; a picture is written when all are there, and nothing is kept".into()
    }

    fn finish(&mut self, report: &mut pb::AnimationReport, _: &Exec<'_>) -> Result<(), CliFailure> {
        self.shapes.sort_by_key(|shown| shown.frame);
        let pictures = self.draw_shapes()?;
        let bytes = match self.picture.moves {
            true => encode_moving_png(&pictures, self.played.animation.times().rate)?,
            false => self.join_sheet(&pictures)?.encode_png()?,
        };
        self.played.permission.write_file(&self.picture.path, &bytes)?;
        report.output = vec![self.picture.path.display().to_string()];
        Ok(())
    }
}

/// The views of a frame side by side.
fn join_views(mut views: Vec<Picture>) -> Result<Picture, CliFailure> {
    if views.len() == 1 {
        return Ok(views.swap_remove(0));
    }
    let width: u64 = views.iter().map(|view| u64::from(view.width())).sum();
    let height = views.first().map_or(1, Picture::height);
    let mut joined = Picture::new(width, u64::from(height), background_end())?;
    for (k, view) in (0u32..).zip(&views) {
        joined.paste_picture(view, k * view.width(), 0);
    }
    Ok(joined)
}

/// Bones that a vertex follows at most where the model says nothing of it.
const INFLUENCES: usize = 4;

/// What the bones of the rig do in a frame, in the space that its positions are in.
fn bone_motions(played: &PlayedAnimation<'_>, frame: &AnimatedFrame) -> Vec<RigidMotion> {
    let animation = played.animation;
    let rig = animation.moving_rig();
    let pose = animation.driver().pose_at(frame.seconds);
    RigSkeleton::of_rig(rig, false).motions_in(rig, &pose, &frame.root)
}

/// The weights of linear blend skinning: the model's own where its own clip is played, else those of `pliant skin`.
fn influences_of(played: &PlayedAnimation<'_>) -> Result<Vec<BoneInfluences>, CliFailure> {
    let (model, rig) = (played.deformer.model(), played.animation.moving_rig());
    Ok(match played.animation.own_clip() {
        Some(_) => influences_of_skin(model, rig)?,
        None => bind_model(model, rig, INFLUENCES, &played.exec)?.influences,
    })
}

/// Poses the vertices whose rest is `rest`.
fn blend_vertices(influences: &[BoneInfluences], rest: &[DVec3], motions: &[RigidMotion]) -> Vec<DVec3> {
    let place = |(p, own): (&DVec3, &BoneInfluences)| own.blend(|bone| motions[bone].place(*p));
    rest.par_iter().zip(influences).map(place).collect()
}

//! Frames as one picture: a sheet of some of them side by side, or a picture that moves.

use super::linear_blend::{LinearBlendSkin, bone_motions};
use super::picture_args::{CloseUp, FrameColour, FramePicture, MOST_TILES};
use super::taken_frames::{FrameTaker, PlayedAnimation};
use crate::cli::failure::CliFailure;
use crate::engine::AnimatedFrame;
use crate::exec::Exec;
use crate::motion::rig::{MotionRig, RigidMotion};
use crate::render::{
    Camera, ColourKey, ColourRamp, POSITION_COLOUR, Picture, ROTATION_COLOUR, STRETCH_RANGE, ShadedSurface,
    background_end, draw_surface, edge_stretch, encode_moving_png,
};
use crate::wire::pb;
use glam::DVec3;
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
    skin: Option<LinearBlendSkin>,
    /// The bone around whose beginning pictures are, and how far they reach.
    near: Option<(usize, f64)>,
    shapes: Vec<ShownShape>,
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
        let rig = played.animation.moving_rig();
        let near = picture.close_up.as_ref().map(|wanted| bone_named(rig, wanted));
        let skin = picture.beside.map(|_| LinearBlendSkin::of_played(&played));
        let mut frames = Self {
            near: near.transpose()?,
            skin: skin.transpose()?,
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
        let skinned = skin.map(|skin| pool.install(|| skin.place_vertices(rest, &motions)));
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
        let rest = self.played.deformer.rest();
        let pool = self.played.exec.pool;
        let played = self.played.solved_vertices();
        // What no skin places would hide the rest, or stand about: hulls for collisions, floors.
        let is_played = |t: &&[u32; 3]| played.binary_search(&(t[0] as usize)).is_ok();
        let triangles = &self.played.deformer.geometry().triangles;
        let triangles: Vec<[u32; 3]> = triangles.iter().filter(is_played).copied().collect();
        let mut surfaces = Vec::with_capacity(self.shapes.len());
        let mut centers = Vec::with_capacity(self.shapes.len());
        for shown in &self.shapes {
            // The mean moves less from frame to frame than a box does, whose sides are where hands and feet are.
            let center = played.iter().map(|v| shown.solved[*v]).sum::<DVec3>() / played.len().max(1) as f64;
            centers.push(center);
            for shape in shown.skinned.iter().chain([&shown.solved]) {
                let centred: Vec<DVec3> = shape.iter().map(|p| *p - center).collect();
                let mut surface = ShadedSurface::new(&centred, &triangles, pool)?;
                if self.picture.colour == FrameColour::Distortion {
                    let values = edge_stretch(rest, shape, &triangles)?;
                    let colours: Vec<_> = values.iter().map(|x| ColourRamp::Stretch.linear_colour(*x)).collect();
                    surface = surface.with_colours(&colours)?;
                }
                surfaces.push(surface);
            }
        }
        let all: Vec<&ShadedSurface> = surfaces.iter().collect();
        let whole = &Camera::around_surfaces(&all, &[self.picture.view], self.picture.size)[0];
        let each = if self.skin.is_some() { 2 } else { 1 };
        let mut pictures = Vec::with_capacity(self.shapes.len());
        for (number, (own, shown)) in surfaces.chunks(each).zip(&self.shapes).enumerate() {
            let camera = match self.near {
                Some((bone, radius)) => {
                    let from = self.played.animation.moving_rig().bones[bone].from;
                    whole.close_up(shown.motions[bone].place(from) - centers[number], radius)
                }
                None => whole.clone(),
            };
            let drawn: Vec<Picture> = own.iter().map(|s| draw_surface(s, &camera, pool)).collect();
            let has_words = self.picture.moves || number == 0;
            pictures.push(match <[Picture; 2]>::try_from(drawn) {
                Ok(pair) => self.join_pair(pair, has_words)?,
                Err(mut one) => one.swap_remove(0),
            });
        }
        Ok(pictures)
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
        let columns = columns_for(pictures.len(), f64::from(width) / f64::from(height));
        let rows = pictures.len().div_ceil(columns);
        let is_coloured = self.picture.colour == FrameColour::Distortion;
        let key = if is_coloured { KEY } else { 0 };
        let side = |n: usize, pixels: u32| n as u64 * u64::from(pixels);
        let mut sheet = Picture::new(
            side(columns, width),
            side(rows, height) + u64::from(key),
            background_end(),
        )?;
        for (k, picture) in pictures.iter().enumerate() {
            sheet.paste_picture(picture, (k % columns) as u32 * width, (k / columns) as u32 * height);
        }
        if key > 0 {
            ColourKey::for_stretch(STRETCH_RANGE).draw_on(&mut sheet, rows as u32 * height, key);
        }
        Ok(sheet)
    }
}

/// The bone that is to be seen near by.
fn bone_named(rig: &MotionRig, wanted: &CloseUp) -> Result<(usize, f64), CliFailure> {
    let is_it = |bone: &crate::motion::rig::RigBone| bone.id == wanted.bone || bone.joint == wanted.bone;
    let found = rig.bones.iter().position(is_it).map(|bone| (bone, wanted.radius));
    found.ok_or_else(|| {
        let names: Vec<&str> = rig.bones.iter().map(|bone| bone.id.as_str()).collect();
        let problem = format!(
            "\"{}\" is not a bone of the rig; it has {}",
            wanted.bone,
            names.join(", ")
        );
        CliFailure::Input(format!("--close-up: {problem}"))
    })
}

/// Columns of a sheet of tiles so many times as wide as high: as few places left empty as can be, then about twice as wide as
/// high.
fn columns_for(tiles: usize, aspect: f64) -> usize {
    let most = tiles.clamp(1, MOST_TILES);
    let is_wide = |c: &usize| (c * c) as f64 * aspect >= tiles as f64;
    let least = (1..most).find(is_wide).unwrap_or(most);
    let choices = least..=most.min(2 * least);
    let off = |c: usize| ((c * c) as f64 * aspect - 2.0 * tiles as f64).abs();
    let empty = |c: usize| c * tiles.div_ceil(c) - tiles;
    choices
        .min_by(|a, b| empty(*a).cmp(&empty(*b)).then(off(*a).total_cmp(&off(*b))))
        .unwrap_or(most)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sheet_has_no_more_empty_places_than_it_must() {
        let columns = |tiles: [usize; 7], aspect: f64| tiles.map(|count| columns_for(count, aspect));
        assert_eq!(columns([1, 2, 6, 9, 12, 16, 64], 1.0), [1, 2, 3, 3, 4, 4, 8]);
        for tiles in 1..=MOST_TILES {
            for aspect in [0.75, 1.0, 1.5] {
                let columns = columns_for(tiles, aspect);
                let empty = columns * tiles.div_ceil(columns) - tiles;
                assert!(empty < columns, "{tiles}");
            }
        }
    }

    #[test]
    fn sheets_of_high_tiles_have_more_columns_than_sheets_of_wide_ones() {
        assert_eq!(columns_for(16, 0.75), 8);
        assert_eq!(columns_for(16, 3.0), 4);
        assert_eq!(columns_for(6, 1.5), 3);
    }
}

//! Frames as one picture: a sheet of some of them side by side, or a picture that moves.

use super::play::{FrameTaker, PlayedAnimation};
use crate::cli::terminal::{CliFailure, bounded};
use crate::engine::{AnimatedFrame, bind_model, influences_of_skin};
use crate::exec::Exec;
use crate::motion::BoneInfluences;
use crate::motion::rig::{MotionRig, RigSkeleton, RigidMotion};
use crate::render::{
    Camera, ColourKey, ColourRamp, POSITION_COLOUR, Picture, PictureSize, ROTATION_COLOUR, STRETCH_RANGE,
    ShadedSurface, UpAxis, ViewDirection, background_end, draw_surface, edge_stretch, encode_moving_png,
};
use crate::wire::pb;
use clap::{Args, ValueEnum};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;
use std::path::{Path, PathBuf};

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
        let skin = picture.beside.map(|_| influences_of(&played));
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

/// Most frames of a sheet.
pub(super) const MOST_TILES: usize = 256;
/// Default frames of a sheet.
const USUAL_TILES: usize = 16;

/// How frames are drawn.
#[derive(Debug, Clone, Args)]
pub(super) struct FramePictureArgs {
    /// Number of frames in a .png, side by side, 1 to 256 [default: 16]
    #[arg(long, value_name = "COUNT")]
    tiles: Option<usize>,
    /// Begin a .png with the rest pose
    #[arg(long)]
    rest: bool,
    /// Size of one frame in pixels [default: 240x320]
    #[arg(long, value_name = "WxH", value_parser = crate::cli::render::parse_size)]
    tile: Option<PictureSize>,
    /// View: degrees around the up axis and above the horizon [default: 30,10]
    #[arg(long, value_name = "AZIMUTH,ELEVATION", value_parser = crate::cli::render::parse_angles, allow_hyphen_values = true)]
    view: Option<[f64; 2]>,
    /// Meaning of the colours [default: plain]
    #[arg(long, value_enum, alias = "colour")]
    color: Option<FrameColour>,
    /// Draw the result of another method beside each frame
    #[arg(long, value_enum, value_name = "METHOD")]
    beside: Option<BesideMethod>,
    /// Show only the surroundings of a bone of the rig; the radius is in model units
    #[arg(long, value_name = "BONE,RADIUS", value_parser = parse_close_up)]
    close_up: Option<CloseUp>,
}

/// What the colours of frames show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum FrameColour {
    /// The shape only
    Plain,
    /// Edges longer (red) or shorter (blue) than in the rest pose; also called stretch
    #[value(alias = "stretch")]
    Distortion,
}

/// What frames are compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum BesideMethod {
    /// Linear blend skinning, with the model's weights for its own clip, else with those of `pliant skin`
    Lbs,
}

/// The surroundings of a bone's beginning.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CloseUp {
    /// The bone's name, or that of the joint that turns it.
    pub(super) bone: String,
    /// How far they go, in model units.
    pub(super) radius: f64,
}

fn parse_close_up(text: &str) -> Result<CloseUp, String> {
    let parts = text.rsplit_once(',').filter(|(bone, _)| !bone.is_empty());
    let radius = |text: &str| text.trim().parse::<f64>().ok().filter(|r| r.is_finite() && *r > 0.0);
    match parts.and_then(|(bone, text)| Some((bone, radius(text)?))) {
        Some((bone, radius)) => Ok(CloseUp {
            bone: bone.into(),
            radius,
        }),
        None => Err("a bone's name, a comma and a number above 0 are needed, such as leftHand,0.3".into()),
    }
}

/// How frames become a picture.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FramePicture {
    pub(super) path: PathBuf,
    /// Whether it is a picture that moves.
    pub(super) moves: bool,
    /// Places of a sheet, the rest shape's among them.
    pub(super) tiles: usize,
    pub(super) has_rest: bool,
    pub(super) size: PictureSize,
    pub(super) view: ViewDirection,
    pub(super) colour: FrameColour,
    pub(super) beside: Option<BesideMethod>,
    pub(super) close_up: Option<CloseUp>,
}

impl FramePictureArgs {
    /// Whether anything is said of pictures.
    pub(super) fn is_given(&self) -> bool {
        let has_numbers = self.tiles.is_some() || self.tile.is_some() || self.view.is_some();
        let has_kinds = self.color.is_some() || self.beside.is_some() || self.close_up.is_some();
        self.rest || has_numbers || has_kinds
    }

    /// The picture that a path asks for, if it is one's.
    pub(super) fn picture_at(&self, path: &Path) -> Result<Option<FramePicture>, CliFailure> {
        let ends = |wanted: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(wanted));
        let moves = ends("apng");
        if !moves && !ends("png") {
            return Ok(None);
        }
        if moves && (self.tiles.is_some() || self.rest) {
            return Err(CliFailure::Input(
                "--tiles and --rest are for .png; a .apng shows all frames".into(),
            ));
        }
        let tiles = bounded("--tiles", self.tiles, USUAL_TILES, 1..=MOST_TILES)?;
        if self.rest && tiles < 2 {
            let problem = "--tiles is 1; with --rest there is room for no frame, 2 or more are needed";
            return Err(CliFailure::Input(problem.into()));
        }
        let [azimuth, elevation] = self.view.unwrap_or([30.0, 10.0]);
        Ok(Some(FramePicture {
            path: path.to_owned(),
            moves,
            tiles,
            has_rest: self.rest,
            size: self.tile.map_or_else(|| PictureSize::new(240, 320), Ok)?,
            view: ViewDirection::new(azimuth, elevation, UpAxis::Y)?,
            colour: self.color.unwrap_or(FrameColour::Plain),
            beside: self.beside,
            close_up: self.close_up.clone(),
        }))
    }
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

//! Frames as one picture: a sheet of some of them side by side, or a picture that moves.

use super::taken_frames::{FrameTaker, PlayedAnimation};
use crate::cli::failure::CliFailure;
use crate::engine::{AnimatedFrame, Animation};
use crate::render::{
    Camera, ColourKey, ColourRamp, Picture, PictureSize, STRETCH_RANGE, ShadedSurface, UpAxis, ViewDirection,
    background_end, draw_surface, edge_stretch, encode_moving_png,
};
use crate::wire::pb;
use clap::{Args, ValueEnum};
use glam::DVec3;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Most frames of a sheet.
const MOST_TILES: usize = 256;
/// Most frames of a picture that moves.
const MOST_MOVING: usize = 1000;
/// Frames of a sheet unless told otherwise.
const USUAL_TILES: usize = 16;
/// Pixels below a sheet for the key to its colours.
const KEY: u32 = 40;

/// How frames are drawn.
#[derive(Debug, Clone, Args)]
pub(super) struct FramePictureArgs {
    /// Frames that a .png shows side by side, 1 to 256 [default: 16]
    #[arg(long, value_name = "COUNT")]
    tiles: Option<usize>,
    /// Pixels of one frame of a picture [default: 240x320]
    #[arg(long, value_name = "WxH", value_parser = crate::cli::render::parse_size)]
    tile: Option<PictureSize>,
    /// From where pictures show the model: degrees around the up axis and above the horizon [default: 30,10]
    #[arg(long, value_name = "AZIMUTH,ELEVATION", value_parser = crate::cli::render::parse_angles, allow_hyphen_values = true)]
    view: Option<[f64; 2]>,
    /// What the colours of pictures show [default: plain]
    #[arg(long, value_enum, alias = "colour")]
    color: Option<FrameColour>,
}

/// What the colours of frames show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum FrameColour {
    /// Nothing but the shape
    Plain,
    /// Edges longer (red) or shorter (blue) than at rest
    Distortion,
}

/// How frames become a picture.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FramePicture {
    path: PathBuf,
    moves: bool,
    tiles: usize,
    size: PictureSize,
    view: ViewDirection,
    colour: FrameColour,
}

impl FramePictureArgs {
    /// Whether anything is said of pictures.
    pub(super) fn is_given(&self) -> bool {
        self.tiles.is_some() || self.tile.is_some() || self.view.is_some() || self.color.is_some()
    }

    /// The picture that a path asks for, if it is one's.
    pub(super) fn picture_at(&self, path: &Path) -> Result<Option<FramePicture>, CliFailure> {
        let ends = |wanted: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(wanted));
        let moves = ends("apng");
        if !moves && !ends("png") {
            return Ok(None);
        }
        if moves && self.tiles.is_some() {
            return Err(CliFailure::Input(
                "--tiles is for .png; a .apng shows all frames".into(),
            ));
        }
        let tiles = self.tiles.unwrap_or(USUAL_TILES);
        if !(1..=MOST_TILES).contains(&tiles) {
            let problem = format!("--tiles is {tiles}, allowed are 1 to {MOST_TILES}");
            return Err(CliFailure::Input(problem));
        }
        let [azimuth, elevation] = self.view.unwrap_or([30.0, 10.0]);
        Ok(Some(FramePicture {
            path: path.to_owned(),
            moves,
            tiles,
            size: self.tile.map_or_else(|| PictureSize::new(240, 320), Ok)?,
            view: ViewDirection::new(azimuth, elevation, UpAxis::Y)?,
            colour: self.color.unwrap_or(FrameColour::Plain),
        }))
    }
}

impl FramePicture {
    /// Where it goes.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Draws the triangles of shapes with one scale, each in the middle of its own picture.
    fn draw(&self, shapes: &[Vec<DVec3>], animated: &PlayedAnimation<'_>) -> Result<Vec<Picture>, CliFailure> {
        let (rest, pool) = (animated.deformer.rest(), animated.exec.pool);
        let played = animated.played_vertices();
        // What the clip does not move would stand about at rest: hulls for collisions, floors.
        let is_played = |t: &&[u32; 3]| played.binary_search(&(t[0] as usize)).is_ok();
        let triangles = &animated.deformer.geometry().triangles;
        let triangles: Vec<[u32; 3]> = triangles.iter().filter(is_played).copied().collect();
        let triangles = &triangles;
        let mut surfaces = Vec::with_capacity(shapes.len());
        for shape in shapes {
            // The mean moves less from frame to frame than a box does, whose sides are where hands and feet are.
            let center = played.iter().map(|v| shape[*v]).sum::<DVec3>() / played.len().max(1) as f64;
            let centred: Vec<DVec3> = shape.iter().map(|p| *p - center).collect();
            let mut surface = ShadedSurface::new(&centred, triangles, pool)?;
            if self.colour == FrameColour::Distortion {
                let values = edge_stretch(rest, shape, triangles)?;
                let colours: Vec<_> = values.iter().map(|x| ColourRamp::Stretch.linear_colour(*x)).collect();
                surface = surface.with_colours(&colours)?;
            }
            surfaces.push(surface);
        }
        let all: Vec<&ShadedSurface> = surfaces.iter().collect();
        let cameras = Camera::around_surfaces(&all, &[self.view], self.size);
        let drawn = surfaces.iter().zip(cameras.iter().cycle());
        Ok(drawn
            .map(|(surface, camera)| draw_surface(surface, camera, pool))
            .collect())
    }

    /// Puts pictures side by side, in about as many rows as fit a page.
    fn sheet(&self, pictures: &[Picture]) -> Result<Picture, CliFailure> {
        let columns = columns_for(pictures.len());
        let rows = pictures.len().div_ceil(columns);
        let [width, height] = [self.size.width(), self.size.height()];
        let key = if self.colour == FrameColour::Distortion { KEY } else { 0 };
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

/// Columns of a sheet: as few places left empty as can be, then about twice as wide as high.
fn columns_for(tiles: usize) -> usize {
    let (least, most) = ((1..).find(|c| c * c >= tiles).unwrap_or(1), tiles.clamp(1, MOST_TILES));
    let choices = least..=most.min(2 * least);
    let rank = |c: &usize| (c * tiles.div_ceil(*c) - tiles, (c * c).abs_diff(2 * tiles));
    choices.min_by_key(rank).unwrap_or(most)
}

/// Takes the frames that a picture shows.
pub(super) struct PicturedFrames<'a> {
    picture: FramePicture,
    played: PlayedAnimation<'a>,
    shapes: Vec<Vec<DVec3>>,
}

impl<'a> PicturedFrames<'a> {
    /// Checks that not too many frames are asked for.
    pub(super) fn begin(picture: FramePicture, played: PlayedAnimation<'a>) -> Result<Self, CliFailure> {
        if picture.moves && played.range.len() > MOST_MOVING {
            let problem = format!("a .apng shows at most {MOST_MOVING} frames, not {}", played.range.len());
            return Err(CliFailure::Input(problem));
        }
        Ok(Self {
            picture,
            played,
            shapes: Vec::new(),
        })
    }

    /// Whether a frame is one of those shown: evenly over the range, the first and the last among them.
    fn is_shown(&self, frame: usize) -> bool {
        let Range { start, end } = self.played.range;
        let last = end - start - 1;
        let tiles = self.picture.tiles.min(last + 1);
        if self.picture.moves || tiles == last + 1 {
            return true;
        }
        (0..tiles).any(|k| (k * last) / (tiles - 1).max(1) == frame - start)
    }
}

impl FrameTaker for PicturedFrames<'_> {
    fn missing(&self) -> Range<usize> {
        self.played.range.clone()
    }

    fn take(&mut self, frame: &AnimatedFrame, _: &pb::animation_report::FrameReport) -> Result<(), CliFailure> {
        if self.is_shown(frame.index) {
            self.shapes.push(frame.positions.clone());
        }
        Ok(())
    }

    fn finish(&mut self, report: &mut pb::AnimationReport, _: &Animation) -> Result<(), CliFailure> {
        let PlayedAnimation { permission, times, .. } = &self.played;
        let pictures = self.picture.draw(&self.shapes, &self.played)?;
        let bytes = match self.picture.moves {
            true => encode_moving_png(&pictures, times.rate)?,
            false => self.picture.sheet(&pictures)?.encode_png()?,
        };
        permission.write_file(&self.picture.path, &bytes)?;
        report.output = vec![self.picture.path.display().to_string()];
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sheet_has_no_more_empty_places_than_it_must() {
        assert_eq!([1, 2, 6, 9, 12, 16, 64].map(columns_for), [1, 2, 3, 3, 4, 4, 8]);
        for tiles in 1..=MOST_TILES {
            let columns = columns_for(tiles);
            assert!(columns * tiles.div_ceil(columns) - tiles < columns, "{tiles}");
        }
    }
}

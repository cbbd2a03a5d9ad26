//! How frames become pictures, as arguments say it.

use crate::cli::drawing::{CloseUp, NormalChoice, UpAxisChoice, ViewList, parse_close_up, parse_size, parse_views};
use crate::cli::terminal::{CliFailure, bounded};
use crate::render::{PictureSize, ViewDirection};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

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
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    tile: Option<PictureSize>,
    /// Views: degrees around the up axis and above the horizon, or names as for `pliant render`; several, up to 64, with commas
    /// between them are side by side in each frame [default: 30,10]
    #[arg(long, value_name = "VIEWS", value_parser = parse_views, allow_hyphen_values = true)]
    view: Option<ViewList>,
    /// Up axis of the model [default: y]
    #[arg(long, value_enum)]
    up: Option<UpAxisChoice>,
    /// Normals that shade the surface [default: file]
    #[arg(long, value_enum)]
    normals: Option<NormalChoice>,
    /// Meaning of the colours [default: material if the model has base colours, else plain]
    #[arg(long, value_enum, alias = "colour")]
    color: Option<FrameColour>,
    /// Draw the result of another method beside each frame
    #[arg(long, value_enum, value_name = "METHOD")]
    beside: Option<BesideMethod>,
    /// Show only the surroundings of a place that moves along: BONE,RADIUS in model units, or what `pliant render` takes
    #[arg(long, value_name = "PLACE", value_parser = parse_close_up, allow_hyphen_values = true)]
    close_up: Option<CloseUp>,
}

/// What the colours of frames show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum FrameColour {
    /// The model's own base colours: materials, textures, vertex colours
    Material,
    /// The shape only
    Plain,
    /// Edges longer (red) or shorter (blue) than in the rest pose; also called stretch
    #[value(alias = "stretch")]
    Distortion,
    /// Triangles that cross others (red); amber if those pairs cross in the rest pose too
    Crossings,
    /// How deep triangles cross that do not in the rest pose; the darkest red is a mean edge or more
    Contact,
}

/// What frames are compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum BesideMethod {
    /// Linear blend skinning, with the model's weights for its own clip, else with those of `pliant skin`
    Lbs,
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
    /// One or several, side by side in each frame.
    pub(super) views: Vec<ViewDirection>,
    /// By the model's look without one.
    pub(super) colour: Option<FrameColour>,
    pub(super) normals: NormalChoice,
    pub(super) beside: Option<BesideMethod>,
    pub(super) close_up: Option<CloseUp>,
}

impl FramePictureArgs {
    /// Whether anything is said of pictures.
    pub(super) fn is_given(&self) -> bool {
        let has_numbers = self.tiles.is_some() || self.tile.is_some();
        let has_sides = self.view.is_some() || self.up.is_some() || self.normals.is_some();
        let has_kinds = self.color.is_some() || self.beside.is_some() || self.close_up.is_some();
        self.rest || has_numbers || has_sides || has_kinds
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
        let views = self.view.clone().unwrap_or_else(|| ViewList::of([30.0, 10.0]));
        let views = views.directions(self.up.unwrap_or(UpAxisChoice::Y))?;
        Ok(Some(FramePicture {
            path: path.to_owned(),
            moves,
            tiles,
            has_rest: self.rest,
            size: self.tile.map_or_else(|| PictureSize::new(240, 320), Ok)?,
            views,
            colour: self.color,
            normals: self.normals.unwrap_or_default(),
            beside: self.beside,
            close_up: self.close_up.clone(),
        }))
    }
}

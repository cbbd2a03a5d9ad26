//! How frames are drawn: which arguments say it, and which of them fit together.

use crate::cli::failure::CliFailure;
use crate::render::{PictureSize, UpAxis, ViewDirection};
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
        let tiles = self.tiles.unwrap_or(USUAL_TILES);
        if !(1..=MOST_TILES).contains(&tiles) {
            let problem = format!("--tiles is {tiles}, allowed are 1 to {MOST_TILES}");
            return Err(CliFailure::Input(problem));
        }
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

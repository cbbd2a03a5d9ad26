//! Where the frames of an animation go: which arguments say it, and which of them fit together.

use super::gathered::{GatheredFrames, GatheredKind};
use super::numbered::NumberedFrames;
use super::picture_args::{FramePicture, FramePictureArgs};
use super::pictures::PicturedFrames;
use super::play::{FrameTaker, MeasuredFrames, PlayedAnimation};
use crate::asset::{FileSet, Format, VertexCache};
use crate::cli::output_files::{OutputPermission, spare_companions};
use crate::cli::terminal::{CliFailure, bounded};
use crate::engine::PlayedForm;
use crate::motion::decomposition::DecompositionOptions;
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

/// What may be named as an output.
const ALLOWED_OUTPUTS: &str = "allowed are .glb, .usda, .pc2, .mdd, .png, .apng and a folder, which ends in a slash";

/// Most morph targets of a file.
const MOST_TARGETS: usize = 4096;
/// Default morph targets of a file: what game engines take (bevy: 64).
const USUAL_TARGETS: usize = 64;

/// Most correctives of a file, and the default.
const MOST_POSES: usize = 256;
const USUAL_POSES: usize = 8;
/// Default bones of a skin.
const USUAL_BONES: usize = 40;

/// Where the frames of an animation go.
#[derive(Debug, Args)]
pub(super) struct AnimationOutputArgs {
    /// Output: a .glb, a .usda, a point cache (.pc2 or .mdd), a picture (.png side by side, .apng moving), or a folder of
    /// numbered models (ends in a slash)
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Format of numbered models [default: obj]
    #[arg(long)]
    format: Option<String>,
    /// How a .glb stores the frames
    #[arg(long = "as", value_enum)]
    played_as: Option<PlayedAs>,
    /// Maximum morph targets of a .glb; with more frames, pliant blends between selected shapes [default: 64]
    #[arg(long, value_name = "COUNT")]
    max_targets: Option<usize>,
    /// Kind of bones for --as skin [default: free]
    #[arg(long, value_enum)]
    skeleton: Option<SkeletonKind>,
    /// Maximum correctives for --as correctives, 1 to 256 [default: 8]
    #[arg(long, value_name = "COUNT")]
    poses: Option<usize>,
    /// Number of bones for --as skin, 1 to 256 [default: 40]
    #[arg(long, value_name = "COUNT")]
    bones: Option<usize>,
    /// Motion of the root bone: node (keys of a root node, default for .glb and .usda), baked (into the positions, default for
    /// the others) or none (left out)
    #[arg(long, value_enum)]
    root: Option<RootRule>,
    #[command(flatten)]
    pictures: FramePictureArgs,
    /// Continue a stopped run with the same output and options
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    permission: OutputPermission,
}

/// How a GLB holds frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum PlayedAs {
    /// Morph targets, and an animation of their weights.
    Morph,
    /// Skin of rigid bones, four per vertex; any engine plays it.
    Skin,
    /// Skin of the rig's bones, and morph targets for the remainder.
    Correctives,
}

/// What the bones of a skin are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SkeletonKind {
    /// Bones fitted to the frames, side by side below one root.
    Free,
    /// Bones of the rig, with weights fitted to the frames.
    Rig,
    /// Bones of the rig, and three more along each limb to spread its twist.
    Twist,
}

/// Where the motion of the root bone goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum RootRule {
    /// Keys of a root node.
    Node,
    /// Into the positions.
    Baked,
    /// Left out.
    None,
}

/// What is written.
#[derive(Debug, Clone, PartialEq)]
enum OutputKind {
    Nothing,
    Numbered(Format),
    Gathered(GatheredKind),
    Pictured(FramePicture),
}

/// Where frames go, checked as far as it can be before any work.
#[derive(Debug)]
pub(super) struct AnimationOutput {
    /// Empty where they go nowhere.
    path: PathBuf,
    kind: OutputKind,
    pub(super) root: RootRule,
    resumes: bool,
    pub(super) permission: OutputPermission,
}

impl AnimationOutputArgs {
    /// Checks what is asked for.
    pub(super) fn output(&self) -> Result<AnimationOutput, CliFailure> {
        let kind = match &self.output {
            None => OutputKind::Nothing,
            Some(path) => self.kind_of(path)?,
        };
        let form = match kind {
            OutputKind::Gathered(GatheredKind::Glb(form)) => Some(form),
            _ => None,
        };
        let is_free = matches!(form, Some(PlayedForm::Bones(_)));
        let has_nodes = form.is_some() || kind == OutputKind::Gathered(GatheredKind::Usd);
        let is_picture = matches!(kind, OutputKind::Pictured(_));
        for (is_given, fits, problem) in [
            (
                self.format.is_some(),
                matches!(kind, OutputKind::Numbered(_)),
                "--format is for folders of numbered models",
            ),
            (self.played_as.is_some(), form.is_some(), "--as is for .glb files"),
            (
                self.max_targets.is_some(),
                matches!(form, Some(PlayedForm::Morphs(_))),
                "--max-targets is for .glb files with morph targets",
            ),
            (
                self.bones.is_some(),
                is_free,
                "--bones is for --as skin with free bones",
            ),
            (
                self.skeleton.is_some(),
                is_free || matches!(form, Some(PlayedForm::RigBones { .. })),
                "--skeleton is for --as skin",
            ),
            (
                self.poses.is_some(),
                matches!(form, Some(PlayedForm::Correctives(_))),
                "--poses is for --as correctives",
            ),
            (
                self.root == Some(RootRule::Node),
                has_nodes,
                "--root node is for .glb and .usda files; allowed here are baked and none",
            ),
            (self.resume, kind != OutputKind::Nothing, "--resume needs an --output"),
            (self.resume, !is_picture, "--resume is not for pictures"),
            (
                self.pictures.is_given(),
                is_picture,
                "--tiles, --rest, --tile, --view, --up, --normals, --color, --beside and --close-up are for .png and .apng",
            ),
        ] {
            if is_given && !fits {
                return Err(CliFailure::Input(problem.into()));
            }
        }
        let usual = if has_nodes { RootRule::Node } else { RootRule::Baked };
        let output = AnimationOutput {
            path: self.output.clone().unwrap_or_default(),
            kind,
            root: self.root.unwrap_or(usual),
            resumes: self.resume,
            permission: self.permission,
        };
        if output.is_file() {
            output.permission.check_target(&output.path)?;
        }
        Ok(output)
    }

    fn kind_of(&self, path: &Path) -> Result<OutputKind, CliFailure> {
        let text = path.to_string_lossy();
        if text.ends_with(['/', std::path::MAIN_SEPARATOR]) || path.is_dir() {
            return Ok(OutputKind::Numbered(self.numbered_format()?));
        }
        if let Some(picture) = self.pictures.picture_at(path)? {
            return Ok(OutputKind::Pictured(picture));
        }
        if let Some(cache) = VertexCache::from_file_name(&text) {
            return Ok(OutputKind::Gathered(GatheredKind::Cache(cache)));
        }
        match usd_ending(&text).as_deref() {
            Some("usda") => return Ok(OutputKind::Gathered(GatheredKind::Usd)),
            Some(other) => {
                let problem = format!(
                    "USD is written as text, and .{other} is not; write a .usda, which every reader of USD takes"
                );
                return Err(CliFailure::unwritable(path, problem));
            }
            None => {}
        }
        match Format::from_file_name(&text) {
            Some(format) if format == Format::GLB => Ok(OutputKind::Gathered(GatheredKind::Glb(self.played_form()?))),
            Some(format) => {
                let problem = match format.refusal_to_write() {
                    Some(_) => format!("{format} is read, not written; {ALLOWED_OUTPUTS}"),
                    None => format!(
                        "one {format} holds one frame; a folder of them ends in a slash, with --format {format}"
                    ),
                };
                Err(CliFailure::unwritable(path, problem))
            }
            None => Err(CliFailure::Input(format!(
                "cannot determine what to write into {text}: {ALLOWED_OUTPUTS}"
            ))),
        }
    }

    /// How a GLB stores the frames.
    fn played_form(&self) -> Result<PlayedForm, CliFailure> {
        Ok(match self.played_as.unwrap_or(PlayedAs::Morph) {
            PlayedAs::Skin => {
                let allowed = 1..=DecompositionOptions::MOST_BONES;
                let bones = bounded("--bones", self.bones, USUAL_BONES, allowed)?;
                match self.skeleton.unwrap_or(SkeletonKind::Free) {
                    SkeletonKind::Free => PlayedForm::Bones(bones),
                    other => PlayedForm::RigBones {
                        has_twists: other == SkeletonKind::Twist,
                    },
                }
            }
            PlayedAs::Correctives => {
                PlayedForm::Correctives(bounded("--poses", self.poses, USUAL_POSES, 1..=MOST_POSES)?)
            }
            PlayedAs::Morph => {
                let targets = bounded("--max-targets", self.max_targets, USUAL_TARGETS, 2..=MOST_TARGETS)?;
                PlayedForm::Morphs(targets)
            }
        })
    }

    fn numbered_format(&self) -> Result<Format, CliFailure> {
        let Some(name) = &self.format else {
            return Ok(Format::OBJ);
        };
        let written = Format::from_name(name).filter(|format| format.refusal_to_write().is_none());
        written.ok_or_else(|| {
            let allowed = Format::name_list("and");
            CliFailure::Input(format!("--format is \"{name}\", allowed are {allowed}"))
        })
    }
}

/// The ending of a file name that USD uses, in small letters.
fn usd_ending(name: &str) -> Option<String> {
    let (_, ending) = name.rsplit_once('.')?;
    let ending = ending.to_ascii_lowercase();
    ["usd", "usda", "usdc", "usdz"]
        .contains(&ending.as_str())
        .then_some(ending)
}

impl AnimationOutput {
    /// Whether all frames go into one file.
    fn is_file(&self) -> bool {
        matches!(self.kind, OutputKind::Gathered(_) | OutputKind::Pictured(_))
    }

    /// Refuses a place where a file of the model itself lies. Numbered models look for that themselves, one by one.
    pub(super) fn spare_companions_of(&self, model: &Path, read: &FileSet) -> Result<(), CliFailure> {
        match self.is_file() {
            true => spare_companions(&self.path, model, read),
            false => Ok(()),
        }
    }

    /// Where frames go, in words; `None` where they go nowhere.
    pub(super) fn place(&self) -> Option<String> {
        (self.kind != OutputKind::Nothing).then(|| self.path.display().to_string())
    }

    /// Begins to write, or goes on with what is there.
    pub(super) fn begin<'a>(&self, played: PlayedAnimation<'a>) -> Result<Box<dyn FrameTaker + 'a>, CliFailure> {
        let path = &self.path;
        Ok(match &self.kind {
            OutputKind::Nothing => Box::new(MeasuredFrames(played.animation.range().clone())),
            OutputKind::Pictured(picture) => Box::new(PicturedFrames::begin(picture.clone(), played)?),
            OutputKind::Numbered(format) => {
                Box::new(NumberedFrames::begin(path.clone(), *format, self.resumes, played)?)
            }
            OutputKind::Gathered(kind) => {
                let has_root = self.root == RootRule::Node;
                Box::new(GatheredFrames::begin(path, *kind, has_root, self.resumes, played)?)
            }
        })
    }

    /// What of the output makes a difference to the frames that are kept.
    pub(super) fn identity(&self) -> String {
        let root = if self.root == RootRule::Baked { "baked" } else { "apart" };
        match &self.kind {
            OutputKind::Numbered(format) => format!("root {root}\nformat {format}\n"),
            _ => format!("root {root}\n"),
        }
    }
}

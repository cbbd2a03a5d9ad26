//! What `wrap`, `transfer` and `fit` write: a model, a report and a picture.

use super::drawing::{DrawnShape, NormalChoice, UpAxisChoice, ViewList, parse_views};
use super::input_files::{in_file, output_format};
use super::output_files::{OutputPermission, check_ending, spare_companions};
use super::terminal::{CliFailure, ComputeArgs, pretty_text};
use crate::asset::{FileSet, Format, Limits, Model, WrittenFiles};
use crate::pool::Pool;
use crate::render::{PictureSize, ShadedSurface, SheetShape, ViewSheet};
use crate::wire;
use clap::Args;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Where results go.
#[derive(Debug, Args)]
pub(super) struct ResultArgs {
    /// Output file; its extension selects the format
    #[arg(short, long)]
    pub output: PathBuf,
    /// Write the report as JSON
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Draw what was given and the result (.png)
    #[arg(long, value_name = "PICTURE")]
    pub picture: Option<PathBuf>,
    /// Views of the picture, as in `pliant render`; one of several shapes is drawn from the first view alone
    #[arg(long, value_name = "VIEWS", default_value = "front,three-quarter", value_parser = parse_views)]
    #[arg(allow_hyphen_values = true)]
    view: ViewList,
    /// Up axis of the models in the picture
    #[arg(long, value_enum, default_value_t = UpAxisChoice::Y)]
    up: UpAxisChoice,
    #[command(flatten)]
    permission: OutputPermission,
    /// Print the report as JSON on stdout
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub compute: ComputeArgs,
}

/// How a picture is laid out.
pub(super) struct SheetLayout {
    /// Width and height of one view, pixels.
    pub sides: [u32; 2],
    /// Shapes in a row, or views of all of them.
    pub columns: usize,
    /// Whether each shape is drawn from the first view alone.
    pub is_one_view: bool,
}

impl ResultArgs {
    /// The format of the output, where all may be written.
    pub fn checked_format(&self) -> Result<Format, CliFailure> {
        let format = output_format(&self.output)?;
        self.permission.check_target(&self.output)?;
        if let Some(picture) = &self.picture {
            check_ending(picture, "png", "a picture")?;
        }
        for path in self.beside() {
            if *path == self.output {
                let problem = format!("{} is where the result is written; name another file", path.display());
                return Err(CliFailure::Input(problem));
            }
            self.permission.check_target(path)?;
        }
        Ok(format)
    }

    /// Refuses to write report or picture over files that lie beside the model.
    pub fn spare(&self, model: &Path, files: &FileSet) -> Result<(), CliFailure> {
        self.beside().try_for_each(|path| spare_companions(path, model, files))
    }

    fn beside(&self) -> impl Iterator<Item = &PathBuf> {
        self.report.iter().chain(&self.picture)
    }

    /// Writes the result, made of `model`; answers the files.
    pub fn write_model(
        &self,
        written: &WrittenFiles,
        model: &Path,
        files: &FileSet,
    ) -> Result<Vec<String>, CliFailure> {
        let paths = (self.permission).write_model(&self.output, written, model, files)?;
        Ok(paths.iter().map(|p| p.display().to_string()).collect())
    }

    /// Writes the report where that is asked for.
    pub fn write_report<M: prost::Message + prost::Name>(&self, report: &M) -> Result<(), CliFailure> {
        let Some(path) = &self.report else {
            return Ok(());
        };
        let text = pretty_text(&wire::json::to_json(report)?)?;
        self.permission.write_file(path, text.as_bytes())
    }

    /// The result, read again.
    pub fn result(&self, written: &WrittenFiles) -> Result<Model, CliFailure> {
        let mut files = FileSet::single(self.output.display().to_string(), written.main.clone());
        for (uri, bytes) in &written.companions {
            files.companions.insert(uri.clone(), bytes.clone().into());
        }
        read_shape(files, &self.output)
    }

    /// Draws surfaces with captions as the picture.
    pub fn draw(
        &self,
        path: &Path,
        surfaces: &[(String, ShadedSurface)],
        layout: &SheetLayout,
        pool: &Pool,
    ) -> Result<(), CliFailure> {
        let shapes = surfaces.iter().map(|(caption, surface)| SheetShape {
            caption: caption.clone(),
            ..SheetShape::plain(surface)
        });
        let views = self.view.directions(self.up)?;
        let sheet = ViewSheet {
            shapes: shapes.collect(),
            views: if layout.is_one_view { &views[..1] } else { &views },
            size: PictureSize::new(layout.sides[0], layout.sides[1])?,
            columns: Some(layout.columns as u32),
            fits_each: true,
            key: None,
        };
        self.permission.write_file(path, &sheet.draw_views(pool)?.encode_png()?)
    }
}

/// Reads a model that is drawn.
pub(super) fn read_shape(files: FileSet, of: &Path) -> Result<Model, CliFailure> {
    Model::read(files, None, &Limits::default()).map_err(|e| in_file(of, e))
}

/// A model's surface with its materials and a caption.
pub(super) fn captioned(
    caption: &str,
    model: &Model,
    of: &Path,
    pool: &Pool,
) -> Result<(String, ShadedSurface), CliFailure> {
    let mut shape = DrawnShape::of_model(model, NormalChoice::File).map_err(|e| in_file(of, e))?;
    shape.wear_materials()?;
    Ok((caption.to_owned(), shape.surface(None, DVec3::ZERO, pool)?))
}

//! A file that rides along with a model: another model, of which every vertex follows, or Gaussian splats.

use super::error::Error;
use super::settings::CarriedModel;
use crate::asset::Format;
use crate::asset::{self, LargeSplatRule, Limits, Model, SplatMotion, SplatPlaces, Splats, WrittenFiles};
use crate::exec::Exec;
use crate::mesh::carry::SurfaceCarrier;
use crate::progress::{Cancelled, Progress};
use glam::DVec3;

/// A file that rides along: read once, moved each time that the rest pose changes and in the end, then written.
#[derive(Debug)]
pub struct RidingFile {
    content: RidingContent,
    output: Format,
}

#[derive(Debug)]
enum RidingContent {
    Model {
        model: Box<Model>,
        positions: Vec<DVec3>,
    },
    Splats {
        splats: Box<Splats>,
        /// Whether those larger than the bend around them are divided.
        divides: bool,
    },
}

impl RidingFile {
    /// Reads a file.
    ///
    /// # Errors
    /// Those of reading a model, and [`asset::Error::Unwritable`] for an output that does not hold what the file holds.
    pub fn read(
        passenger: CarriedModel,
        large_splats: LargeSplatRule,
        limits: &Limits,
        progress: &dyn Progress,
    ) -> Result<Self, asset::Error> {
        let CarriedModel {
            files, format, output, ..
        } = passenger;
        let unwritable = |format, problem: &str| {
            Err(asset::Error::Unwritable {
                format,
                problem: problem.into(),
            })
        };
        if let Some(format) = Splats::format_of(&files, format) {
            let splats = Splats::read(files, format, limits, progress)?;
            let output = output.unwrap_or(format);
            if !output.holds_splats() {
                return unwritable(output, "the file is of Gaussian splats; choose ply, splat or spz");
            }
            return Ok(Self {
                content: RidingContent::Splats {
                    splats: Box::new(splats),
                    divides: large_splats == LargeSplatRule::Divide,
                },
                output,
            });
        }
        let model = Model::read_passenger(files, format, limits, progress)?;
        let output = output.unwrap_or(model.format);
        if output.holds_splats_alone() {
            return unwritable(output, "the file holds no Gaussian splats");
        }
        Ok(Self {
            content: RidingContent::Model {
                positions: model.positions.clone(),
                model: Box::new(model),
            },
            output,
        })
    }

    /// Carries what it holds along, from the rest pose to the shape of `carrier`.
    ///
    /// # Errors
    /// [`Cancelled`]; the file is of no use then.
    pub fn move_along(&mut self, carrier: &SurfaceCarrier, exec: &Exec<'_>) -> Result<(), Cancelled> {
        match &mut self.content {
            RidingContent::Model { positions, .. } => {
                let moved = carrier.carry_points(positions, exec)?;
                *positions = moved.iter().map(|frame| frame.position).collect();
            }
            RidingContent::Splats { splats, divides } => {
                let motion = SplatMotion {
                    places: SplatPlaces::Carried,
                    divides: *divides,
                    bound: None,
                };
                splats.move_along(carrier, &motion, exec)?;
            }
        }
        Ok(())
    }

    /// Writes it.
    ///
    /// # Errors
    /// Those of writing a model.
    pub fn write(&self) -> Result<WrittenFiles, Error> {
        match &self.content {
            RidingContent::Model { model, positions } => Ok(model.write(positions, self.output)?),
            RidingContent::Splats { splats, .. } => Ok(splats.write(self.output)?),
        }
    }
}

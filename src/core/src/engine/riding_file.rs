//! A file that rides along with a model: another model, of which every vertex follows, or Gaussian splats.

use super::error::Error;
use super::settings::CarriedModel;
use crate::asset::{self, Format, Limits, Model, Splats, WrittenFiles, WrittenWarning};
use crate::exec::Exec;
use crate::mesh::carry::SurfaceCarrier;
use crate::progress::{Cancelled, Progress};
use glam::DVec3;

/// Splats that are carried before the next ones: what they need besides themselves is held for so many.
const SPLATS_AT_ONCE: usize = 1 << 16;
/// A splat ends so many standard deviations from its centre.
const SPLAT_END: f64 = 2.0;
/// Splats whose half length is below this fraction of the surface's diagonal are not asked whether they should be bent.
const SMALL: f64 = 0.01;
/// A splat is too large where its ends miss the motion around them by more than this fraction of their distance.
const BENT: f64 = 0.25;

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
        /// How many were too large for the last motion.
        bent: usize,
    },
}

impl RidingFile {
    /// Reads a file.
    ///
    /// # Errors
    /// Those of reading a model, and [`asset::Error::Unwritable`] for an output that does not hold what the file holds.
    pub fn read(passenger: CarriedModel, limits: &Limits, progress: &dyn Progress) -> Result<Self, asset::Error> {
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
                    bent: 0,
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
            RidingContent::Splats { splats, bent } => *bent = move_splats(splats, carrier, exec)?,
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
            RidingContent::Splats { splats, bent } => {
                let mut written = splats.write(self.output)?;
                if *bent > 0 {
                    let number = if *bent == 1 {
                        "1 splat is".into()
                    } else {
                        format!("{bent} splats are")
                    };
                    written.warnings.push(WrittenWarning {
                        code: "splats-large",
                        message: format!(
                            "{number} larger than the bend around them: they turn and stretch as a whole, and their ends stand off; \
                             divide them, or train with smaller ones"
                        ),
                        place: String::new(),
                    });
                }
                Ok(written)
            }
        }
    }
}

/// Carries splats along. Answers how many are too large for the motion.
fn move_splats(splats: &mut Splats, carrier: &SurfaceCarrier, exec: &Exec<'_>) -> Result<usize, Cancelled> {
    let stretch = carrier.stretch(exec.pool);
    let small = SMALL * carrier.diagonal();
    let mut bent = 0;
    for first in (0..splats.len()).step_by(SPLATS_AT_ONCE) {
        let own = first..splats.len().min(first + SPLATS_AT_ONCE);
        let spaces = carrier.carry_spaces(&stretch, &splats.centers()[own.clone()], exec)?;
        let halves = own.clone().map(|splat| splats.longest_axis(splat) * SPLAT_END);
        let large: Vec<(usize, DVec3)> = halves.enumerate().filter(|(_, half)| half.length() > small).collect();
        let ends = large.iter().flat_map(|&(k, half)| {
            let center = splats.centers()[first + k];
            [center + half, center - half]
        });
        let ends = carrier.carry_points(&ends.collect::<Vec<_>>(), exec)?;
        bent += large
            .iter()
            .zip(ends.as_chunks::<2>().0)
            .filter(|((k, half), ends)| {
                let space = &spaces[*k];
                let now = space.gradient * *half;
                let misses = [now, -now].into_iter().zip(ends.iter());
                let miss = misses.map(|(offset, end)| end.position.distance(space.frame.position + offset));
                miss.fold(0.0, f64::max) > BENT * now.length()
            })
            .count();
        splats.carry(first, &spaces, exec.pool);
    }
    Ok(bent)
}

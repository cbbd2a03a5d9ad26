//! Points and other models carried along with a shape of a deformer's model.

use super::Deformer;
use super::error::Error;
use super::riding::{CarriedNode, RidingNodes};
use super::riding_file::RidingFile;
use super::settings::{CarriedModel, HeldBeside};
use crate::asset::WrittenFiles;
use crate::exec::Exec;
use crate::mesh::carry::{CarriedFrame, LocalGradients, SurfaceCarrier};
use glam::DVec3;
use std::sync::Arc;

impl Deformer {
    /// Returns what carries points of the rest space along with a shape of this model, one position per render vertex.
    ///
    /// # Errors
    /// [`Error::Internal`] for the shape of another model.
    pub fn carrier(&self, positions: &[DVec3], exec: &Exec<'_>) -> Result<SurfaceCarrier, Error> {
        if positions.len() != self.rest().len() {
            return Err(Error::Internal("the shape of another model".into()));
        }
        let surface = Arc::clone(self.derived.carry_surface(exec.pool));
        exec.check()?;
        Ok(SurfaceCarrier::of_surface(
            surface,
            &self.mesh().welded(positions),
            exec.pool,
        ))
    }

    /// How space around each render vertex has turned and stretched in a shape of this model.
    ///
    /// # Errors
    /// [`Error::Internal`] for a shape of another model, and where what rides along cannot be bound, as in [`Deformer::solve`].
    pub fn gradients(&self, positions: &[DVec3], exec: &Exec<'_>) -> Result<Arc<LocalGradients>, Error> {
        if positions.len() != self.rest().len() {
            return Err(Error::Internal("the shape of another model".into()));
        }
        let frames = self.derived.pack_riders(&self.room_limits(), exec)?;
        let current = self.mesh().welded(positions);
        Ok(frames.place(&current, None, exec.pool))
    }

    /// Carries points of the rest space along with a shape of this model, in order.
    ///
    /// # Errors
    /// Those of [`Deformer::carrier`].
    pub fn carry_points(
        &self,
        positions: &[DVec3],
        points: &[DVec3],
        exec: &Exec<'_>,
    ) -> Result<Vec<CarriedFrame>, Error> {
        Ok(self.carrier(positions, exec)?.carry_points(points, exec)?)
    }

    /// Returns where a shape of this model carries the nodes of its file that follow it, in the order of
    /// [`OpenOptions::passengers`](super::OpenOptions::passengers).
    ///
    /// # Errors
    /// Those of [`Deformer::carrier`].
    pub fn carry_nodes(&self, positions: &[DVec3], exec: &Exec<'_>) -> Result<Vec<CarriedNode>, Error> {
        Ok(self.riding_nodes_at(positions, exec)?.places())
    }

    /// The nodes that ride along, where a shape carries them.
    pub(super) fn riding_nodes_at(&self, positions: &[DVec3], exec: &Exec<'_>) -> Result<Arc<RidingNodes>, Error> {
        let at_rest = &self.topology().riding_nodes;
        if at_rest.is_empty() {
            return Ok(Arc::clone(at_rest));
        }
        let carrier = self.carrier(positions, exec)?;
        Ok(Arc::new(at_rest.carried_along(&carrier, exec)?))
    }

    /// Carries another model, or Gaussian splats, that stand in the rest space along with a shape of this one, and writes them in
    /// `output`, or in their own format.
    ///
    /// # Errors
    /// Those of [`Deformer::carrier`] and of reading and writing a model; [`Error::Cancelled`].
    pub fn carry_model(
        &self,
        positions: &[DVec3],
        passenger: CarriedModel,
        exec: &Exec<'_>,
    ) -> Result<WrittenFiles, Error> {
        let beside = HeldBeside::of(self.byte_size(), exec.progress);
        let limits = self.room_limits().of_reading();
        let rule = self.options.following.large_splats;
        let mut file = RidingFile::read(passenger, rule, &limits, &beside)?;
        exec.check()?;
        file.move_along(&self.carrier(positions, exec)?, &Exec::new(exec.pool, &beside))?;
        exec.check()?;
        file.write()
    }
}

//! Points and other models carried along with a shape of a deformer's model.

use super::Deformer;
use super::error::Error;
use super::passenger::CarriedModel;
use crate::asset::{Model, WrittenFiles};
use crate::exec::Exec;
use crate::mesh::carry::{CarriedFrame, SurfaceCarrier};
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
        Ok(SurfaceCarrier::of_surface(surface, &self.welded(positions), exec.pool))
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
        Ok(self.carrier(positions, exec)?.carry_points(points, exec.pool))
    }

    /// Carries another model that stands in the rest space along with a shape of this one, and writes it in `output`, or in
    /// its own format.
    ///
    /// # Errors
    /// Those of [`Deformer::carrier`] and of reading and writing a model; [`Error::Cancelled`].
    pub fn carry_model(
        &self,
        positions: &[DVec3],
        passenger: CarriedModel,
        exec: &Exec<'_>,
    ) -> Result<WrittenFiles, Error> {
        let model = Model::read(passenger.files, passenger.format, &self.limits.model)?;
        exec.check()?;
        let carried = self.carry_points(positions, &model.positions, exec)?;
        let now: Vec<DVec3> = carried.iter().map(|frame| frame.position).collect();
        exec.check()?;
        Ok(model.write(&now, passenger.output.unwrap_or(model.format))?)
    }
}

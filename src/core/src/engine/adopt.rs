//! Shapes that are given and not solved for: vertices of a buffer, which become the rest pose bit for bit.

use super::Deformer;
use super::edit_command::{Edit, EditCommand, EditedShape};
use super::error::Error;
use super::shape::ModelShape;
use crate::exec::Exec;
use glam::{DVec3, Vec3};
use std::sync::Arc;

impl Deformer {
    /// The shape that an edit works on: the current one, that of the rest pose, or for [`Edit::Adopt`] either with its vertices where
    /// they are given.
    ///
    /// # Errors
    /// [`Error::Invalid`] for positions of another number of vertices; those of carrying passengers along; [`Error::Cancelled`].
    pub fn edited_shape(&self, order: &EditCommand<'_>, exec: &Exec<'_>) -> Result<ModelShape, Error> {
        let shape = match order.on {
            EditedShape::Current => order.shape.clone(),
            EditedShape::Rest => self.rest_shape(),
        };
        match order.edit {
            Edit::Adopt { positions } if !positions.is_empty() => self.adopted_shape(positions, shape, exec),
            Edit::Adopt { .. } if order.on == EditedShape::Rest => {
                let problem =
                    "is empty, but on is REST, which is the rest pose already; CURRENT is allowed, or positions";
                Err(Error::invalid("adopt.positions", problem))
            }
            _ => Ok(shape),
        }
    }

    /// A shape with its vertices where they are given; what rides along and has no place of its own follows. A place that is the
    /// one in the shape in single precision is that.
    fn adopted_shape(&self, given: &[[f32; 3]], shape: ModelShape, exec: &Exec<'_>) -> Result<ModelShape, Error> {
        let vertices = self.adopted_vertices(given.len())?;
        let origin = self.origin();
        let bits = |p: Vec3| p.to_array().map(f32::to_bits);
        let place = |now: DVec3, given: Vec3| match origin {
            _ if bits((now - origin).as_vec3()) == bits(given) => now,
            DVec3::ZERO => given.as_dvec3(),
            _ => origin + given.as_dvec3(),
        };
        let lay = |positions: &mut [DVec3]| {
            for (&vertex, given) in vertices.iter().zip(given) {
                let now = shape.positions[vertex as usize];
                positions[vertex as usize] = place(now, Vec3::from_array(*given));
            }
        };
        let mut positions = shape.positions.as_ref().clone();
        lay(&mut positions);
        let bits = |p: &DVec3| p.to_array().map(f64::to_bits);
        if positions.iter().map(bits).eq(shape.positions.iter().map(bits)) {
            return Ok(shape);
        }
        self.derived.bind_riders(&self.room_limits(), exec)?;
        if let Some((surface, riders)) = self.derived.riding_vertices() {
            let current = self.mesh().welded(&positions);
            riders.place(surface, &current, &mut positions, exec.pool);
            lay(&mut positions);
        }
        Ok(ModelShape::from_positions(Arc::new(positions)))
    }

    /// The render vertices that so many positions are of: all, or those that are no passenger's.
    fn adopted_vertices(&self, seen: usize) -> Result<Vec<u32>, Error> {
        let (all, passengers) = (self.rest().len(), self.topology().passenger_vertices());
        if seen == all {
            return Ok((0..all as u32).collect());
        }
        if passengers > 0 && seen + passengers == all {
            let own = self.geometry().primitives.iter().filter(|p| !p.is_passenger);
            return Ok(own.flat_map(|p| p.vertices().map(|v| v as u32)).collect());
        }
        let without = match passengers {
            0 => String::new(),
            _ => format!(", {} without those of passengers", all - passengers),
        };
        let problem = format!("has {seen} vertices, but the model has {all}{without}");
        Err(Error::invalid("adopt.positions", problem))
    }
}

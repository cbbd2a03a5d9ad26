//! Shapes that are not solved for: vertices of a buffer, which become the rest pose bit for bit, wraps, and shapes freed of crossings.

use super::Deformer;
use super::derived_structures::admit_bytes;
use super::edit_command::{Edit, EditCommand, EditKind, EditedShape, UnintersectReport};
use super::edit_operations::read_other;
use super::error::Error;
use super::facts::DeformerWarning;
use super::region_context::vertices_in_region;
use super::settings::HeldBeside;
use super::shape::ModelShape;
use super::wrap::{SurfaceWrapping, WRAPPED_BYTES, WrapCommand, WrapReport};
use crate::edit::check_faces_at_points;
use crate::exec::Exec;
use crate::mesh::{BoundingBox, NONE, brief_number};
use glam::{DVec3, Vec3};
use std::sync::Arc;

/// Places given in single precision are warned of where its steps are a larger share of the diagonal.
const COARSE_STEPS: f64 = 1e-5;
/// A triangle this flat, by its height over its longest side, has no area.
const FLAT: f64 = 1e-7;

/// What an edit works on.
#[derive(Debug, Clone)]
pub struct ShapeToEdit {
    /// The shape.
    pub shape: ModelShape,
    /// What a wrap that led to it came to.
    pub(super) wrap: Option<WrapReport>,
    /// What became of triangles that crossed before it.
    pub(super) unintersect: Option<UnintersectReport>,
    /// What is to be said of it.
    pub(super) warnings: Vec<DeformerWarning>,
}

impl Deformer {
    /// The shape that an edit works on: the current one, that of the rest pose, or either with its vertices where [`Edit::Adopt`]
    /// gives them, or [`Edit::Wrap`] or [`Edit::Unintersect`] finds them.
    ///
    /// # Errors
    /// [`Error::Invalid`] for positions of another number of vertices; those of a wrap and of carrying passengers along;
    /// [`Error::Cancelled`].
    pub fn shape_to_edit(&self, order: &EditCommand<'_>, exec: &Exec<'_>) -> Result<ShapeToEdit, Error> {
        let shape = match order.on {
            EditedShape::Current => order.shape.clone(),
            EditedShape::Rest => self.rest_shape(),
        };
        let seen = |shape| ShapeToEdit {
            shape,
            wrap: None,
            unintersect: None,
            warnings: Vec::new(),
        };
        match order.edit {
            Edit::Adopt { positions } if !positions.is_empty() => self.adopted_shape(positions, shape, exec).map(seen),
            Edit::Adopt { .. } if order.on == EditedShape::Rest => {
                let problem =
                    "is empty, but on is REST, which is the rest pose already; CURRENT is allowed, or positions";
                Err(Error::invalid("adopt.positions", problem))
            }
            Edit::Wrap(command) => self.wrapped_shape(command, &shape, exec),
            Edit::Unintersect(command) => self.unintersected_shape(command, shape, exec),
            _ => Ok(seen(shape)),
        }
    }

    /// A shape wrapped onto another model; what rides along follows.
    fn wrapped_shape(&self, command: &WrapCommand, shape: &ModelShape, exec: &Exec<'_>) -> Result<ShapeToEdit, Error> {
        // The deformer stays until the edit is whole.
        let beside = HeldBeside::of(self.byte_size(), exec.progress);
        let exec = &Exec::new(exec.pool, &beside);
        let limits = self.room_limits();
        let (_, target) = read_other(&command.target, EditKind::Wrap, &limits, exec)?;
        let surface = self.edit_surface(&shape.positions, &self.topology().origins(&self.derived.mesh), exec)?;
        check_faces_at_points(&surface.surface())?;
        let bytes = WRAPPED_BYTES * (u64::from(surface.points) + target.positions.len() as u64);
        admit_bytes(bytes, &limits, exec)?;
        let masked = match &command.mask {
            None => Vec::new(),
            Some(region) => {
                let regions = self.region_context(shape, exec);
                vertices_in_region(&regions, region, None).map_err(|e| e.below("wrap.mask"))?
            }
        };
        let wrapping = SurfaceWrapping {
            surface: surface.own_surface(),
            masked: &masked,
            target,
            body: &self.options.body,
            command,
        };
        let (places, report) = wrapping.wrap(exec)?;
        let mut positions = shape.positions.as_ref().clone();
        for (position, &point) in positions.iter_mut().zip(&surface.point_of).filter(|(_, p)| **p != NONE) {
            *position = places[point as usize];
        }
        self.place_riders(&mut positions, exec)?;
        let said = report.warnings().into_iter();
        Ok(ShapeToEdit {
            shape: ModelShape::from_positions(Arc::new(positions)),
            warnings: said.map(|w| DeformerWarning::new(w.code, w.message, "")).collect(),
            wrap: Some(report),
            unintersect: None,
        })
    }

    /// What is said of a shape that is given so far from the session's origin that frames and files in single precision tear it.
    pub(super) fn rounding_warning(&self, seen: &ShapeToEdit, is_given: bool) -> Option<DeformerWarning> {
        let bounds = BoundingBox::of(&seen.shape.positions);
        let far = (bounds.min - self.origin())
            .abs()
            .max((bounds.max - self.origin()).abs())
            .max_element();
        let (step, size) = (far * f64::from(f32::EPSILON), bounds.diagonal());
        (is_given && step > COARSE_STEPS * size).then(|| {
            let message = format!(
                "the shape is {} units from the session's origin and {} units large: positions in single precision have steps of up to {} \
                 units there; a shape near the origin, or a session opened of a file far away, keeps its details",
                brief_number(far),
                brief_number(size),
                brief_number(step)
            );
            DeformerWarning::new("places-rounded", message, "")
        })
    }

    /// What is said of a shape that is given with triangles without area, which have some in the rest shape.
    pub(super) fn flat_warning(&self, seen: &ShapeToEdit, is_given: bool) -> Option<DeformerWarning> {
        if !is_given {
            return None;
        }
        let mesh = self.mesh();
        let now = mesh.welded(&seen.shape.positions);
        let is_flat = |at: &[DVec3], triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|v| at[v as usize]);
            let longest = (b - a).length().max((c - a).length()).max((c - b).length());
            (b - a).cross(c - a).length() <= FLAT * longest * longest
        };
        let flat = mesh.triangles.iter().enumerate();
        let flat = flat.filter(|(_, triangle)| is_flat(&now, triangle) && !is_flat(&mesh.positions, triangle));
        let flat: Vec<u32> = flat.map(|(k, _)| mesh.source_triangle[k]).collect();
        let first = flat.first()?;
        let message = format!(
            "{} of {} triangles of the shape have no area, such as triangle {first}, and have some in the shape before: what is solved \
             from here on is bad there",
            flat.len(),
            mesh.triangles.len()
        );
        Some(DeformerWarning::new("triangles-flat", message, ""))
    }

    /// Puts what rides along where the surface of these positions takes it.
    pub(super) fn place_riders(&self, positions: &mut [DVec3], exec: &Exec<'_>) -> Result<(), Error> {
        self.derived.bind_riders(&self.room_limits(), exec)?;
        if let Some((surface, riders)) = self.derived.riding_vertices() {
            let current = self.mesh().welded(positions);
            riders.place(surface, &current, positions, exec.pool);
        }
        Ok(())
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
        self.place_riders(&mut positions, exec)?;
        lay(&mut positions);
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

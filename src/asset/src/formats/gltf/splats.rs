//! Gaussian splats of `KHR_gaussian_splatting`: rotations, scales and spherical harmonics follow the shape with their centres.
//!
//! Scales are standard deviations, rotations quaternions x, y, z, w; harmonics are those of 3DGS, three colours in each attribute.

use super::super::splats::{SplatAttributes, Splats, unsound_warning};
use super::accessors::ShapeAttribute;
use super::deformed::RowWriter;
use super::document::GltfDocument;
use super::read::GltfNotes;
use super::targets::{AttributeSlot, ChangedAttribute};
use crate::{Error, WrittenWarning};
use glam::{DQuat, DVec3};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Silent;
use pliant_mesh::carry::{CarriedFrame, CarriedSpace, SurfaceCarrier};
use pliant_mesh::rotation::nearest_rotation;

/// The warning of splats in a file that turn and stretch with nothing.
pub(super) fn unsound(doc: &GltfDocument<'_>, notes: &GltfNotes) -> Result<Option<WrittenWarning>, Error> {
    let mut count = 0;
    for row in &notes.rows {
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let turns = doc.read_attribute(primitive, ShapeAttribute::SplatTurn)?;
        let scales = doc.read_attribute(primitive, ShapeAttribute::SplatScale)?;
        count += match (turns, scales) {
            (None, None) => 0,
            (Some(turns), Some(scales)) if 3 * turns.len() == 4 * scales.len() => {
                let harmonics = Vec::new();
                let numbers = SplatAttributes {
                    turns,
                    scales,
                    harmonics,
                };
                numbers.unsound()
            }
            _ => row.vertices.len(),
        };
    }
    Ok(unsound_warning(count))
}

impl RowWriter<'_, '_> {
    /// What the attributes of splats become; nothing for primitives that are of none.
    pub(super) fn splat_changes(&self, moved: &[bool]) -> Result<Vec<(AttributeSlot, ChangedAttribute)>, Error> {
        let roles = [ShapeAttribute::SplatTurn, ShapeAttribute::SplatScale];
        let [Some(turns), Some(scales)] = self.stored_of(roles)? else {
            return Ok(Vec::new());
        };
        let mut harmonics = Vec::new();
        for k in 0..15 {
            match self.read_stored(ShapeAttribute::SplatHarmonic(k))? {
                Some(stored) => harmonics.push(stored),
                None => break,
            }
        }
        // Those of a whole degree.
        harmonics.truncate(
            [15, 8, 3, 0]
                .into_iter()
                .find(|whole| *whole <= harmonics.len())
                .unwrap_or(0),
        );
        let count = moved.len();
        let is_whole = turns.len() == 4 * count
            && scales.len() == 3 * count
            && harmonics.iter().all(|values| values.len() == 3 * count);
        if !is_whole {
            let place = format!("meshes/{}/primitives/{}", self.row.mesh, self.row.primitive);
            let problem = "attributes of splats have more or fewer elements than POSITION";
            return Err(self.doc.fault.malformed(place, problem));
        }
        let stored = SplatAttributes {
            turns,
            scales,
            harmonics,
        };
        let spaces = self.splat_spaces(moved)?;
        let mut splats = Splats::of_attributes(vec![DVec3::ZERO; count], &stored);
        self.with_exec(|exec| {
            splats.carry(0, &spaces, exec.pool);
            Ok(())
        })?;
        let now = splats.attributes(&stored);
        let mut changes = Vec::new();
        let mut add = |role: ShapeAttribute, stored: &[f32], values: Vec<f32>| {
            let change = ChangedAttribute::where_changed(stored, values, role.lanes());
            changes.extend(change.map(|change| (AttributeSlot::own(role), change)));
        };
        add(ShapeAttribute::SplatTurn, &stored.turns, now.turns);
        add(ShapeAttribute::SplatScale, &stored.scales, now.scales);
        for (k, (stored, now)) in stored.harmonics.iter().zip(now.harmonics).enumerate() {
            add(ShapeAttribute::SplatHarmonic(k as u8), stored, now);
        }
        Ok(changes)
    }

    fn stored_of<const N: usize>(&self, roles: [ShapeAttribute; N]) -> Result<[Option<Vec<f32>>; N], Error> {
        let mut stored = [const { None }; N];
        for (to, role) in stored.iter_mut().zip(roles) {
            *to = self.read_stored(role)?;
        }
        Ok(stored)
    }

    /// How space has moved around each splat, in the coordinates of the mesh; centres count as moved where they have.
    fn splat_spaces(&self, moved: &[bool]) -> Result<Vec<CarriedSpace>, Error> {
        let shape = self.shape;
        let solved = shape.rest.triangles_of_primitives().filter(|(p, _)| !p.is_passenger);
        let triangles: Vec<[u32; 3]> = solved.flat_map(|(_, triangles)| triangles.iter().copied()).collect();
        let own = self.row.vertices.clone();
        let spaces = self.with_exec(|exec| {
            let carrier = SurfaceCarrier::new(&triangles, &shape.rest.positions, shape.positions, exec.pool);
            let stretch = carrier.stretch(exec.pool);
            let spaces = carrier.carry_spaces(&stretch, &shape.rest.positions[own], &exec);
            spaces.map_err(|_| Error::Cancelled)
        })?;
        let in_mesh = |(i, space): (usize, CarriedSpace)| {
            if !moved[i] {
                return CarriedSpace::resting(DVec3::ZERO);
            }
            let (out, back) = (self.world_from_mesh.at(i).matrix3, self.mesh_from_world.at(i).matrix3);
            let turn = nearest_rotation(out, DQuat::IDENTITY);
            CarriedSpace {
                frame: CarriedFrame {
                    // Any place but the one where it rests.
                    position: DVec3::ONE,
                    rotation: turn.conjugate() * space.frame.rotation * turn,
                    scale: space.frame.scale,
                },
                gradient: back * space.gradient * out,
            }
        };
        Ok(spaces.into_iter().enumerate().map(in_mesh).collect())
    }

    fn with_exec<T>(&self, work: impl FnOnce(Exec<'_>) -> Result<T, Error>) -> Result<T, Error> {
        match self.shape.exec {
            Some(exec) => work(exec),
            None => {
                let pool = Pool::new(1).map_err(|e| self.shape.fault.unwritable(e.to_string()))?;
                work(Exec::new(&pool, &Silent))
            }
        }
    }
}

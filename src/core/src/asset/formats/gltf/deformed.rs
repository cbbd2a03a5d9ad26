//! What each attribute should become: deformed positions back in mesh space, normals and tangents carried along.

use super::accessors::{ShapeAttribute, read_floats};
use super::buffers::BufferBytes;
use super::document::GltfDocument;
use super::fault::GltfFault;
use super::read::{GltfNotes, PlacedPrimitive, invert};
use crate::asset::{Error, Geometry};
use crate::mesh::shading;
use glam::{DAffine3, DMat3, DVec3, Vec3, Vec4};
use std::collections::BTreeSet;
use std::hash::{Hash as _, Hasher as _};

/// New values of one attribute, all elements, lane by lane.
#[derive(Debug, Clone)]
pub(super) struct ChangedAttribute {
    pub(super) values: Vec<f32>,
    /// Which elements differ from the stored ones.
    pub(super) changed: Vec<bool>,
}

impl ChangedAttribute {
    fn where_changed(stored: &[f32], values: Vec<f32>, lanes: usize) -> Option<Self> {
        let differ = |(a, b): (&[f32], &[f32])| a.iter().zip(b).any(|(a, b)| a.to_bits() != b.to_bits());
        let changed: Vec<bool> = stored
            .chunks_exact(lanes)
            .zip(values.chunks_exact(lanes))
            .map(differ)
            .collect();
        changed.contains(&true).then_some(Self { values, changed })
    }

    /// Equal for what is the same, nearly always different for what is not.
    pub(super) fn fingerprint(&self) -> u64 {
        let mut hasher = std::hash::DefaultHasher::new();
        self.values.iter().for_each(|v| hasher.write_u32(v.to_bits()));
        hasher.finish()
    }

    /// Whether two attributes become the same.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.values.len() == other.values.len()
            && self
                .values
                .iter()
                .zip(&other.values)
                .all(|(a, b)| a.to_bits() == b.to_bits())
    }
}

/// What one row of the primitive table should become; `None` for what stays as it is stored. In the order of
/// [`ShapeAttribute::ALL`].
#[derive(Debug, Clone, Default)]
pub(super) struct DeformedAttributes(pub(super) [Option<ChangedAttribute>; 3]);

impl DeformedAttributes {
    pub(super) fn is_changed(&self) -> bool {
        self.0.iter().any(Option::is_some)
    }

    /// Equal for what is the same, nearly always different for what is not.
    pub(super) fn fingerprint(&self) -> u64 {
        let mut hasher = std::hash::DefaultHasher::new();
        for channel in &self.0 {
            channel.is_some().hash(&mut hasher);
            channel
                .iter()
                .flat_map(|c| &c.values)
                .for_each(|v| v.to_bits().hash(&mut hasher));
        }
        hasher.finish()
    }

    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.0.iter().zip(&other.0).all(|pair| match pair {
            (None, None) => true,
            (Some(a), Some(b)) => a.is_same(b),
            _ => false,
        })
    }
}

/// What every row should become at `positions`, of which there is one finite one per vertex. `fault` names the format
/// that is written.
pub(super) fn wanted_attributes(
    doc: &GltfDocument<'_>,
    buffers: &mut BufferBytes,
    notes: &GltfNotes,
    rest: &Geometry,
    positions: &[DVec3],
    fault: GltfFault,
) -> Result<Vec<DeformedAttributes>, Error> {
    notes
        .rows
        .iter()
        .map(|row| {
            let moved = moved_vertices(&rest.positions[row.vertices.clone()], &positions[row.vertices.clone()]);
            if !moved.contains(&true) {
                return Ok(DeformedAttributes::default());
            }
            let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
            let used: BTreeSet<usize> = ShapeAttribute::ALL
                .iter()
                .filter_map(|r| primitive.attribute(r.name()))
                .collect();
            buffers.decode_for(doc, &used)?;
            RowWriter {
                doc,
                buffers,
                row,
                rest,
                positions,
                fault,
            }
            .wanted_attributes(&moved)
        })
        .collect()
}

fn moved_vertices(rest: &[DVec3], now: &[DVec3]) -> Vec<bool> {
    let bits = |p: &DVec3| p.to_array().map(f64::to_bits);
    rest.iter().zip(now).map(|(p, q)| bits(p) != bits(q)).collect()
}

struct RowWriter<'a, 'f> {
    doc: &'a GltfDocument<'f>,
    buffers: &'a BufferBytes,
    row: &'a PlacedPrimitive,
    rest: &'a Geometry,
    positions: &'a [DVec3],
    fault: GltfFault,
}

impl RowWriter<'_, '_> {
    fn wanted_attributes(&self, moved: &[bool]) -> Result<DeformedAttributes, Error> {
        let Some(mesh_from_world) = invert(&self.row.world_from_mesh) else {
            return Err(self.fault.unwritable(format!(
                "vertices under node {} have moved, but its transform flattens space and cannot be inverted",
                self.row.node
            )));
        };
        let position = self.position_change(moved, &mesh_from_world)?;
        let normals = self.read_stored(ShapeAttribute::Normal)?;
        let tangents = self.read_stored(ShapeAttribute::Tangent)?;
        if position.is_none() || (normals.is_none() && tangents.is_none()) {
            return Ok(DeformedAttributes([position, None, None]));
        }
        let gradients = self.gradients();
        let normal = normals.and_then(|stored| self.normal_change(&stored, &gradients));
        let tangent = tangents.and_then(|stored| self.tangent_change(&stored, &gradients, &mesh_from_world.matrix3));
        Ok(DeformedAttributes([position, normal, tangent]))
    }

    fn read_stored(&self, role: ShapeAttribute) -> Result<Option<Vec<f32>>, Error> {
        let primitive = &self.doc.meshes.values[self.row.mesh].primitives[self.row.primitive];
        primitive
            .attribute(role.name())
            .map(|a| read_floats(self.doc, self.buffers, a, role))
            .transpose()
    }

    fn position_change(&self, moved: &[bool], mesh_from_world: &DAffine3) -> Result<Option<ChangedAttribute>, Error> {
        let Some(stored) = self.read_stored(ShapeAttribute::Position)? else {
            return Ok(None);
        };
        let mut values = stored.clone();
        let places = values
            .as_chunks_mut::<3>()
            .0
            .iter_mut()
            .zip(&self.positions[self.row.vertices.clone()]);
        for (i, (place, &in_world)) in places.enumerate() {
            if moved[i] {
                let in_mesh = mesh_from_world.transform_point3(in_world).as_vec3();
                if !in_mesh.is_finite() {
                    let vertex = self.row.vertices.start + i;
                    let problem = format!("the position {in_world} of vertex {vertex} is beyond 32-bit floats");
                    return Err(self.fault.unwritable(problem));
                }
                *place = in_mesh.to_array();
            }
        }
        Ok(ChangedAttribute::where_changed(&stored, values, 3))
    }

    /// Deformation gradients of the row's vertices, in world space.
    fn gradients(&self) -> Vec<Option<DMat3>> {
        let PlacedPrimitive { vertices, .. } = self.row;
        let triangles = self.local_triangles();
        let (rest, now) = (
            &self.rest.positions[vertices.clone()],
            &self.positions[vertices.clone()],
        );
        shading::gradients(rest, now, &triangles, &triangles, vertices.len())
    }

    fn local_triangles(&self) -> Vec<[u32; 3]> {
        let first = self.row.vertices.start as u32;
        self.rest.triangles[self.row.triangles.clone()]
            .iter()
            .map(|t| t.map(|v| v - first))
            .collect()
    }

    fn carried_normal(&self, vertex: usize, gradient: &DMat3) -> Option<(Vec3, Vec3)> {
        let rest = *self.rest.normals.get(self.row.vertices.start + vertex)?;
        (rest != Vec3::ZERO).then(|| (rest, shading::carry_normal(gradient, rest)))
    }

    fn normal_change(&self, stored: &[f32], gradients: &[Option<DMat3>]) -> Option<ChangedAttribute> {
        let mesh_from_normal = self.row.world_from_mesh.matrix3.transpose();
        let to_mesh = |n: Vec3| {
            (mesh_from_normal * n.as_dvec3())
                .try_normalize()
                .map(|n| n.as_vec3().to_array())
        };
        let mut values = stored.to_vec();
        for (i, place) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let carried = gradients[i].as_ref().and_then(|g| self.carried_normal(i, g));
            if let Some((rest, now)) = carried.filter(|(rest, now)| has_turned(rest.extend(0.0), now.extend(0.0))) {
                *place = to_mesh(now).filter(|_| rest.is_finite()).unwrap_or(*place);
            }
        }
        if values.iter().any(|v| !v.is_finite()) {
            // What is written anew must not hold NaN, even where the file did.
            let now = &self.positions[self.row.vertices.clone()];
            let smooth = shading::smooth_normals(now, &self.local_triangles());
            for (place, smooth) in values.as_chunks_mut::<3>().0.iter_mut().zip(smooth) {
                if !Vec3::from_array(*place).is_finite() {
                    *place = to_mesh(smooth).unwrap_or([0.0, 0.0, 1.0]);
                }
            }
        }
        ChangedAttribute::where_changed(stored, values, 3)
    }

    fn tangent_change(
        &self,
        stored: &[f32],
        gradients: &[Option<DMat3>],
        mesh_from_world: &DMat3,
    ) -> Option<ChangedAttribute> {
        let mut values = stored.to_vec();
        for (i, place) in values.as_chunks_mut::<4>().0.iter_mut().enumerate() {
            let rest = self
                .rest
                .tangents
                .get(self.row.vertices.start + i)
                .copied()
                .unwrap_or(Vec4::ZERO);
            if let Some(gradient) = gradients[i].as_ref().filter(|_| rest.truncate() != Vec3::ZERO) {
                // Without a normal there is nothing to stay orthogonal to.
                let normal = self.carried_normal(i, gradient).map_or(Vec3::ZERO, |(_, now)| now);
                let now = shading::carry_tangent(gradient, rest, normal);
                let in_mesh = (*mesh_from_world * now.truncate().as_dvec3()).try_normalize();
                if let Some(t) = in_mesh.filter(|_| has_turned(rest, now)) {
                    // The stored handedness, not the world's, which mirroring may have turned.
                    *place = t.as_vec3().extend(place[3]).to_array();
                }
            }
            if !Vec4::from_array(*place).is_finite() {
                let normal = gradients[i]
                    .as_ref()
                    .and_then(|g| self.carried_normal(i, g))
                    .map_or(Vec3::Z, |(_, n)| n);
                let across = (*mesh_from_world * normal.any_orthonormal_vector().as_dvec3()).try_normalize();
                *place = across.unwrap_or(DVec3::X).as_vec3().extend(1.0).to_array();
            }
        }
        ChangedAttribute::where_changed(stored, values, 4)
    }
}

/// Whether a direction has turned by more than rounding: a mere translation must not touch normals.
fn has_turned(rest: Vec4, now: Vec4) -> bool {
    (now - rest).abs().max_element() > 2.5e-7
}

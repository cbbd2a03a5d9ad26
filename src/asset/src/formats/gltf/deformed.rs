//! What each attribute should become: deformed positions back in mesh space, normals and tangents carried along.

use super::accessors::ShapeAttribute;
use super::container::GltfFault;
use super::document::GltfDocument;
use super::placement::VertexTransforms;
use super::read::{GltfNotes, PlacedPrimitive};
use super::rig::rewrite::followable;
use super::targets::{AttributeSlot, ChangedAttribute, DeformedAttributes, TargetCarrier, TargetTally};
use crate::files::WrittenWarning;
use crate::{Error, FollowedCounts, Format, Geometry};
use glam::{DMat3, DVec3, Vec3, Vec4};
use pliant_exec::Exec;
use pliant_mesh::local_turns::LocalTurn;
use pliant_mesh::{BoundingBox, shading};

/// A new shape of a model, and what follows it.
pub(super) struct NewShape<'a> {
    pub(super) rest: &'a Geometry,
    /// One finite one per vertex.
    pub(super) positions: &'a [DVec3],
    /// How the surface turned around each vertex, for displacements of morph targets; `None`: they stay as they are stored.
    pub(super) turns: Option<Vec<Option<LocalTurn>>>,
    /// Names the format that is written.
    pub(super) fault: GltfFault,
    /// Where splats are carried along.
    pub(super) exec: Option<Exec<'a>>,
}

/// What every row should become.
pub(super) fn wanted_attributes(
    doc: &GltfDocument<'_>,
    notes: &GltfNotes,
    shape: &NewShape<'_>,
    tally: &mut TargetTally,
) -> Result<Vec<DeformedAttributes>, Error> {
    notes
        .rows
        .iter()
        .map(|row| {
            let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
            tally.meet(0, row.node, primitive);
            let own = row.vertices.clone();
            let moved = moved_vertices(&shape.rest.positions[own.clone()], &shape.positions[own]);
            if !moved.contains(&true) {
                return Ok(DeformedAttributes::default());
            }
            let world_from_mesh = row.placement.transforms(doc, primitive)?;
            let Some(mesh_from_world) = world_from_mesh.inverse() else {
                if row.triangles.is_empty() {
                    // Points and lines stay as they are stored; what the reader warned of.
                    return Ok(DeformedAttributes::default());
                }
                return Err(shape.fault.unwritable(format!(
                    "vertices under node {} have moved, but its transform flattens space and cannot be inverted",
                    row.node
                )));
            };
            let writer = RowWriter {
                doc,
                row,
                world_from_mesh,
                mesh_from_world,
                shape,
            };
            let mut changes = writer.own_changes(&moved)?;
            if let Some(turns) = &shape.turns {
                let turns = &turns[row.vertices.clone()];
                let carrier = TargetCarrier {
                    turns,
                    world_from_old: &writer.world_from_mesh,
                    new_from_world: &writer.mesh_from_world,
                };
                let of_targets = carrier.changes(doc, primitive, tally)?;
                for target in of_targets.iter().filter_map(|(slot, _)| slot.target) {
                    tally.carry(0, row.node, target);
                }
                changes.extend(of_targets);
            }
            Ok(DeformedAttributes(changes))
        })
        .collect()
}

/// The warning of places that the numbers of their mesh round, far from its origin.
pub(super) fn rounded_places(
    doc: &GltfDocument<'_>,
    notes: &GltfNotes,
    positions: &[DVec3],
    format: Format,
) -> Result<Option<WrittenWarning>, Error> {
    let whole = BoundingBox::of(positions);
    if !whole.is_far() {
        return Ok(None);
    }
    for row in &notes.rows {
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let Some(mesh_from_world) = row.placement.transforms(doc, primitive)?.inverse() else {
            continue;
        };
        let own = positions[row.vertices.clone()].iter().enumerate();
        let in_mesh: Vec<DVec3> = own.map(|(i, p)| mesh_from_world.at(i).transform_point3(*p)).collect();
        // A short line is not a small model: its places are as exact as those of all others.
        let scale = libm::cbrt(mesh_from_world.at(0).matrix3.determinant().abs());
        if !BoundingBox::of(&in_mesh).is_far_for(scale * whole.diagonal()) {
            continue;
        }
        let warning = WrittenWarning::rounded(&in_mesh, format);
        if warning.is_some() {
            return Ok(warning);
        }
    }
    Ok(None)
}

fn moved_vertices(rest: &[DVec3], now: &[DVec3]) -> Vec<bool> {
    let bits = |p: &DVec3| p.to_array().map(f64::to_bits);
    rest.iter().zip(now).map(|(p, q)| bits(p) != bits(q)).collect()
}

pub(super) struct RowWriter<'a, 'f> {
    pub(super) doc: &'a GltfDocument<'f>,
    pub(super) row: &'a PlacedPrimitive,
    pub(super) world_from_mesh: VertexTransforms,
    pub(super) mesh_from_world: VertexTransforms,
    pub(super) shape: &'a NewShape<'a>,
}

impl RowWriter<'_, '_> {
    /// What the primitive's own attributes become.
    fn own_changes(&self, moved: &[bool]) -> Result<Vec<(AttributeSlot, ChangedAttribute)>, Error> {
        let mut changes = Vec::new();
        let mut add = |role, change: Option<ChangedAttribute>| {
            changes.extend(change.map(|change| (AttributeSlot::own(role), change)));
        };
        let position = self.position_change(moved)?;
        let normals = self.read_stored(ShapeAttribute::Normal)?;
        let tangents = self.read_stored(ShapeAttribute::Tangent)?;
        let has_shading = position.is_some() && (normals.is_some() || tangents.is_some());
        add(ShapeAttribute::Position, position);
        if has_shading {
            let gradients = self.gradients();
            let normal = normals.and_then(|stored| self.normal_change(&stored, &gradients));
            add(ShapeAttribute::Normal, normal);
            let tangent = tangents.and_then(|stored| self.tangent_change(&stored, &gradients));
            add(ShapeAttribute::Tangent, tangent);
        }
        changes.extend(self.splat_changes(moved)?);
        Ok(changes)
    }

    pub(super) fn read_stored(&self, role: ShapeAttribute) -> Result<Option<Vec<f32>>, Error> {
        let primitive = &self.doc.meshes.values[self.row.mesh].primitives[self.row.primitive];
        self.doc.read_attribute(primitive, role)
    }

    fn position_change(&self, moved: &[bool]) -> Result<Option<ChangedAttribute>, Error> {
        let Some(stored) = self.read_stored(ShapeAttribute::Position)? else {
            return Ok(None);
        };
        let mut values = stored.clone();
        let places = values
            .as_chunks_mut::<3>()
            .0
            .iter_mut()
            .zip(&self.shape.positions[self.row.vertices.clone()]);
        for (i, (place, &in_world)) in places.enumerate() {
            if moved[i] {
                let in_mesh = self.mesh_from_world.at(i).transform_point3(in_world).as_vec3();
                if !in_mesh.is_finite() {
                    let vertex = self.row.vertices.start + i;
                    let problem = format!("the position {in_world} of vertex {vertex} is beyond 32-bit floats");
                    return Err(self.shape.fault.unwritable(problem));
                }
                *place = in_mesh.to_array();
            }
        }
        Ok(ChangedAttribute::where_changed(&stored, values, 3))
    }

    /// Deformation gradients of the row's vertices, in world space.
    fn gradients(&self) -> Vec<Option<DMat3>> {
        let PlacedPrimitive {
            vertices, triangles, ..
        } = self.row;
        if triangles.is_empty() {
            // Points and lines turn with the surface around them.
            let NewShape { rest, positions, .. } = self.shape;
            let all = shading::gradients_of_all(&rest.positions, positions, &rest.triangles, vertices.clone());
            return all[vertices.clone()].to_vec();
        }
        let triangles = self.local_triangles();
        let (rest, now) = (
            &self.shape.rest.positions[vertices.clone()],
            &self.shape.positions[vertices.clone()],
        );
        shading::gradients(rest, now, &triangles, &triangles, vertices.len())
    }

    fn local_triangles(&self) -> Vec<[u32; 3]> {
        let first = self.row.vertices.start as u32;
        self.shape.rest.triangles[self.row.triangles.clone()]
            .iter()
            .map(|t| t.map(|v| v - first))
            .collect()
    }

    fn carried_normal(&self, vertex: usize, gradient: &DMat3) -> Option<(Vec3, Vec3)> {
        let rest = *self.shape.rest.normals.get(self.row.vertices.start + vertex)?;
        (rest != Vec3::ZERO).then(|| (rest, shading::carry_normal(gradient, rest)))
    }

    fn normal_change(&self, stored: &[f32], gradients: &[Option<DMat3>]) -> Option<ChangedAttribute> {
        let to_mesh = |i: usize, n: Vec3| {
            (self.world_from_mesh.at(i).matrix3.transpose() * n.as_dvec3())
                .try_normalize()
                .map(|n| n.as_vec3().to_array())
        };
        let mut values = stored.to_vec();
        for (i, place) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let carried = gradients[i].as_ref().and_then(|g| self.carried_normal(i, g));
            if let Some((rest, now)) = carried.filter(|(rest, now)| has_turned(rest.extend(0.0), now.extend(0.0))) {
                *place = to_mesh(i, now).filter(|_| rest.is_finite()).unwrap_or(*place);
            }
        }
        if values.iter().any(|v| !v.is_finite()) {
            // New values must not hold NaN, even where the file did.
            let now = &self.shape.positions[self.row.vertices.clone()];
            let smooth = shading::smooth_normals(now, &self.local_triangles());
            for (i, (place, smooth)) in values.as_chunks_mut::<3>().0.iter_mut().zip(smooth).enumerate() {
                if !Vec3::from_array(*place).is_finite() {
                    *place = to_mesh(i, smooth).unwrap_or([0.0, 0.0, 1.0]);
                }
            }
        }
        ChangedAttribute::where_changed(stored, values, 3)
    }

    fn tangent_change(&self, stored: &[f32], gradients: &[Option<DMat3>]) -> Option<ChangedAttribute> {
        let mut values = stored.to_vec();
        for (i, place) in values.as_chunks_mut::<4>().0.iter_mut().enumerate() {
            let rest = self
                .shape
                .rest
                .tangents
                .get(self.row.vertices.start + i)
                .copied()
                .unwrap_or(Vec4::ZERO);
            if let Some(gradient) = gradients[i].as_ref().filter(|_| rest.truncate() != Vec3::ZERO) {
                // Without a normal there is nothing to stay orthogonal to.
                let normal = self.carried_normal(i, gradient).map_or(Vec3::ZERO, |(_, now)| now);
                let now = shading::carry_tangent(gradient, rest, normal);
                let in_mesh = self
                    .mesh_from_world
                    .at(i)
                    .transform_vector3(now.truncate().as_dvec3())
                    .try_normalize();
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
                let across = normal.any_orthonormal_vector().as_dvec3();
                let across = self.mesh_from_world.at(i).transform_vector3(across).try_normalize();
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

/// The counts of a document that is returned unchanged.
pub(super) fn nothing_followed(doc: &GltfDocument<'_>, notes: &GltfNotes) -> FollowedCounts {
    let mut tally = TargetTally::default();
    for row in &notes.rows {
        tally.meet(0, row.node, &doc.meshes.values[row.mesh].primitives[row.primitive]);
    }
    let mut counts = followable(doc, doc.items(&doc.animations));
    tally.count_into(&mut counts);
    counts
}

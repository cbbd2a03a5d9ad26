//! The accessors of one edited primitive.

use super::super::accessors::{AccessorLayout, ShapeAttribute, read_floats};
use super::super::buffers::BufferBytes;
use super::super::document::GltfDocument;
use super::super::fault::GltfFault;
use super::super::read::{PlacedPrimitive, invert};
use super::super::schema::{Attributes, MeshPrimitive};
use super::channels::{AttributeBlender, AttributeValues, read, shape_of};
use super::fresh::{NewAccessorKind, NewAccessors};
use crate::asset::Error;
use crate::asset::edited::{CarriedAttributes, EditedModel, PrimitiveRun, VertexBlend};
use crate::asset::model::position_bits;
use glam::{DAffine3, DVec3, Vec3, Vec4};
use std::collections::{BTreeMap, BTreeSet};

/// Which accessor an attribute has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AccessorHandle {
    /// One of the file that the primitive came from.
    Old(usize),
    /// A new one.
    New(usize),
}

/// A primitive's accessors by attribute, of itself and of each morph target, and its indices.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct MadePrimitive {
    pub(super) attributes: BTreeMap<String, AccessorHandle>,
    pub(super) targets: Vec<BTreeMap<String, AccessorHandle>>,
    /// `None` where the stored ones stay, with the stored mode.
    pub(super) indices: Option<AccessorHandle>,
}

/// Makes the primitives of one base.
pub(super) struct PrimitiveMaker<'a, 'f> {
    pub(super) doc: &'a GltfDocument<'f>,
    pub(super) buffers: &'a mut BufferBytes,
    pub(super) edited: &'a EditedModel<'a>,
    pub(super) positions: &'a [DVec3],
    pub(super) fresh: &'a mut NewAccessors,
    pub(super) fault: GltfFault,
    /// Whether accessors of the file may be named, because the file is the frame of the result.
    pub(super) is_frame: bool,
}

impl<'a> PrimitiveMaker<'a, '_> {
    /// The accessors of a run whose mesh is drawn at `world_from_mesh`; `None` when the primitive stays as it is stored.
    pub(super) fn make_primitive(
        &mut self,
        run: &'a PrimitiveRun,
        row: &PlacedPrimitive,
        world_from_mesh: &DAffine3,
    ) -> Result<Option<MadePrimitive>, Error> {
        let doc = self.doc;
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let base = self.edited.base(run);
        let old = &base.model.geometry;
        let untouched = self.is_frame && self.edited.is_untouched(run, &old.triangles[row.triangles.clone()]);
        if untouched {
            let now = &self.positions[run.vertices()];
            let rest = &old.positions[row.vertices.clone()];
            if now
                .iter()
                .zip(rest)
                .all(|(a, b)| position_bits(*a) == position_bits(*b))
            {
                return Ok(None);
            }
        }
        let mut used: BTreeSet<usize> = primitive.attributes.values().map(|a| a.index()).collect();
        used.extend(primitive.targets.iter().flat_map(|t| t.values()).map(|a| a.index()));
        self.buffers.decode_for(doc, &used)?;

        let carried = CarriedAttributes::new(self.edited, run, self.positions);
        let positions = self.mesh_positions(run, row, primitive, world_from_mesh)?;
        let mut attributes = self.write_shape(&positions, primitive, world_from_mesh, &carried);
        let mut targets = Vec::new();
        let indices = if untouched {
            let old = |all: &Attributes| {
                all.iter()
                    .map(|(k, v)| (k.clone(), AccessorHandle::Old(v.index())))
                    .collect()
            };
            let stays: BTreeMap<String, AccessorHandle> = old(&primitive.attributes);
            for (name, at) in stays {
                attributes.entry(name).or_insert(at);
            }
            targets.extend(primitive.targets.iter().map(old));
            None
        } else {
            let mixer = AttributeBlender::new(self.edited, run);
            self.blend_other_attributes(primitive, &mixer, &mut attributes)?;
            for target in &primitive.targets {
                targets.push(self.blend_target(target, &mixer)?);
            }
            let mut triangles = carried.triangles;
            if world_from_mesh.matrix3.determinant() < 0.0 {
                // Read as it is drawn, written as it is stored: turned round.
                triangles.iter_mut().for_each(|t| t.swap(1, 2));
            }
            Some(AccessorHandle::New(
                self.fresh.add_indices(&triangles, run.vertex_count as usize),
            ))
        };
        Ok(Some(MadePrimitive {
            attributes,
            targets,
            indices,
        }))
    }

    /// Writes positions, and normals and tangents where the primitive has them.
    fn write_shape(
        &mut self,
        positions: &[f32],
        primitive: &MeshPrimitive,
        world_from_mesh: &DAffine3,
        carried: &CarriedAttributes<'_>,
    ) -> BTreeMap<String, AccessorHandle> {
        let mut attributes = BTreeMap::new();
        let at = self.fresh.add_floats(positions, 3, "VEC3", NewAccessorKind::Positions);
        attributes.insert(ShapeAttribute::Position.name().into(), AccessorHandle::New(at));
        let matrix = &world_from_mesh.matrix3;
        let (has_normal, has_tangent) = (
            primitive.attribute(ShapeAttribute::Normal.name()).is_some(),
            primitive.attribute(ShapeAttribute::Tangent.name()).is_some(),
        );
        if !has_normal && !has_tangent {
            return attributes;
        }
        let normals = carried.normals();
        let mesh_from_normal = matrix.transpose();
        if has_normal {
            let to_mesh = |n: &Vec3| (mesh_from_normal * n.as_dvec3()).try_normalize().unwrap_or(DVec3::Z);
            let values: Vec<f32> = normals.iter().flat_map(|n| to_mesh(n).as_vec3().to_array()).collect();
            let at = self.fresh.add_floats(&values, 3, "VEC3", NewAccessorKind::Floats);
            attributes.insert(ShapeAttribute::Normal.name().into(), AccessorHandle::New(at));
        }
        if has_tangent {
            let mesh_from_world = invert(world_from_mesh).map_or(glam::DMat3::IDENTITY, |m| m.matrix3);
            let side = if matrix.determinant() < 0.0 { -1.0 } else { 1.0 };
            let to_mesh = |t: &Vec4| {
                let along = (mesh_from_world * t.truncate().as_dvec3())
                    .try_normalize()
                    .unwrap_or(DVec3::X);
                along.as_vec3().extend(t.w * side).to_array()
            };
            let values: Vec<f32> = carried.tangents(&normals).iter().flat_map(to_mesh).collect();
            let at = self.fresh.add_floats(&values, 4, "VEC4", NewAccessorKind::Floats);
            attributes.insert(ShapeAttribute::Tangent.name().into(), AccessorHandle::New(at));
        }
        attributes
    }

    /// Positions of a run in the space of its mesh, those that did not move as they are stored.
    fn mesh_positions(
        &self,
        run: &PrimitiveRun,
        row: &PlacedPrimitive,
        primitive: &MeshPrimitive,
        world_from_mesh: &DAffine3,
    ) -> Result<Vec<f32>, Error> {
        let stored = match primitive.attribute(ShapeAttribute::Position.name()) {
            Some(accessor) => read_floats(self.doc, self.buffers, accessor, ShapeAttribute::Position)?,
            None => Vec::new(),
        };
        let rest = &self.edited.base(run).model.geometry.positions;
        let mesh_from_world = invert(world_from_mesh);
        let mut values = Vec::with_capacity(run.vertex_count as usize * 3);
        for vertex in run.vertices() {
            let now = self.positions[vertex];
            if let VertexBlend::Vertex(old) = self.edited.blend(vertex)
                && *world_from_mesh == row.world_from_mesh
                && position_bits(rest[old as usize]) == position_bits(now)
                && let Some(as_stored) = stored.as_chunks::<3>().0.get(old as usize - row.vertices.start)
            {
                values.extend_from_slice(as_stored);
                continue;
            }
            let Some(mesh_from_world) = &mesh_from_world else {
                return Err(self.fault.unwritable(format!(
                    "vertices under node {} have moved, but its transform flattens space and cannot be inverted",
                    row.node
                )));
            };
            let in_mesh = mesh_from_world.transform_point3(now).as_vec3();
            if !in_mesh.is_finite() {
                let problem = format!("the position {now} of vertex {vertex} is beyond 32-bit floats");
                return Err(self.fault.unwritable(problem));
            }
            values.extend(in_mesh.to_array());
        }
        Ok(values)
    }

    /// Everything but positions, normals and tangents.
    fn blend_other_attributes(
        &mut self,
        primitive: &MeshPrimitive,
        mixer: &AttributeBlender<'_>,
        attributes: &mut BTreeMap<String, AccessorHandle>,
    ) -> Result<(), Error> {
        let set = |kind: &str, n: usize| primitive.attribute(&format!("{kind}_{n}"));
        let sets: Vec<(usize, usize)> = (0..).map_while(|n| set("JOINTS", n).zip(set("WEIGHTS", n))).collect();
        // A merged model leaves its skeleton behind.
        if self.is_frame && !sets.is_empty() {
            let all = |of: fn(&(usize, usize)) -> usize| -> Result<Vec<AttributeValues>, Error> {
                sets.iter().map(|pair| self.read_lanes(of(pair), 4)).collect()
            };
            let (joints, weights) = mixer.blend_skin(&all(|p| p.0)?, &all(|p| p.1)?);
            for (n, (joints, weights)) in joints.iter().zip(&weights).enumerate() {
                let (joints, weights) = (
                    self.fresh.add_joints(joints),
                    self.fresh.add_floats(weights, 4, "VEC4", NewAccessorKind::Floats),
                );
                attributes.insert(format!("JOINTS_{n}"), AccessorHandle::New(joints));
                attributes.insert(format!("WEIGHTS_{n}"), AccessorHandle::New(weights));
            }
        }
        for (name, accessor) in &primitive.attributes {
            let skin = name.starts_with("JOINTS_") || name.starts_with("WEIGHTS_");
            if attributes.contains_key(name) || (skin && !self.is_frame) {
                continue;
            }
            let stored = &self.doc.accessors.values[accessor.index()];
            if AccessorLayout::of(stored, &self.doc.views.values).is_none() {
                // Of a type that only some extension knows: it cannot be blended, and would not fit the new vertices.
                continue;
            }
            let stored = &stored.shape;
            let channel = read(self.doc, self.buffers, accessor.index())?;
            let at = if name.starts_with("JOINTS_") && channel.lanes == 4 {
                self.fresh.add_joints(&mixer.take_heaviest(&channel))
            } else {
                let values = if is_identifier(name, &channel) {
                    mixer.take_heaviest(&channel)
                } else {
                    mixer.blend_linearly(&channel)
                };
                self.fresh
                    .add_floats(&values, channel.lanes, shape_of(stored), NewAccessorKind::Floats)
            };
            attributes.insert(name.clone(), AccessorHandle::New(at));
        }
        Ok(())
    }

    fn read_lanes(&self, accessor: usize, lanes: usize) -> Result<AttributeValues, Error> {
        let channel = read(self.doc, self.buffers, accessor)?;
        if channel.lanes != lanes {
            let problem = format!("{} numbers per element, {lanes} are needed", channel.lanes);
            return Err(self.doc.fault.malformed(format!("accessors/{accessor}/type"), problem));
        }
        Ok(channel)
    }

    fn blend_target(
        &mut self,
        target: &Attributes,
        mixer: &AttributeBlender<'_>,
    ) -> Result<BTreeMap<String, AccessorHandle>, Error> {
        let mut made = BTreeMap::new();
        for (name, accessor) in target {
            let stored = &self.doc.accessors.values[accessor.index()].shape;
            let channel = read(self.doc, self.buffers, accessor.index())?;
            let kind = if name == ShapeAttribute::Position.name() && channel.lanes == 3 {
                NewAccessorKind::Positions
            } else {
                NewAccessorKind::Floats
            };
            let at = self
                .fresh
                .add_floats(&mixer.blend_linearly(&channel), channel.lanes, shape_of(stored), kind);
            made.insert(name.clone(), AccessorHandle::New(at));
        }
        Ok(made)
    }
}

/// Whether an application's own attribute names things, so that a mean of two values means nothing.
fn is_identifier(name: &str, channel: &AttributeValues) -> bool {
    name.starts_with('_') && (channel.is_whole || name.contains("ID"))
}

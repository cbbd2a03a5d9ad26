//! The accessors of one edited primitive, and which joints hold its vertices.

use super::super::accessors::ShapeAttribute;
use super::super::builder::{AccessorKind, BufferBuilder};
use super::super::container::GltfFault;
use super::super::document::GltfDocument;
use super::super::placement::{Placement, VertexInfluences, VertexTransforms};
use super::super::read::{GltfNotes, PlacedPrimitive};
use super::super::rig::{JointHeldVertices, SkinnedShape, joint_count};
use super::super::schema::{Attributes, MeshPrimitive};
use super::super::targets::TargetTally;
use super::blended::{
    AccessorNumbers, AttributeBlender, AttributeValues, BlendedSkin, EditedTurns, TargetBlender, read, shape_of,
};
use crate::Error;
use crate::codec::EditedOutput;
use crate::edited::{CarriedAttributes, EditedModel, PrimitiveRun, VertexBlend};
use crate::files::WrittenWarning;
use crate::model::position_bits;
use glam::{DAffine3, DVec3, Vec3, Vec4};
use std::collections::BTreeSet;

/// A primitive's accessors by attribute, of itself and of each morph target, and its indices.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct MadePrimitive {
    pub(super) attributes: AccessorNumbers,
    pub(super) targets: Vec<AccessorNumbers>,
    /// `None` where the stored ones stay, with the stored mode.
    pub(super) indices: Option<usize>,
    /// What is drawn, where that is points or lines.
    pub(super) mode: Option<u64>,
}

/// Where the mesh of a made primitive is drawn.
#[derive(Debug, Clone, Copy)]
pub(super) enum MeshSpace {
    /// Where the file draws it.
    OfRow,
    /// By a node with this transform to the world.
    OfNode(DAffine3),
}

/// Makes the primitives of one base.
pub(super) struct PrimitiveMaker<'a, 'f> {
    pub(super) doc: &'a GltfDocument<'f>,
    pub(super) edited: &'a EditedModel<'a>,
    pub(super) positions: &'a [DVec3],
    pub(super) fresh: &'a mut BufferBuilder,
    pub(super) fault: GltfFault,
    /// Whether accessors of the file may be named, because the file is the frame of the result.
    pub(super) is_frame: bool,
    /// Whether joints of the result hold the vertices of another base, which are then written as they stand in the world.
    pub(super) joins_skin: bool,
    /// How the surface turned around the vertices of the edited model, for morph targets.
    pub(super) turns: &'a EditedTurns<'a>,
    pub(super) tally: &'a mut TargetTally,
    /// Extensions that were left out of primitives and meshes, because what they name is gone.
    pub(super) dropped: BTreeSet<&'static str>,
    /// By how much places are rounded, the first time that they are.
    pub(super) rounded: Option<WrittenWarning>,
}

impl<'a> PrimitiveMaker<'a, '_> {
    /// The accessors of a run whose mesh is drawn in `space`; `None` when the primitive stays as it is stored.
    pub(super) fn make_primitive(
        &mut self,
        run: &'a PrimitiveRun,
        row: &PlacedPrimitive,
        space: MeshSpace,
    ) -> Result<Option<MadePrimitive>, Error> {
        let doc = self.doc;
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        self.tally.meet(run.base, row.node, primitive);
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
        let mut mode = Some(primitive.mode()).filter(|mode| *mode < 4);
        let carried = CarriedAttributes::new(self.edited, run, self.positions);
        let mixer = AttributeBlender::new(self.edited, run);
        let skin = if self.joins_skin || self.is_frame && !untouched {
            let mut skin = BlendedSkin::read(doc, primitive, &mixer, &row.placement)?;
            if self.joins_skin {
                skin.iter_mut().for_each(BlendedSkin::normalise);
            }
            skin
        } else {
            None
        };
        let world_from_mesh = match (space, &row.placement, &skin) {
            (MeshSpace::OfNode(one), _, _) => VertexTransforms::Whole(one),
            (MeshSpace::OfRow, Placement::Blended(pose), Some(skin)) => {
                skin.transforms(&pose.world_from_bind, self.fault)?
            }
            (MeshSpace::OfRow, placement, _) => placement.transforms(doc, primitive)?,
        };
        if self.is_frame && mode.is_some() && world_from_mesh.inverse().is_none() {
            // Points and lines that cannot move stay as they are stored.
            return Ok(None);
        }
        let stays_stored = match space {
            MeshSpace::OfRow => true,
            MeshSpace::OfNode(one) => row.placement == Placement::Whole(one),
        };
        let positions = self.mesh_positions(run, row, &world_from_mesh, stays_stored)?;
        let mut attributes = self.write_shape(&positions, primitive, &world_from_mesh, &carried);
        let mut targets = Vec::new();
        if !primitive.targets.is_empty() {
            let placement = &row.placement;
            let old = placement.transforms(doc, primitive)?;
            let mut blender = TargetBlender::new(self.turns, run, &mixer, placement, old, &world_from_mesh);
            blender.is_respaced = self.joins_skin;
            for (number, target) in primitive.targets.iter().enumerate() {
                let (made, is_carried) = self.blend_target(&blender, target, untouched)?;
                if is_carried {
                    self.tally.carry(run.base, row.node, number);
                }
                targets.push(made);
            }
        }
        let indices = if untouched {
            for (name, at) in &primitive.attributes {
                attributes.entry(name.clone()).or_insert(at.index());
            }
            None
        } else {
            if let Some(skin) = &skin {
                skin.write(self.fresh, &mut attributes);
            }
            self.blend_other_attributes(primitive, &mixer, &mut attributes)?;
            let mut triangles = carried.triangles;
            if world_from_mesh.is_mirrored() {
                // Read as it is drawn, written as it is stored: turned round.
                triangles.iter_mut().for_each(|t| t.swap(1, 2));
            }
            Some(match mode {
                Some(_) => {
                    let (at, drawn) = self.followed_elements(run, row, primitive)?;
                    mode = Some(drawn);
                    at
                }
                None => self.fresh.add_indices(&triangles, run.vertex_count as usize),
            })
        };
        Ok(Some(MadePrimitive {
            attributes,
            targets,
            indices,
            mode,
        }))
    }

    /// One target, and whether displacements turned or grew with the surface. Those attributes that stay as they are stored
    /// have their old accessors, when these `may_stay`.
    fn blend_target(
        &mut self,
        blender: &TargetBlender<'_>,
        target: &Attributes,
        may_stay: bool,
    ) -> Result<(AccessorNumbers, bool), Error> {
        let doc = self.doc;
        let mut made = AccessorNumbers::new();
        let mut is_carried = false;
        for (name, accessor) in target {
            let channel = read(doc, accessor.index())?;
            let role = ShapeAttribute::ALL.into_iter().find(|role| role.name() == name);
            let role = role.filter(|_| channel.lanes == 3);
            self.tally.spend(blender.mixer.len())?;
            let values = blender.carried(role, &channel);
            is_carried |= role.is_some() && blender.has_turned(&values);
            let is_stored = || {
                values
                    .iter()
                    .map(|v| v.to_bits())
                    .eq(channel.values.iter().map(|v| v.to_bits()))
            };
            let at = if may_stay && is_stored() {
                accessor.index()
            } else {
                let kind = match role {
                    Some(ShapeAttribute::Position) => AccessorKind::Positions,
                    _ => AccessorKind::Floats,
                };
                let shape = shape_of(&doc.accessors.values[accessor.index()].shape);
                self.fresh.add_floats(&values, shape, kind)
            };
            made.insert(name.clone(), at);
        }
        Ok((made, is_carried))
    }

    /// Writes positions, and normals and tangents where the primitive has them.
    fn write_shape(
        &mut self,
        positions: &[f32],
        primitive: &MeshPrimitive,
        world_from_mesh: &VertexTransforms,
        carried: &CarriedAttributes<'_>,
    ) -> AccessorNumbers {
        let mut attributes = AccessorNumbers::new();
        let mut add = |role: ShapeAttribute, values: &[f32], kind| {
            let at = self.fresh.add_floats(values, role.shape(), kind);
            attributes.insert(role.name().into(), at);
        };
        add(ShapeAttribute::Position, positions, AccessorKind::Positions);
        let (has_normal, has_tangent) = (
            primitive.attribute(ShapeAttribute::Normal.name()).is_some(),
            primitive.attribute(ShapeAttribute::Tangent.name()).is_some(),
        );
        if !has_normal && !has_tangent {
            return attributes;
        }
        let normals = carried.normals();
        if has_normal {
            let to_mesh = |(i, n): (usize, &Vec3)| {
                let mesh_from_normal = world_from_mesh.at(i).matrix3.transpose();
                let along = (mesh_from_normal * n.as_dvec3()).try_normalize().unwrap_or(DVec3::Z);
                along.as_vec3().to_array()
            };
            let values: Vec<f32> = normals.iter().enumerate().flat_map(to_mesh).collect();
            add(ShapeAttribute::Normal, &values, AccessorKind::Floats);
        }
        if has_tangent {
            let mesh_from_world = world_from_mesh.inverse();
            let mesh_from_world = mesh_from_world.unwrap_or(VertexTransforms::Whole(DAffine3::IDENTITY));
            let side = if world_from_mesh.is_mirrored() { -1.0 } else { 1.0 };
            let to_mesh = |(i, t): (usize, &Vec4)| {
                let along = mesh_from_world.at(i).transform_vector3(t.truncate().as_dvec3());
                let along = along.try_normalize().unwrap_or(DVec3::X);
                along.as_vec3().extend(t.w * side).to_array()
            };
            let values: Vec<f32> = carried
                .tangents(&normals)
                .iter()
                .enumerate()
                .flat_map(to_mesh)
                .collect();
            add(ShapeAttribute::Tangent, &values, AccessorKind::Floats);
        }
        attributes
    }

    /// Positions of a run in the space of its mesh; where that space is the stored one, those that did not move are as
    /// they are stored.
    fn mesh_positions(
        &mut self,
        run: &PrimitiveRun,
        row: &PlacedPrimitive,
        world_from_mesh: &VertexTransforms,
        stays_stored: bool,
    ) -> Result<Vec<f32>, Error> {
        let primitive = &self.doc.meshes.values[row.mesh].primitives[row.primitive];
        let stored = self.doc.read_attribute(primitive, ShapeAttribute::Position)?;
        let stored = stored.unwrap_or_default();
        let rest = &self.edited.base(run).model.geometry.positions;
        let mesh_from_world = world_from_mesh.inverse();
        let cannot_move = mesh_from_world.is_none() && primitive.mode() < 4;
        let mut values = Vec::with_capacity(run.vertex_count as usize * 3);
        let mut all_in_mesh = Vec::with_capacity(run.vertex_count as usize);
        for (i, vertex) in run.vertices().enumerate() {
            let now = self.positions[vertex];
            if let VertexBlend::Vertex(old) = self.edited.blend(vertex)
                && (stays_stored && position_bits(rest[old as usize]) == position_bits(now) || cannot_move)
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
            let in_mesh = mesh_from_world.at(i).transform_point3(now);
            all_in_mesh.push(in_mesh);
            let in_mesh = in_mesh.as_vec3();
            if !in_mesh.is_finite() {
                let problem = format!("the position {now} of vertex {vertex} is beyond 32-bit floats");
                return Err(self.fault.unwritable(problem));
            }
            values.extend(in_mesh.to_array());
        }
        if self.rounded.is_none() {
            self.rounded = WrittenWarning::rounded(&all_in_mesh, self.fault.0);
        }
        Ok(values)
    }

    /// Everything but positions, normals, tangents and the skin.
    fn blend_other_attributes(
        &mut self,
        primitive: &MeshPrimitive,
        mixer: &AttributeBlender<'_>,
        attributes: &mut AccessorNumbers,
    ) -> Result<(), Error> {
        let cap_uv = mixer.cap_uv();
        if let Some(uv) = cap_uv {
            let at = self.fresh.add_floats(uv.as_flattened(), "VEC2", AccessorKind::Floats);
            attributes.insert("TEXCOORD_0".into(), at);
        }
        let is_look = |name: &str| name.starts_with("TEXCOORD_") || name.starts_with("COLOR_");
        for (name, accessor) in &primitive.attributes {
            if cap_uv.is_some() && is_look(name) {
                continue;
            }
            let skin = name.starts_with("JOINTS_") || name.starts_with("WEIGHTS_");
            if attributes.contains_key(name) || (skin && !self.is_frame) {
                continue;
            }
            let stored = &self.doc.accessors.values[accessor.index()];
            if self.doc.layout(accessor.index()).is_none() {
                // Of a type that only some extension knows: it cannot be blended, and would not fit the new vertices.
                continue;
            }
            let stored = &stored.shape;
            let channel = read(self.doc, accessor.index())?;
            let at = if name.starts_with("JOINTS_") && channel.lanes == 4 {
                self.fresh.add_joints(&mixer.take_heaviest(&channel))
            } else {
                let mut values = if is_identifier(name, &channel) {
                    mixer.take_heaviest(&channel)
                } else {
                    mixer.blend_linearly(&channel)
                };
                if is_look(name) {
                    // Vertices that were only copied bring what the file had; in what is written here that is not a number.
                    let wrong = values.iter_mut().filter(|v| !v.is_finite());
                    wrong.for_each(|v| *v = 0.0);
                }
                self.fresh.add_floats(&values, shape_of(stored), AccessorKind::Floats)
            };
            attributes.insert(name.clone(), at);
        }
        Ok(())
    }
}

/// Whether an application's own attribute names things, so that a mean of two values means nothing.
fn is_identifier(name: &str, channel: &AttributeValues) -> bool {
    name.starts_with('_') && (channel.is_whole || name.contains("ID"))
}

/// The vertices of an edited model, and which joints of its first base hold them.
pub(super) fn shape_of_runs<'a>(
    doc: &GltfDocument<'_>,
    notes: &GltfNotes,
    output: &EditedOutput<'a>,
) -> Result<SkinnedShape<'a>, Error> {
    let edited = output.edited;
    let runs = edited.runs.iter();
    let mut shape = SkinnedShape {
        before: runs.flat_map(|run| CarriedAttributes::before(edited, run)).collect(),
        now: output.positions,
        held: Vec::new(),
        fixed: Vec::new(),
    };
    for run in edited.runs.iter().filter(|run| run.base == 0) {
        let row = &notes.rows[run.primitive as usize];
        let Some(skin) = row.skin else {
            shape.fixed.push((row.node, run.vertices()));
            continue;
        };
        if !row.follows_joints {
            continue;
        }
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let joints = joint_count(doc, skin);
        let old = &edited.base(run).model.geometry.triangles[row.triangles.clone()];
        let influences = if edited.is_untouched(run, old) {
            let stored = VertexInfluences::read(doc, primitive, joints);
            stored.map_err(|problem| doc.fault.unwritable(problem))?
        } else {
            let mixer = AttributeBlender::new(edited, run);
            match BlendedSkin::read(doc, primitive, &mixer, &row.placement)? {
                Some(skin) => skin.influences(joints, doc.fault)?,
                None => continue,
            }
        };
        shape.held.push(JointHeldVertices {
            skin,
            first: run.first_vertex as usize,
            influences,
            placement: row.placement.clone(),
        });
    }
    Ok(shape)
}

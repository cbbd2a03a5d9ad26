//! Bases that join the first one's document.
//!
//! A glTF base comes with its meshes under one new node, and with the materials, textures, samplers and images that its
//! edited primitives use. Its hierarchy is flattened: every node that draws a mesh becomes a child of the new node.
//! Where it has grown together with another base its vertices are written as they stand in the world, since those of two
//! nodes would round apart and tear the joint.
//! Where joints place them, [`skeletons`](super::skeletons) finds the joints, and the mesh becomes a root of the scene.
//! Animations, cameras, lights and extensions that are not about materials stay behind. A base of another
//! format comes as plain geometry.

use super::super::builder::{AccessorKind, BufferBuilder};
use super::super::container::GltfFault;
use super::super::document::GltfDocument;
use super::super::fresh::translation_to;
use super::super::read::{GltfNotes, PlacedPrimitive};
use super::super::rig::FollowedNodeTree;
use super::super::scene;
use super::super::targets::TargetTally;
use super::super::text::{index_of, json_array, json_object, list_of, quoted, value_of, with_member};
use super::blended::{AccessorNumbers, EditedTurns};
use super::frame::EditedMeshes;
use super::looks::{CopyTarget, JoinedBases, MaterialCopier};
use super::primitives::{MadePrimitive, MeshSpace, PrimitiveMaker};
use super::skeletons::{FrameSkeleton, NodeTransform, SkeletonJoiner, WrittenNode};
use crate::codec::EditedOutput;
use crate::edited::{EditedModel, PrimitiveRun};
use crate::neutral::NeutralModel;
use crate::{Error, FileSet};
use glam::{DAffine3, DVec3};
use pliant_mesh::BoundingBox;
use std::collections::BTreeMap;

/// Joins all bases but the first. `maker` has made the primitives of the first, `files` are that one's.
pub(super) fn join_bases(
    maker: &mut PrimitiveMaker<'_, '_>,
    files: &FileSet,
    frame: &EditedMeshes,
    output: &EditedOutput<'_>,
    tree: Option<&FollowedNodeTree>,
) -> Result<JoinedBases, Error> {
    let mut joined = JoinedBases::of_caps(output.edited);
    let EditedOutput { edited, positions, .. } = *output;
    if edited.bases.len() < 2 {
        return Ok(joined);
    }
    let skeleton = FrameSkeleton::new(maker.doc, tree)?;
    for (i, base) in edited.bases.iter().enumerate().skip(1) {
        let of_base = edited.runs.iter().filter(|run| run.base as usize == i);
        let own: Vec<&PrimitiveRun> = of_base.filter(|run| edited.is_drawn(run)).collect();
        if own.is_empty() {
            continue;
        }
        let mut joiner = BaseJoiner {
            frame: maker.doc,
            skeleton: &skeleton,
            edited,
            positions,
            fresh: &mut *maker.fresh,
            turns: maker.turns,
            tally: &mut *maker.tally,
            joined: &mut joined,
            fault: GltfFault(output.format),
        };
        match base.model.notes::<GltfNotes>() {
            Some(notes) => joiner.join_gltf(i, notes, &own, files)?,
            None => joiner.join_neutral(i, &(output.neutral_base)(i as u32)?)?,
        }
    }
    let known = maker.doc.meshes.len() + frame.meshes.len() + joined.meshes.len();
    debug_assert!(joined.nodes.iter().all(|(_, mesh)| mesh.is_none_or(|m| m < known)));
    Ok(joined)
}

struct BaseJoiner<'j, 'a> {
    frame: &'j GltfDocument<'j>,
    skeleton: &'j FrameSkeleton,
    edited: &'a EditedModel<'a>,
    positions: &'a [DVec3],
    fresh: &'j mut BufferBuilder,
    turns: &'j EditedTurns<'j>,
    tally: &'j mut TargetTally,
    joined: &'j mut JoinedBases,
    fault: GltfFault,
}

impl<'a> BaseJoiner<'_, 'a> {
    fn join_gltf(
        &mut self,
        base: usize,
        notes: &GltfNotes,
        runs: &[&'a PrimitiveRun],
        first: &FileSet,
    ) -> Result<(), Error> {
        let model = self.edited.bases[base].model;
        let placing = self.edited.bases[base].world_from_model;
        let doc = notes.document_to_write(model, self.frame.bytes.decoding.progress)?;
        let mut runs_of: BTreeMap<(usize, usize), Vec<&PrimitiveRun>> = BTreeMap::new();
        for run in runs {
            let row = &notes.rows[run.primitive as usize];
            runs_of.entry((row.node, row.primitive)).or_default().push(run);
        }
        let grown = self.has_grown(base) && !notes.rows.iter().any(|row| has_targets(&doc, row.node, row.primitive));
        let node_for = |transform: &DAffine3| Some(transform).filter(|_| !grown).and_then(NodeTransform::from_affine);
        let scene = scene::place_meshes(&doc, &mut Vec::new())?;
        let mut skeleton = SkeletonJoiner::new(self.skeleton, &doc, &scene, placing);
        let name = name_of(&model.files, base);
        let skin_of = skins_of_nodes(notes, runs);
        // Nodes with skins are roots; those without stand among them where there are some, so that vertices keep their order.
        let all_roots = skin_of.values().any(Option::is_some);
        let placed = node_for(&placing).filter(|_| !all_roots);
        let needs_root = skin_of.values().any(|skin| match *skin {
            Some(skin) => !skeleton.has_all(skin),
            None => !all_roots,
        });
        let root = needs_root.then(|| self.add_root(&name, placed.as_ref()));
        let world_from_root = placed.as_ref().map_or(DAffine3::IDENTITY, |p| p.transform);
        let mut palette = MaterialCopier::new(&doc, &model.files, first, base);
        let mut children = Vec::new();
        for placement in &scene.placements {
            let mesh = doc.item(&doc.meshes, placement.mesh);
            // What a node cannot hold is left to the vertices.
            let root_from_mesh = match placed {
                Some(_) => placement.world_from_mesh,
                None => placing * placement.world_from_mesh,
            };
            let skin = skin_of.get(&placement.node).copied().flatten();
            let here = node_for(&root_from_mesh).filter(|_| skin.is_none());
            let root_from_mesh = here.as_ref().map_or(DAffine3::IDENTITY, |p| p.transform);
            let space = MeshSpace::OfNode(match skin {
                Some(_) => DAffine3::IDENTITY,
                None => world_from_root * root_from_mesh,
            });
            let mut primitives = Vec::new();
            let stored = list_of(mesh, "primitives");
            for (p, stored) in stored.into_iter().enumerate() {
                let runs = runs_of.get(&(placement.node, p)).map_or(&[][..], Vec::as_slice);
                for &run in runs {
                    let place = JoinedPlace {
                        doc: &doc,
                        row: &notes.rows[run.primitive as usize],
                        stored,
                        space,
                        joins_skin: skin.is_some(),
                        // Sheared meshes are written as they stand in the world, for which stored targets are not made.
                        with_targets: here.is_some() || skin.is_some(),
                    };
                    primitives.extend(self.join_primitive(run, &place, &mut palette)?);
                }
            }
            if primitives.is_empty() {
                continue;
            }
            let is_whole = here.is_some() || skin.is_some() || grown;
            self.joined.meshes.push(mesh_text(mesh, &primitives, is_whole));
            let mut node = "{}".to_owned();
            if let Some(name) = value_of(doc.item(&doc.nodes, placement.node), "name") {
                node = with_member(&node, "name", name);
            }
            if let Some(here) = &here {
                node = here.write_into_node(node);
            }
            let mesh = self.joined.meshes.len() - 1;
            let Some(skin) = skin else {
                let node = self.add_node(node, Some(mesh));
                match all_roots {
                    true => self.joined.roots.push(node),
                    false => children.push(node),
                }
                continue;
            };
            let top = WrittenNode {
                number: root.unwrap_or_default(),
                world: world_from_root,
            };
            let skin = skeleton.join(skin, top, self.frame, self.fresh, self.joined);
            let node = self.add_node(with_member(&node, "skin", skin), Some(mesh));
            self.joined.roots.push(node);
        }
        self.joined.warnings.extend(skeleton.warning(&name));
        if let Some(root) = root {
            self.set_children(root, &children);
        }
        Ok(())
    }

    /// The text of a primitive, with its material; `None` where nothing of it is drawn.
    fn join_primitive(
        &mut self,
        run: &'a PrimitiveRun,
        place: &JoinedPlace<'_, '_>,
        palette: &mut MaterialCopier<'_>,
    ) -> Result<Option<String>, Error> {
        let mut maker = PrimitiveMaker {
            doc: place.doc,
            edited: self.edited,
            positions: self.positions,
            fresh: self.fresh,
            fault: self.fault,
            is_frame: false,
            joins_skin: place.joins_skin,
            turns: self.turns,
            tally: &mut *self.tally,
            dropped: Default::default(),
            rounded: None,
        };
        let made = maker.make_primitive(run, place.row, place.space)?;
        let own = list_of(self.frame.text, "materials").len();
        let material = match (self.edited.cap_number(run), index_of(place.stored, "material")) {
            (Some(cap), _) => Some(own + cap),
            (None, Some(m)) => {
                let mut to = CopyTarget {
                    frame: self.frame,
                    fresh: self.fresh,
                    joined: self.joined,
                };
                palette.copy_material(m, &mut to)?
            }
            (None, None) => None,
        };
        Ok(made.map(|made| primitive_text(&made, material, place.with_targets)))
    }

    /// Whether a vertex of the base stands where one of another base does.
    fn has_grown(&self, base: usize) -> bool {
        let place = |v: usize| Some((*self.positions.get(v)? + DVec3::ZERO).to_array().map(f64::to_bits));
        let of = |own: bool| {
            let runs = self.edited.runs.iter();
            let runs = runs.filter(move |run| (run.base as usize == base) == own);
            runs.flat_map(|run| run.first_vertex as usize..(run.first_vertex + run.vertex_count) as usize)
        };
        let mut own: Vec<[u64; 3]> = of(true).filter_map(place).collect();
        own.sort_unstable();
        of(false)
            .filter_map(place)
            .any(|place| own.binary_search(&place).is_ok())
    }

    /// A base of another format, one mesh for each of its parts.
    fn join_neutral(&mut self, base: usize, neutral: &NeutralModel) -> Result<(), Error> {
        let NeutralModel {
            geometry, uv, colours, ..
        } = neutral;
        let root = self.add_root(&name_of(&self.edited.bases[base].model.files, base), None);
        let origin = BoundingBox::of(&geometry.positions).origin();
        let mut children = Vec::new();
        for own in neutral.primitives() {
            let (primitive, part, range) = (own.primitive, own.attributes, own.vertices);
            let mut made = MadePrimitive {
                attributes: AccessorNumbers::new(),
                targets: Vec::new(),
                indices: None,
                mode: None,
            };
            let mut add = |name: &str, at: usize| {
                made.attributes.insert(name.into(), at);
            };
            let positions = geometry.positions[range.clone()].iter();
            let positions: Vec<f32> = positions.flat_map(|p| (*p - origin).as_vec3().to_array()).collect();
            if positions.iter().any(|v| !v.is_finite()) {
                return Err(self.fault.unwritable("a position is beyond 32-bit floats"));
            }
            let bounded = AccessorKind::Positions;
            add("POSITION", self.fresh.add_floats(&positions, "VEC3", bounded));
            let mut add_plain = |name: &str, values: &[f32], shape| {
                add(name, self.fresh.add_floats(values, shape, AccessorKind::Floats));
            };
            if primitive.has_normals {
                let normals = geometry.normals[range.clone()].iter();
                let normals: Vec<f32> = normals.flat_map(|n| n.to_array()).collect();
                add_plain("NORMAL", &normals, "VEC3");
            }
            if part.has_uv {
                add_plain("TEXCOORD_0", uv[range.clone()].as_flattened(), "VEC2");
            }
            if part.has_colours {
                add_plain("COLOR_0", colours[range].as_flattened(), "VEC4");
            }
            let local: Vec<[u32; 3]> = own
                .triangles
                .iter()
                .map(|t| t.map(|v| v - primitive.first_vertex))
                .collect();
            made.indices = Some(self.fresh.add_indices(&local, primitive.vertex_count as usize));
            let primitives = [primitive_text(&made, None, false)];
            self.joined
                .meshes
                .push(json_object([("primitives", json_array(&primitives))]));
            let name = (!primitive.name.is_empty()).then(|| ("name", quoted(&primitive.name)));
            let node = json_object(name.into_iter().chain(translation_to(origin)));
            children.push(self.add_node(node, Some(self.joined.meshes.len() - 1)));
        }
        self.set_children(root, &children);
        Ok(())
    }

    fn add_root(&mut self, name: &str, placing: Option<&NodeTransform>) -> usize {
        let text = json_object([("name", quoted(name))]);
        let text = placing.map_or(text.clone(), |p| p.write_into_node(text));
        let root = self.add_node(text, None);
        self.joined.roots.push(root);
        root
    }

    fn add_node(&mut self, text: String, mesh: Option<usize>) -> usize {
        self.joined.nodes.push((text, mesh));
        self.frame.nodes.len() + self.joined.nodes.len() - 1
    }

    fn set_children(&mut self, root: usize, children: &[usize]) {
        let at = root - self.frame.nodes.len();
        if let Some((text, _)) = self.joined.nodes.get_mut(at).filter(|_| !children.is_empty()) {
            *text = with_member(text, "children", json_array(children));
        }
    }
}

/// Where a primitive comes from, and where it goes.
struct JoinedPlace<'p, 'f> {
    doc: &'p GltfDocument<'f>,
    row: &'p PlacedPrimitive,
    /// Its text.
    stored: &'p str,
    space: MeshSpace,
    joins_skin: bool,
    with_targets: bool,
}

/// The skin of each node that has runs; none where joints do not place all of them.
fn skins_of_nodes(notes: &GltfNotes, runs: &[&PrimitiveRun]) -> BTreeMap<usize, Option<usize>> {
    let mut skin_of: BTreeMap<usize, Option<usize>> = BTreeMap::new();
    for run in runs {
        let row = &notes.rows[run.primitive as usize];
        let skin = row.skin.filter(|_| row.follows_joints);
        let known = skin_of.entry(row.node).or_insert(skin);
        *known = known.filter(|_| skin.is_some());
    }
    skin_of
}

/// A joined mesh with what else the stored one says; its name alone where it is not `whole`.
fn mesh_text(stored: &str, primitives: &[String], whole: bool) -> String {
    let mut text = json_object([("primitives", json_array(primitives))]);
    let keys = if whole {
        &["name", "weights", "extras"][..]
    } else {
        &["name"]
    };
    for key in keys {
        if let Some(value) = value_of(stored, key) {
            text = with_member(&text, key, value);
        }
    }
    text
}

/// A primitive of a joined mesh.
fn primitive_text(made: &MadePrimitive, material: Option<usize>, with_targets: bool) -> String {
    let mut members = vec![("attributes", json_object(&made.attributes))];
    members.extend(made.indices.map(|at| ("indices", at.to_string())));
    members.extend(made.mode.map(|mode| ("mode", mode.to_string())));
    if with_targets && !made.targets.is_empty() {
        members.push(("targets", json_array(made.targets.iter().map(json_object))));
    }
    members.extend(material.map(|material| ("material", material.to_string())));
    json_object(members)
}

/// Whether a node's primitive has morph targets.
fn has_targets(doc: &GltfDocument<'_>, node: usize, primitive: usize) -> bool {
    let mesh = doc.nodes.values.get(node).and_then(|n| n.mesh.as_ref());
    let stored = mesh.map(|m| list_of(doc.item(&doc.meshes, m.index()), "primitives"));
    let stored = stored.unwrap_or_default();
    stored.get(primitive).is_some_and(|p| value_of(p, "targets").is_some())
}

fn name_of(files: &FileSet, base: usize) -> String {
    if files.name.is_empty() {
        format!("merged {base}")
    } else {
        files.name.clone()
    }
}

//! Meshes: one primitive for the faces of each material, and skin deformers as glTF skins.

use super::super::gltf::{self, GlbWriter};
use super::corners::{self, CornerAttribute, FbxCornerAttributes, PartVertices};
use super::scene::{MaterialTable, TranslationNotes, place_of, refuse};
use crate::files::{ReadWatch, WrittenWarning};
use crate::{Error, Format};
use glam::{DVec3, Vec3};
use serde_json::{Value, json};
use ufbx::{Matrix, Mesh, Node, SkinCluster, SkinDeformer, SkinningMethod};

/// Bytes of the tables in which corners of polygons become vertices.
const BYTES_PER_CORNER: u64 = 64;
/// Bytes of a position while they do.
const BYTES_PER_POINT: u64 = 24;

/// What meshes are put into, and what has been put there.
pub(super) struct MeshSink<'a, 'f, 'w> {
    pub buffer: &'a mut GlbWriter<'w>,
    pub materials: &'a mut MaterialTable<'f>,
    pub notes: &'a mut TranslationNotes,
    pub watch: &'a ReadWatch<'a>,
    /// Vertices so far.
    pub vertices: u64,
    /// Triangles so far.
    pub triangles: u64,
}

impl MeshSink<'_, '_, '_> {
    /// The JSON of a mesh with the materials of a node; `None` where it has no triangles.
    pub(super) fn add_mesh(
        &mut self,
        mesh: &Mesh,
        node: &Node,
        skin: Option<&MeshSkin<'_>>,
    ) -> Result<Option<Value>, Error> {
        let (channels, has_between) = corners::channels_of(mesh);
        if has_between {
            self.notes.leave_out("in-between shapes");
        }
        let attributes = FbxCornerAttributes::of_mesh(mesh);
        let mut primitives = Vec::new();
        let name = place_of("mesh", &mesh.element);
        for part in &mesh.material_parts {
            let triangles = corners::triangle_count(mesh, part);
            self.triangles += triangles;
            self.watch.check_triangles(self.triangles)?;
            // Until it is known which corners are one vertex, each may be one.
            let working = triangles * 3 * BYTES_PER_CORNER + mesh.vertices.len() as u64 * BYTES_PER_POINT;
            self.watch.reserve(working)?;
            let divided = corners::divide(mesh, part, &attributes, || self.watch.check())?;
            self.watch.release(working);
            if divided.triangles.is_empty() {
                continue;
            }
            self.vertices += divided.corner.len() as u64;
            self.watch.check_vertices(self.vertices)?;
            if divided.crude > 0 {
                let message = format!("{} polygons are too large to cut into triangles well", divided.crude);
                self.notes.warn("polygon-too-large", message, name.clone());
            }
            let mut primitive = self.primitive(mesh, &divided, &attributes, &name)?;
            if let Some(skin) = skin {
                skin.add_attributes(self.buffer, &divided.control_point, &mut primitive["attributes"], &name)?;
            }
            if !channels.is_empty() {
                let targets = corners::add_targets(self.buffer, mesh, &divided, &channels, &name)?;
                primitive["targets"] = Value::Array(targets);
            }
            if let Some(material) = node.materials.get(part.index as usize) {
                primitive["material"] = json!(self.materials.number_of(material, self.notes));
            }
            primitives.push(primitive);
        }
        if primitives.is_empty() {
            return Ok(None);
        }
        let mut json = json!({"primitives": primitives});
        if !mesh.element.name.is_empty() {
            json["name"] = json!(&*mesh.element.name);
        }
        if !channels.is_empty() {
            let weights: Vec<f64> = channels
                .iter()
                .map(|c| if c.weight.is_finite() { c.weight } else { 0.0 })
                .collect();
            json["weights"] = json!(weights);
            let names: Vec<&str> = channels.iter().map(|c| &*c.element.name).collect();
            json["extras"] = json!({"targetNames": names});
        }
        Ok(Some(json))
    }

    fn primitive(
        &mut self,
        mesh: &Mesh,
        part: &PartVertices,
        attributes: &FbxCornerAttributes<'_>,
        place: &str,
    ) -> Result<Value, Error> {
        let positions: Vec<DVec3> = part
            .control_point
            .iter()
            .map(|&at| {
                let p = mesh.vertices[at as usize];
                DVec3::new(p.x, p.y, p.z)
            })
            .collect();
        if let Some(rounded) = WrittenWarning::rounded(&positions, Format::GLB) {
            self.notes.warn(rounded.code, rounded.message, place);
        }
        let single: Vec<[f32; 3]> = positions.iter().map(|p| p.as_vec3().to_array()).collect();
        let place_of = |what: &str| format!("{place}, {what}");
        let mut json = json!({"POSITION": self.buffer.add_bounded(&single, &place_of("positions"))?});
        if let Some(normal) = &attributes.normal {
            let given: Vec<Vec3> = values_of(part, normal).into_iter().map(Vec3::from_array).collect();
            let normals = gltf::unit_normals(&given, &positions, &part.triangles);
            json["NORMAL"] = json!(self.buffer.add_floats(&normals, &place_of("normals"))?);
        }
        for (i, set) in attributes.uv.iter().enumerate() {
            let values = values_of(part, set);
            let number = self.buffer.add_floats(&values, &place_of("texture coordinates"))?;
            json[format!("TEXCOORD_{i}")] = json!(number);
        }
        for (i, set) in attributes.colours.iter().enumerate() {
            let values = values_of(part, set);
            json[format!("COLOR_{i}")] = json!(self.buffer.add_floats(&values, &place_of("colours"))?);
        }
        let triangles = self.buffer.add_triangles(&part.triangles)?;
        Ok(json!({"attributes": json, "indices": triangles}))
    }
}

fn values_of<const N: usize>(part: &PartVertices, attribute: &CornerAttribute<'_, N>) -> Vec<[f32; N]> {
    part.corner.iter().map(|&corner| attribute(corner)).collect()
}

/// How many joints may pull one vertex; the strongest stay.
const MOST_INFLUENCES: usize = 8;

/// The matrix that changes nothing.
const IDENTITY: [f32; 16] = [
    1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
];

/// The skin of a mesh.
pub(super) struct MeshSkin<'a> {
    deformer: &'a SkinDeformer,
    /// The clusters that have a bone, in order: the joints.
    clusters: Vec<&'a SkinCluster>,
    /// For each cluster of the deformer its joint.
    joint_of: Vec<Option<u16>>,
    /// Whether vertices without weights are there. They stay with the mesh's node, the last joint.
    has_free_vertices: bool,
    /// How many joints pull the vertex that most pull, up to those that are kept.
    most: usize,
}

impl<'a> MeshSkin<'a> {
    /// The first skin of a mesh that has bones.
    pub(super) fn of_mesh(mesh: &'a Mesh, notes: &mut TranslationNotes) -> Result<Option<Self>, Error> {
        let has_bones = |skin: &&SkinDeformer| skin.clusters.iter().any(|c| c.bone_node.is_some());
        let mut skins = (&mesh.skin_deformers).into_iter().filter(has_bones);
        let Some(deformer) = skins.next() else {
            return Ok(None);
        };
        if skins.next().is_some() {
            notes.leave_out("second skins of a mesh");
        }
        if matches!(
            deformer.skinning_method,
            SkinningMethod::DualQuaternion | SkinningMethod::BlendedDqLinear
        ) {
            notes.leave_out("dual quaternion skinning (taken as linear)");
        }
        let mut clusters = Vec::new();
        let mut joint_of = Vec::with_capacity(deformer.clusters.len());
        for cluster in &deformer.clusters {
            joint_of.push(cluster.bone_node.is_some().then_some(clusters.len() as u16));
            if cluster.bone_node.is_some() {
                clusters.push(cluster);
            }
        }
        if clusters.len() >= usize::from(u16::MAX) {
            let problem = format!("{} bones, at most {} are read", clusters.len(), u16::MAX - 1);
            return Err(refuse(place_of("skin", &deformer.element), problem));
        }
        let mut skin = Self {
            deformer,
            clusters,
            joint_of,
            has_free_vertices: false,
            most: 1,
        };
        for position in 0..mesh.vertices.len() as u32 {
            let count = skin.pulls_on(position).count();
            skin.has_free_vertices |= count == 0;
            skin.most = skin.most.max(count.min(MOST_INFLUENCES));
            if count > MOST_INFLUENCES {
                notes.leave_out("skin weights beyond the eight largest of a vertex");
            }
        }
        Ok(Some(skin))
    }

    /// Whether its joints hold the node of the mesh, so that two nodes cannot share it.
    pub(super) fn names_own_node(&self) -> bool {
        self.has_free_vertices
    }

    /// The joints that pull a position of the mesh, with their weights.
    fn pulls_on(&self, position: u32) -> impl Iterator<Item = (u16, f64)> {
        let vertex = self.deformer.vertices.get(position as usize);
        let range = vertex.map_or(0..0, |v| {
            v.weight_begin as usize..v.weight_begin as usize + v.num_weights as usize
        });
        let weights = self.deformer.weights.get(range).unwrap_or_default();
        weights.iter().filter_map(|w| {
            let joint = (*self.joint_of.get(w.cluster_index as usize)?)?;
            (w.weight > 0.0 && w.weight.is_finite()).then_some((joint, w.weight))
        })
    }

    /// The joints and weights of a position; the weights sum to one.
    fn influences(&self, position: u32) -> [(u16, f32); MOST_INFLUENCES] {
        let mut pulls: Vec<(u16, f64)> = self.pulls_on(position).collect();
        pulls.sort_by(|a, b| b.1.total_cmp(&a.1));
        pulls.truncate(MOST_INFLUENCES);
        let mut all = [(0, 0.0); MOST_INFLUENCES];
        let sum: f64 = pulls.iter().map(|(_, weight)| weight).sum();
        if pulls.is_empty() || !sum.is_finite() {
            all[0] = (self.clusters.len() as u16, 1.0);
        } else {
            for (one, (joint, weight)) in all.iter_mut().zip(pulls) {
                *one = (joint, (weight / sum) as f32);
            }
        }
        all
    }

    /// Adds joints and weights of a primitive's vertices to its attributes.
    pub(super) fn add_attributes(
        &self,
        buffer: &mut GlbWriter,
        control_points: &[u32],
        attributes: &mut Value,
        place: &str,
    ) -> Result<(), Error> {
        for set in 0..self.most.div_ceil(4) {
            let own = |position: &u32| {
                let all = self.influences(*position);
                [0, 1, 2, 3].map(|k| all[4 * set + k])
            };
            let joints: Vec<[u16; 4]> = control_points.iter().map(|p| own(p).map(|(joint, _)| joint)).collect();
            let weights: Vec<[f32; 4]> = control_points
                .iter()
                .map(|p| own(p).map(|(_, weight)| weight))
                .collect();
            attributes[format!("JOINTS_{set}")] = json!(buffer.add_joints(&joints)?);
            attributes[format!("WEIGHTS_{set}")] = json!(buffer.add_floats(&weights, place)?);
        }
        Ok(())
    }

    /// The bones of the joints by their numbers among the file's nodes, `own` for the mesh's own node, and the skin's JSON
    /// without its joints.
    pub(super) fn add_skin(&self, buffer: &mut GlbWriter, own: u32) -> Result<(Vec<u32>, Value), Error> {
        let place = place_of("skin", &self.deformer.element);
        let bones = self.clusters.iter().filter_map(|cluster| cluster.bone_node.as_ref());
        let mut joints: Vec<u32> = bones.map(|bone| bone.element.typed_id).collect();
        let mut matrices: Vec<[f32; 16]> = self.clusters.iter().map(|c| columns_of(&c.geometry_to_bone)).collect();
        if self.has_free_vertices {
            joints.push(own);
            matrices.push(IDENTITY);
        }
        let matrices = buffer.add_floats(&matrices, &place)?;
        let mut skin = json!({"inverseBindMatrices": matrices});
        if !self.deformer.element.name.is_empty() {
            skin["name"] = json!(&*self.deformer.element.name);
        }
        Ok((joints, skin))
    }
}

fn columns_of(m: &Matrix) -> [f32; 16] {
    [
        m.m00, m.m10, m.m20, 0.0, m.m01, m.m11, m.m21, 0.0, m.m02, m.m12, m.m22, 0.0, m.m03, m.m13, m.m23, 1.0,
    ]
    .map(|x| x as f32)
}

//! Meshes: one primitive for the faces of each material.

use super::super::gltf::GlbWriter;
use super::corners::{self, CornerAttribute, FbxCornerAttributes, PartVertices};
use super::fault::place_of;
use super::materials::MaterialTable;
use super::morphs;
use super::notes::TranslationNotes;
use super::skins::MeshSkin;
use crate::asset::Error;
use crate::asset::files::ReadWatch;
use crate::mesh::shading;
use glam::{DVec3, Vec3};
use serde_json::{Value, json};
use ufbx::{Mesh, Node};

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
        let (channels, has_between) = morphs::channels_of(mesh);
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
                let targets = morphs::add_targets(self.buffer, mesh, &divided, &channels, &name)?;
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
        let single: Vec<[f32; 3]> = positions.iter().map(|p| p.as_vec3().to_array()).collect();
        let place_of = |what: &str| format!("{place}, {what}");
        let mut json = json!({"POSITION": self.buffer.add_bounded(&single, &place_of("positions"))?});
        if let Some(normal) = &attributes.normal {
            let given = values_of(part, normal);
            let normals = unit_normals(&given, &positions, &part.triangles);
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

/// Normals of unit length, as glTF demands; where one has no direction, the surface's.
fn unit_normals(given: &[[f32; 3]], positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut unit: Vec<Option<Vec3>> = given.iter().map(|&n| Vec3::from_array(n).try_normalize()).collect();
    if unit.contains(&None) {
        let smooth = shading::smooth_normals(positions, triangles);
        unit.iter_mut()
            .zip(smooth)
            .for_each(|(n, smooth)| *n = n.or(Some(smooth)));
    }
    unit.into_iter().map(|n| n.unwrap_or(Vec3::Z).to_array()).collect()
}

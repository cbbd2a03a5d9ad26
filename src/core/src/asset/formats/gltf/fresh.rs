//! A new, minimal asset for geometry that came from another format.

use super::builder::{BufferBuilder, INDICES, NewAccessor, VERTICES, index_bytes, json_floats};
use super::container::{self, GltfFault};
use super::document::GLB_FORMAT;
use super::text::quoted;
use super::uri::{self, media_type_of};
use crate::asset::material::{AlphaCoverage, BaseLook, MaterialPicture, NamedMaterial};
use crate::asset::neutral::{NeutralModel, NeutralPrimitive};
use crate::asset::{Error, Format, Geometry, Primitive, WrittenFiles};
use crate::mesh::shading;
use glam::Vec3;
use std::collections::BTreeMap;
use std::sync::Arc;

/// One buffer, one node and mesh for each primitive, with positions, indices, and normals, texture coordinates and
/// colours where there are any; and materials with their pictures.
pub(super) fn build(neutral: &NeutralModel, format: Format) -> Result<WrittenFiles, Error> {
    let fault = GltfFault(format);
    let mut asset = BuiltAsset {
        fault,
        data: BufferBuilder::default(),
        meshes: Vec::new(),
        materials: Vec::new(),
        pictures: Vec::new(),
    };
    let mut nodes = Vec::new();
    for own in neutral.primitives() {
        if own.triangles.is_empty() {
            continue;
        }
        asset.add_primitive(neutral, &own)?;
        let name = name_of(own.primitive);
        nodes.push(format!(r#"{{"mesh":{}{name}}}"#, nodes.len()));
    }
    if nodes.is_empty() {
        return Err(fault.unwritable("there are no triangles"));
    }
    let scene: Vec<String> = (0..nodes.len()).map(|i| i.to_string()).collect();
    let (materials, companions) = asset.material_sections();
    let BuiltAsset { data, meshes, .. } = asset;
    let bytes = data.bytes();
    let embedded = if format == GLB_FORMAT {
        String::new()
    } else {
        format!(r#","uri":{}"#, quoted(&uri::embed(bytes)))
    };
    let json = format!(
        concat!(
            r#"{{"asset":{{"version":"2.0","generator":"pliant"}},"scene":0,"scenes":[{{"nodes":[{}]}}],"#,
            r#""nodes":[{}],"meshes":[{}],"accessors":[{}],"bufferViews":[{}],"buffers":[{{"byteLength":{}{}}}]{}}}"#
        ),
        scene.join(","),
        nodes.join(","),
        meshes.join(","),
        data.accessor_texts(0).join(","),
        data.view_texts(0, 0).join(","),
        bytes.len(),
        embedded,
        materials,
    );
    let main = if format == GLB_FORMAT {
        container::join(&json, Some(bytes), &[], fault)?
    } else {
        json.into_bytes()
    };
    Ok(WrittenFiles::of(main, companions))
}

fn name_of(primitive: &Primitive) -> String {
    if primitive.name.is_empty() {
        String::new()
    } else {
        format!(r#","name":{}"#, quoted(&primitive.name))
    }
}

struct BuiltAsset {
    fault: GltfFault,
    data: BufferBuilder,
    meshes: Vec<String>,
    materials: Vec<Arc<NamedMaterial>>,
    /// Pictures of the materials.
    pictures: Vec<MaterialPicture>,
}

impl BuiltAsset {
    fn add_primitive(&mut self, neutral: &NeutralModel, own: &NeutralPrimitive<'_>) -> Result<(), Error> {
        let NeutralPrimitive {
            primitive,
            attributes: part,
            triangles,
            ..
        } = *own;
        let geometry = &neutral.geometry;
        let (first, count) = (primitive.first_vertex as usize, primitive.vertex_count as usize);
        let outside = || self.fault.unwritable("a primitive names vertices that do not exist");
        let last = first.checked_add(count).ok_or_else(outside)?;
        let in_world = geometry.positions.get(first..last).ok_or_else(outside)?;
        let indices: Option<Vec<u32>> = triangles
            .iter()
            .flatten()
            .map(|&v| {
                v.checked_sub(primitive.first_vertex)
                    .filter(|&v| v < primitive.vertex_count)
            })
            .collect();
        let indices = indices.ok_or_else(outside)?;

        let positions: Vec<Vec3> = in_world.iter().map(|p| p.as_vec3()).collect();
        if let Some(i) = positions.iter().position(|p| !p.is_finite()) {
            let problem = format!(
                "the position {} of vertex {} is beyond 32-bit floats",
                in_world[i],
                first + i
            );
            return Err(self.fault.unwritable(problem));
        }
        let floats: Vec<f32> = positions.iter().flat_map(|p| p.to_array()).collect();
        let least = positions.iter().fold(Vec3::INFINITY, |a, &p| a.min(p)).to_array();
        let most = positions.iter().fold(Vec3::NEG_INFINITY, |a, &p| a.max(p)).to_array();
        let bounds = (json_floats(&least), json_floats(&most));
        let position = self.add_floats(&floats, 3, Some(bounds));
        let mut attributes = format!(r#""POSITION":{position}"#);
        if primitive.has_normals
            && let Some(normals) = geometry.normals.get(first..last)
        {
            let normal = self.add_floats(&unit_normals(normals, geometry, first, &indices), 3, None);
            attributes += &format!(r#","NORMAL":{normal}"#);
        }
        if let Some(uv) = neutral.uv.get(first..last).filter(|_| part.has_uv) {
            let uv = self.add_floats(uv.as_flattened(), 2, None);
            attributes += &format!(r#","TEXCOORD_0":{uv}"#);
        }
        if let Some(colours) = neutral.colours.get(first..last).filter(|_| part.has_colours) {
            let colour = self.add_floats(colours.as_flattened(), 4, None);
            attributes += &format!(r#","COLOR_0":{colour}"#);
        }
        let material = part
            .material
            .as_ref()
            .map(|material| format!(r#","material":{}"#, self.material_number(material)));
        let material = material.unwrap_or_default();
        let indices = self.add_indices(&indices, count);
        let name = name_of(primitive);
        self.meshes.push(format!(
            r#"{{"primitives":[{{"attributes":{{{attributes}}},"indices":{indices},"mode":4{material}}}]{name}}}"#
        ));
        Ok(())
    }

    fn add_floats(&mut self, values: &[f32], lanes: usize, bounds: Option<(String, String)>) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.data.add_view(&bytes, Some(VERTICES));
        self.data.push_accessor(NewAccessor {
            view: Some(view),
            component: 5126,
            count: values.len() / lanes.max(1),
            shape: ["SCALAR", "VEC2", "VEC3", "VEC4"][lanes.clamp(1, 4) - 1],
            bounds,
            sparse: None,
        })
    }

    fn add_indices(&mut self, indices: &[u32], vertices: usize) -> usize {
        let (bytes, component) = index_bytes(indices, vertices);
        let view = self.data.add_view(&bytes, Some(INDICES));
        self.data.push_accessor(NewAccessor {
            view: Some(view),
            component,
            count: indices.len(),
            shape: "SCALAR",
            bounds: None,
            sparse: None,
        })
    }

    fn material_number(&mut self, material: &Arc<NamedMaterial>) -> usize {
        let known = self.materials.iter().position(|known| known == material);
        known.unwrap_or_else(|| {
            self.materials.push(Arc::clone(material));
            self.materials.len() - 1
        })
    }

    /// The sections of materials, textures and images, each with a comma before it; and the pictures of kinds that a
    /// buffer cannot hold, as files.
    fn material_sections(&mut self) -> (String, BTreeMap<String, Vec<u8>>) {
        let materials = std::mem::take(&mut self.materials);
        let texts: Vec<String> = materials.iter().map(|m| self.material_text(m)).collect();
        let (mut images, mut companions) = (Vec::new(), BTreeMap::new());
        for picture in std::mem::take(&mut self.pictures) {
            let bytes = picture.bytes.as_deref();
            let media_type = bytes.and_then(|bytes| media_type_of(&picture.name, bytes));
            if let (Some(bytes), Some(media_type)) = (bytes, media_type) {
                let (view, name) = (self.data.add_view(bytes, None), quoted(&picture.name));
                images.push(format!(
                    r#"{{"bufferView":{view},"mimeType":"{media_type}","name":{name}}}"#
                ));
                continue;
            }
            let uri = uri::of_file_name(&picture.name);
            images.push(format!(r#"{{"uri":{}}}"#, quoted(&uri)));
            if let Some(bytes) = bytes {
                companions.insert(picture.name.clone(), bytes.to_vec());
            }
        }
        let textures: Vec<String> = (0..images.len()).map(|i| format!(r#"{{"source":{i}}}"#)).collect();
        let mut sections = String::new();
        for (key, list) in [("materials", texts), ("textures", textures), ("images", images)] {
            if !list.is_empty() {
                sections += &format!(r#","{key}":[{}]"#, list.join(","));
            }
        }
        (sections, companions)
    }

    fn material_text(&mut self, material: &NamedMaterial) -> String {
        let name = quoted(&material.name);
        let Some(look) = &material.look else {
            return format!(r#"{{"name":{name}}}"#);
        };
        let BaseLook {
            colour,
            picture,
            normals,
            coverage,
            double_sided,
        } = look;
        // What comes from a format without metals is none.
        let mut base = format!(
            r#""baseColorFactor":{},"metallicFactor":0,"roughnessFactor":1"#,
            json_floats(colour)
        );
        if let Some(picture) = picture {
            base += &format!(r#","baseColorTexture":{{"index":{}}}"#, self.picture_number(picture));
        }
        let normals = normals.as_ref().map(|picture| self.picture_number(picture));
        let normals = normals.map_or_else(String::new, |number| {
            format!(r#","normalTexture":{{"index":{number}}}"#)
        });
        let coverage = match coverage {
            AlphaCoverage::Opaque => String::new(),
            AlphaCoverage::Mask(cutoff) => format!(r#","alphaMode":"MASK","alphaCutoff":{:?}"#, f64::from(*cutoff)),
            AlphaCoverage::Blend => r#","alphaMode":"BLEND""#.to_owned(),
        };
        let sides = if *double_sided { r#","doubleSided":true"# } else { "" };
        format!(r#"{{"name":{name},"pbrMetallicRoughness":{{{base}}}{normals}{coverage}{sides}}}"#)
    }

    /// The number of a picture, which several materials may use.
    fn picture_number(&mut self, picture: &MaterialPicture) -> usize {
        let known = self.pictures.iter().position(|known| known == picture);
        known.unwrap_or_else(|| {
            self.pictures.push(picture.clone());
            self.pictures.len() - 1
        })
    }
}

/// Normals of unit length, as glTF demands; where one has no direction, the surface's.
fn unit_normals(normals: &[Vec3], geometry: &Geometry, first: usize, indices: &[u32]) -> Vec<f32> {
    let mut unit: Vec<Option<Vec3>> = normals.iter().map(|n| n.try_normalize()).collect();
    if unit.contains(&None) {
        let triangles = indices.as_chunks::<3>().0;
        let smooth = shading::smooth_normals(&geometry.positions[first..first + normals.len()], triangles);
        unit.iter_mut()
            .zip(smooth)
            .for_each(|(n, smooth)| *n = n.or(Some(smooth)));
    }
    unit.into_iter().flat_map(|n| n.unwrap_or(Vec3::Z).to_array()).collect()
}

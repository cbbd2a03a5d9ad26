//! A new, minimal asset for geometry that came from another format.

use super::buffers::{self, media_type_of};
use super::builder::{BufferBuilder, INDICES, NewAccessor, VERTICES, index_bytes, json_floats};
use super::container::{self, GltfFault};
use super::document::GLB_FORMAT;
use super::text::{json_array, json_object, quoted};
use crate::look::{AlphaMode, MaterialPicture, NamedMaterial};
use crate::neutral::{NeutralModel, NeutralPrimitive};
use crate::{Error, Format, Primitive, WrittenFiles};
use glam::{DVec3, Vec3};
use pliant_mesh::{BoundingBox, shading};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The name of a list of the document, and its text.
type Section = (&'static str, String);

/// One buffer, one node and mesh for each primitive, with positions, indices, and normals, texture coordinates and
/// colours where there are any; and materials with their pictures. Far from the origin nodes have a translation, and meshes numbers of
/// their own size.
pub(super) fn build(neutral: &NeutralModel, format: Format) -> Result<WrittenFiles, Error> {
    let fault = GltfFault(format);
    let origin = BoundingBox::of(&neutral.geometry.positions).origin_like(neutral.origin);
    let mut asset = BuiltAsset {
        fault,
        origin,
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
        let mut node = vec![("mesh", nodes.len().to_string())];
        node.extend(name_of(own.primitive));
        node.extend(translation_to(origin));
        nodes.push(json_object(node));
    }
    if nodes.is_empty() {
        return Err(fault.unwritable("there are no triangles"));
    }
    let scene = json_object([("nodes", json_array(0..nodes.len()))]);
    let (materials, companions) = asset.material_sections();
    let BuiltAsset { data, meshes, .. } = asset;
    let bytes = data.bytes();
    let mut buffer = vec![("byteLength", bytes.len().to_string())];
    if format != GLB_FORMAT {
        buffer.push(("uri", quoted(&buffers::embed(bytes))));
    }
    let header = json_object([("version", quoted("2.0")), ("generator", quoted("pliant"))]);
    let mut sections = vec![
        ("asset", header),
        ("scene", "0".to_owned()),
        ("scenes", json_array([scene])),
        ("nodes", json_array(nodes)),
        ("meshes", json_array(meshes)),
        ("accessors", json_array(data.accessor_texts(0))),
        ("bufferViews", json_array(data.view_texts(0, 0))),
        ("buffers", json_array([json_object(buffer)])),
    ];
    sections.extend(materials);
    let json = json_object(sections);
    let main = if format == GLB_FORMAT {
        container::join(&json, Some(bytes), &[], fault)?
    } else {
        json.into_bytes()
    };
    Ok(WrittenFiles::of(main, companions))
}

/// The member of a mesh that says which vertices of the source its own are, where they are not those of the same numbers.
fn source_map(neutral: &NeutralModel, own: &NeutralPrimitive<'_>) -> Option<(&'static str, String)> {
    let runs = neutral.source_runs(own.vertices.clone())?;
    let runs = json_array(runs.iter().map(json_array));
    Some(("extras", json_object([("sourceVertices", runs)])))
}

/// The member of a node that puts its mesh there; `None` at the origin itself.
pub(super) fn translation_to(origin: DVec3) -> Option<(&'static str, String)> {
    (origin != DVec3::ZERO).then(|| ("translation", json_array(origin.to_array().map(|v| format!("{v:?}")))))
}

/// The member of a node or mesh that names it.
fn name_of(primitive: &Primitive) -> Option<(&'static str, String)> {
    (!primitive.name.is_empty()).then(|| ("name", quoted(&primitive.name)))
}

struct BuiltAsset {
    fault: GltfFault,
    /// What positions are relative to.
    origin: DVec3,
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

        let positions: Vec<Vec3> = in_world.iter().map(|p| (*p - self.origin).as_vec3()).collect();
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
        let position = self.add_floats(&floats, "VEC3", Some(bounds));
        let mut attributes = vec![("POSITION", position)];
        if primitive.has_normals
            && let Some(normals) = geometry.normals.get(first..last)
        {
            let normals = unit_normals(normals, in_world, indices.as_chunks::<3>().0);
            attributes.push(("NORMAL", self.add_floats(normals.as_flattened(), "VEC3", None)));
        }
        if let Some(uv) = neutral.uv.get(first..last).filter(|_| part.has_uv) {
            attributes.push(("TEXCOORD_0", self.add_floats(uv.as_flattened(), "VEC2", None)));
        }
        if let Some(colours) = neutral.colours.get(first..last).filter(|_| part.has_colours) {
            attributes.push(("COLOR_0", self.add_floats(colours.as_flattened(), "VEC4", None)));
        }
        let material = part.material.as_ref().map(|material| self.material_number(material));
        let drawn = [
            ("attributes", json_object(attributes)),
            ("indices", self.add_indices(&indices, count).to_string()),
            ("mode", "4".to_owned()),
        ];
        let material = material.map(|number| ("material", number.to_string()));
        let drawn = json_object(drawn.into_iter().chain(material));
        let mut mesh = vec![("primitives", json_array([drawn]))];
        mesh.extend(name_of(primitive));
        mesh.extend(source_map(neutral, own));
        self.meshes.push(json_object(mesh));
        Ok(())
    }

    fn add_floats(&mut self, values: &[f32], shape: &'static str, bounds: Option<(String, String)>) -> usize {
        self.data.push_floats(values, shape, Some(VERTICES), bounds)
    }

    fn add_indices(&mut self, indices: &[u32], vertices: usize) -> usize {
        let (bytes, component) = index_bytes(indices, vertices);
        let accessor = NewAccessor::of(component, indices.len(), "SCALAR");
        self.data.push_packed(&bytes, Some(INDICES), accessor)
    }

    fn material_number(&mut self, material: &Arc<NamedMaterial>) -> usize {
        let known = self.materials.iter().position(|known| known == material);
        known.unwrap_or_else(|| {
            self.materials.push(Arc::clone(material));
            self.materials.len() - 1
        })
    }

    /// The sections of materials, textures and images; and the pictures of kinds that a buffer cannot hold, as files.
    fn material_sections(&mut self) -> (Vec<Section>, BTreeMap<String, Vec<u8>>) {
        let materials = std::mem::take(&mut self.materials);
        let texts: Vec<String> = materials.iter().map(|m| self.material_text(m)).collect();
        let (mut images, mut companions) = (Vec::new(), BTreeMap::new());
        for picture in std::mem::take(&mut self.pictures) {
            let bytes = picture.bytes.as_deref();
            let media_type = bytes.and_then(|bytes| media_type_of(&picture.name, bytes));
            if let (Some(bytes), Some(media_type)) = (bytes, media_type) {
                let view = self.data.add_view(bytes, None).to_string();
                let name = ("name", quoted(&picture.name));
                images.push(json_object([
                    ("bufferView", view),
                    ("mimeType", quoted(media_type)),
                    name,
                ]));
                continue;
            }
            images.push(json_object([("uri", quoted(&buffers::of_file_name(&picture.name)))]));
            if let Some(bytes) = bytes {
                companions.insert(picture.name.clone(), bytes.to_vec());
            }
        }
        let textures = (0..images.len()).map(|i| json_object([("source", i)])).collect();
        let lists = [("materials", texts), ("textures", textures), ("images", images)];
        let sections = lists.into_iter().filter(|(_, list)| !list.is_empty());
        (
            sections.map(|(key, list)| (key, json_array(list))).collect(),
            companions,
        )
    }

    fn material_text(&mut self, material: &NamedMaterial) -> String {
        let mut members = vec![("name", quoted(&material.name))];
        let Some(look) = &material.look else {
            return json_object(members);
        };
        let mut texture_of = |picture: &MaterialPicture| json_object([("index", self.picture_number(picture))]);
        // What comes from a format without metals is none.
        let mut base = vec![
            ("baseColorFactor", json_floats(&look.colour)),
            ("metallicFactor", "0".to_owned()),
            ("roughnessFactor", "1".to_owned()),
        ];
        base.extend(
            look.picture
                .as_ref()
                .map(|picture| ("baseColorTexture", texture_of(picture))),
        );
        members.push(("pbrMetallicRoughness", json_object(base)));
        members.extend(
            look.normals
                .as_ref()
                .map(|picture| ("normalTexture", texture_of(picture))),
        );
        match look.coverage {
            AlphaMode::Opaque => {}
            AlphaMode::Mask(cutoff) => members.extend([
                ("alphaMode", quoted("MASK")),
                ("alphaCutoff", format!("{:?}", f64::from(cutoff))),
            ]),
            AlphaMode::Blend => members.push(("alphaMode", quoted("BLEND"))),
        }
        if look.double_sided {
            members.push(("doubleSided", "true".to_owned()));
        }
        json_object(members)
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
pub(in super::super) fn unit_normals(given: &[Vec3], positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut unit: Vec<Option<Vec3>> = given.iter().map(|n| n.try_normalize()).collect();
    if unit.contains(&None) {
        let smooth = shading::smooth_normals(positions, triangles);
        unit.iter_mut()
            .zip(smooth)
            .for_each(|(n, smooth)| *n = n.or(Some(smooth)));
    }
    unit.into_iter().map(|n| n.unwrap_or(Vec3::Z).to_array()).collect()
}

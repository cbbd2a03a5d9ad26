//! Base colours, opacity and pictures of materials.

use super::super::gltf::{self, GlbWriter};
use super::scene::{TranslationNotes, embedded_bytes, texture_file};
use crate::asset::{Error, FileSet};
use bytes::Bytes;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use ufbx::{Material, MaterialMap, Texture, TextureType};

/// The materials in use, by their numbers in the file, and the pictures that they show.
pub(super) struct MaterialTable<'a> {
    files: &'a FileSet,
    /// By the number in the file the number in the asset.
    known: BTreeMap<u32, usize>,
    materials: Vec<Value>,
    pictures: Vec<ShownPicture>,
}

/// A picture that a material shows.
struct ShownPicture {
    /// The name of its file.
    name: String,
    /// The file; `None` where it did not come along.
    bytes: Option<Bytes>,
}

/// The sections of the asset that say how it looks.
pub(super) struct MaterialSections {
    pub materials: Vec<Value>,
    pub textures: Vec<Value>,
    pub images: Vec<Value>,
}

impl<'a> MaterialTable<'a> {
    /// A table without materials; pictures beside the model are found in `files`.
    pub(super) fn new(files: &'a FileSet) -> Self {
        Self {
            files,
            known: BTreeMap::new(),
            materials: Vec::new(),
            pictures: Vec::new(),
        }
    }

    /// The number of a material in the asset.
    pub(super) fn number_of(&mut self, material: &Material, notes: &mut TranslationNotes) -> usize {
        let id = material.element.typed_id;
        if let Some(known) = self.known.get(&id) {
            return *known;
        }
        let json = self.material_json(material, notes);
        self.materials.push(json);
        self.known.insert(id, self.materials.len() - 1);
        self.materials.len() - 1
    }

    fn material_json(&mut self, material: &Material, notes: &mut TranslationNotes) -> Value {
        let pbr = &material.pbr;
        let texture = pbr
            .base_color
            .texture
            .as_ref()
            .filter(|_| pbr.base_color.texture_enabled);
        let picture = texture.and_then(|texture| self.picture_of(texture, notes));
        let factor = first_value(&pbr.base_factor).unwrap_or(1.0);
        let colour = &pbr.base_color;
        // A picture stands in place of the colour.
        let rgb = match picture {
            None if colour.has_value => {
                let v = colour.value_vec4;
                [v.x, v.y, v.z].map(|x| unit(x * factor))
            }
            _ => [1.0; 3],
        };
        let opacity = opacity_of(material);
        let mut base = json!({
            "baseColorFactor": [rgb[0], rgb[1], rgb[2], opacity],
            "metallicFactor": first_value(&pbr.metalness).map_or(0.0, unit),
            "roughnessFactor": first_value(&pbr.roughness).map_or(1.0, unit),
        });
        if let Some(number) = picture {
            base["baseColorTexture"] = json!({"index": number});
        }
        let mut json = json!({"pbrMetallicRoughness": base});
        if !material.element.name.is_empty() {
            json["name"] = json!(&*material.element.name);
        }
        if opacity < 1.0 || pbr.opacity.texture.is_some() {
            json["alphaMode"] = json!("BLEND");
        }
        if material.features.double_sided.enabled {
            json["doubleSided"] = json!(true);
        }
        let maps = [&pbr.normal_map, &pbr.roughness, &pbr.metalness, &pbr.emission_color];
        if maps.iter().any(|map| map.texture.is_some()) {
            notes.leave_out("textures other than the base colour's");
        }
        json
    }

    /// The number of the picture that a texture shows; of several layers the lowest.
    fn picture_of(&mut self, texture: &Texture, notes: &mut TranslationNotes) -> Option<usize> {
        let texture = if texture.type_ == TextureType::File {
            texture
        } else {
            notes.leave_out("layers and procedures of textures");
            texture.file_textures.iter().next()?
        };
        if texture.has_uv_transform {
            notes.leave_out("shifts and turns of textures");
        }
        let name = texture_file(texture).unwrap_or_else(|| format!("texture{}", texture.element.typed_id));
        let embedded = embedded_bytes(texture);
        let same =
            |known: &ShownPicture| known.name == name && (embedded.is_none() || known.bytes.as_deref() == embedded);
        let found = self.pictures.iter().position(same);
        Some(found.unwrap_or_else(|| {
            let beside = || self.files.companions.get(&name).cloned();
            let bytes = embedded.map(Bytes::copy_from_slice).or_else(beside);
            self.pictures.push(ShownPicture { name, bytes });
            self.pictures.len() - 1
        }))
    }

    /// The sections, with pictures put into the buffer; those of kinds that it cannot hold are files beside the asset.
    pub(super) fn finish(self, buffer: &mut GlbWriter) -> Result<(MaterialSections, BTreeMap<String, Bytes>), Error> {
        let (mut images, mut companions) = (Vec::new(), BTreeMap::new());
        for ShownPicture { name, bytes } in self.pictures {
            let kind = bytes.as_deref().and_then(|bytes| gltf::media_type_of(&name, bytes));
            match (bytes, kind) {
                (Some(bytes), Some(kind)) => {
                    let view = buffer.add_view(&bytes)?;
                    images.push(json!({"bufferView": view, "mimeType": kind, "name": name}));
                }
                (bytes, _) => {
                    images.push(json!({"uri": gltf::uri_of_name(&name)}));
                    companions.extend(bytes.map(|bytes| (name, bytes)));
                }
            }
        }
        let textures = (0..images.len()).map(|i| json!({"source": i})).collect();
        let sections = MaterialSections {
            materials: self.materials,
            textures,
            images,
        };
        Ok((sections, companions))
    }
}

/// How opaque a material is: what it says, else what its transparency leaves. Exporters write a transparency of one for
/// opaque materials too, so nothing is taken to be invisible by that.
fn opacity_of(material: &Material) -> f32 {
    if let Some(opacity) = first_value(&material.pbr.opacity) {
        return unit(opacity);
    }
    let told = ufbx::find_prop(&material.element.props, "Opacity").map(|prop| prop.value_vec4.x);
    if let Some(told) = told.filter(|told| told.is_finite()) {
        return unit(told);
    }
    let fbx = &material.fbx;
    let colour = if fbx.transparency_color.has_value {
        let v = fbx.transparency_color.value_vec4;
        (v.x + v.y + v.z) / 3.0
    } else {
        1.0
    };
    let left = unit(1.0 - first_value(&fbx.transparency_factor).unwrap_or(0.0) * colour);
    if left > 0.0 { left } else { 1.0 }
}

/// The number that a map says, where it says one.
fn first_value(map: &MaterialMap) -> Option<f64> {
    (map.has_value && map.value_vec4.x.is_finite()).then_some(map.value_vec4.x)
}

fn unit(value: f64) -> f32 {
    if value.is_finite() {
        value.clamp(0.0, 1.0) as f32
    } else {
        1.0
    }
}

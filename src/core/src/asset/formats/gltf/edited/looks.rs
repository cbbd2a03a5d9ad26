//! What an edited glTF gives to other formats.

use super::super::buffers::BufferBytes;
use super::super::document::GltfDocument;
use super::super::read::GltfNotes;
use super::super::text::{list_of, parse_index, value_of};
use super::super::uri::{self, RelativeName, file_extension};
use super::blended::{AttributeBlender, read};
use crate::asset::edited::{EditedModel, PrimitiveRun};
use crate::asset::look::{AlphaCoverage, BaseLook, MaterialPicture, NamedMaterial, inside_folder};
use crate::asset::neutral::RunAttributes;
use crate::asset::{Error, FileSet};
use bytes::Bytes;
use serde_json::Value;
use std::collections::BTreeSet;
use std::sync::Arc;

/// The texture coordinates of the base colour, the first colours and the material of runs of one base.
pub(in super::super) fn run_attributes(
    edited: &EditedModel<'_>,
    runs: &[&PrimitiveRun],
) -> Result<Vec<RunAttributes>, Error> {
    let model = runs.first().map(|run| edited.base(run).model);
    let Some((model, notes)) = model.and_then(|model| Some((model, model.notes::<GltfNotes>()?))) else {
        return Ok(Vec::new());
    };
    let (doc, mut buffers) = notes.document_and_bytes(model)?;
    let materials = read_looks(&doc, notes.files(model), &buffers)?;
    let mut all = Vec::with_capacity(runs.len());
    for run in runs {
        let row = &notes.rows[run.primitive as usize];
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let mixer = AttributeBlender::new(edited, run);
        let mut extras = RunAttributes::default();
        let stored = list_of(doc.meshes.items[row.mesh], "primitives");
        let material = stored
            .get(row.primitive)
            .and_then(|p| value_of(p, "material"))
            .and_then(parse_index)
            .and_then(|m| materials.get(m));
        extras.material = material.map(|(material, _)| Arc::clone(material));
        // The coordinates that the picture of the base colour uses.
        let own_set = material.map(|(_, set)| format!("TEXCOORD_{set}"));
        let set = own_set.filter(|set| primitive.attribute(set).is_some());
        let set = set.as_deref().unwrap_or("TEXCOORD_0");
        let used: BTreeSet<usize> = [set, "COLOR_0"].iter().filter_map(|n| primitive.attribute(n)).collect();
        buffers.decode_for(&doc, &used)?;
        if let Some(accessor) = primitive.attribute(set) {
            let channel = read(&doc, &buffers, accessor)?;
            if channel.lanes == 2 {
                extras.uv = mixer.blend_linearly(&channel).as_chunks::<2>().0.to_vec();
            }
        }
        if let Some(accessor) = primitive.attribute("COLOR_0") {
            let channel = read(&doc, &buffers, accessor)?;
            let values = mixer.blend_linearly(&channel);
            extras.colours = match channel.lanes {
                3 => values
                    .as_chunks::<3>()
                    .0
                    .iter()
                    .map(|&[r, g, b]| [r, g, b, 1.0])
                    .collect(),
                4 => values.as_chunks::<4>().0.to_vec(),
                _ => Vec::new(),
            };
        }
        all.push(extras);
    }
    Ok(all)
}

/// A material, and the set of texture coordinates that its picture uses.
pub(super) type LookedAt = (Arc<NamedMaterial>, usize);

/// All materials of a document.
pub(super) fn read_looks(
    doc: &GltfDocument<'_>,
    files: &FileSet,
    buffers: &BufferBytes,
) -> Result<Vec<LookedAt>, Error> {
    let textures = parsed_items(doc, "textures")?;
    let images = parsed_items(doc, "images")?;
    let mut pictures = ImageNames {
        doc,
        files,
        buffers,
        images: &images,
        taken: BTreeSet::new(),
        made: vec![None; images.len()],
    };
    let mut looks = Vec::new();
    for (m, material) in parsed_items(doc, "materials")?.iter().enumerate() {
        let name = material["name"].as_str().filter(|name| !name.is_empty());
        let name = name.map_or_else(|| format!("material_{m}"), str::to_owned);
        let (look, set) = read_look(material, &textures, &mut pictures);
        looks.push((Arc::new(NamedMaterial { name, look }), set));
    }
    Ok(looks)
}

fn parsed_items(doc: &GltfDocument<'_>, key: &str) -> Result<Vec<Value>, Error> {
    let parse = |(i, text): (usize, &str)| {
        let parsed = serde_json::from_str(text);
        parsed.map_err(|e| doc.fault.malformed(format!("{key}/{i}"), e.to_string()))
    };
    list_of(doc.text, key).into_iter().enumerate().map(parse).collect()
}

/// What a material says of its base; `None` where it says nothing that another format knows.
fn read_look(material: &Value, textures: &[Value], pictures: &mut ImageNames<'_, '_>) -> (Option<BaseLook>, usize) {
    let base = &material["pbrMetallicRoughness"];
    let mut look = BaseLook {
        double_sided: material["doubleSided"].as_bool().unwrap_or(false),
        ..BaseLook::default()
    };
    for (lane, to) in look.colour.iter_mut().enumerate() {
        if let Some(value) = base["baseColorFactor"][lane].as_f64() {
            *to = (value as f32).clamp(0.0, 1.0);
        }
    }
    look.coverage = match material["alphaMode"].as_str() {
        Some("MASK") => AlphaCoverage::Mask(material["alphaCutoff"].as_f64().unwrap_or(0.5) as f32),
        Some("BLEND") => AlphaCoverage::Blend,
        _ => AlphaCoverage::Opaque,
    };
    let (texture, normals) = (&base["baseColorTexture"], &material["normalTexture"]);
    look.picture = source_of(texture, textures).and_then(|image| pictures.picture_of(image));
    let set = match look.picture {
        Some(_) => set_of(texture),
        None => set_of(normals),
    };
    // Other formats have one set of texture coordinates for both.
    let shared = source_of(normals, textures).filter(|_| set_of(normals) == set);
    look.normals = shared.and_then(|image| pictures.picture_of(image));
    let says_something = look != BaseLook::default();
    (says_something.then_some(look), usize::try_from(set).unwrap_or(0))
}

/// The set of texture coordinates that the use of a texture names.
fn set_of(used: &Value) -> u64 {
    let moved = &used["extensions"]["KHR_texture_transform"]["texCoord"];
    moved.as_u64().or(used["texCoord"].as_u64()).unwrap_or(0)
}

/// The image of a texture that is used: its own, else one of another kind that an extension names.
fn source_of(used: &Value, textures: &[Value]) -> Option<usize> {
    let number = |value: &Value| value.as_u64().and_then(|n| usize::try_from(n).ok());
    let stored = number(&used["index"]).and_then(|t| textures.get(t))?;
    let others = [
        "EXT_texture_webp",
        "EXT_texture_avif",
        "KHR_texture_basisu",
        "MSFT_texture_dds",
    ];
    let mut other = others.iter().map(|name| &stored["extensions"][name]["source"]);
    number(&stored["source"]).or_else(|| other.find_map(number))
}

/// The images of a document as files: by the names that they have, else by new ones.
struct ImageNames<'i, 'a> {
    doc: &'i GltfDocument<'a>,
    files: &'i FileSet,
    buffers: &'i BufferBytes<'i>,
    images: &'i [Value],
    taken: BTreeSet<String>,
    made: Vec<Option<MaterialPicture>>,
}

impl ImageNames<'_, '_> {
    fn picture_of(&mut self, image: usize) -> Option<MaterialPicture> {
        let stored = self.images.get(image)?;
        if let Some(made) = self.made.get(image)?.clone() {
            return Some(made);
        }
        let uri = stored["uri"].as_str();
        let made = match uri.map(uri::relative_name) {
            Some(RelativeName::Inside(name)) => {
                let bytes = self.files.companions.get(&name).cloned();
                self.taken.insert(name.clone());
                MaterialPicture { name, bytes }
            }
            _ => {
                let bytes = match uri {
                    Some(uri) => Bytes::from(uri::embedded_bytes(uri)?),
                    None => {
                        let view = usize::try_from(stored["bufferView"].as_u64()?).ok()?;
                        Bytes::copy_from_slice(self.buffers.view(self.doc, view).ok()?)
                    }
                };
                let extension = file_extension(stored["mimeType"].as_str(), &bytes);
                let name = self.free_name(stored["name"].as_str().unwrap_or("image"), image, extension);
                let bytes = Some(bytes);
                MaterialPicture { name, bytes }
            }
        };
        self.made[image] = Some(made.clone());
        Some(made)
    }

    /// A name for a file that no other image has.
    fn free_name(&mut self, wanted: &str, image: usize, extension: &str) -> String {
        let plain = |c: char| {
            if c.is_alphanumeric() || "-_.".contains(c) {
                c
            } else {
                '_'
            }
        };
        let stem: String = wanted.chars().take(80).map(plain).collect();
        let stem = stem
            .strip_suffix(&format!(".{extension}"))
            .unwrap_or(&stem)
            .trim_matches('.');
        let name = format!("{stem}.{extension}");
        let free = inside_folder(&name).filter(|name| !stem.is_empty() && !self.taken.contains(name));
        let name = free.unwrap_or_else(|| format!("{stem}-{image}.{extension}"));
        self.taken.insert(name.clone());
        name
    }
}

//! What materials look like: base colours and their pictures, texture coordinates, vertex colours.
//!
//! Nothing here can fail a read: a material that is not as the standard wants it counts as none, a picture that is not
//! there is said in its place.

use super::buffers::{self, UriTarget};
use super::document::GltfDocument;
use super::read::{GltfNotes, PlacedPrimitive};
use super::schema::WholeNumber;
use super::text::{index_of, list_of, string_of};
use crate::look::{AlphaMode, BaseMaterial, PicturePlacing, SurfaceLook, TextureUse, TextureWrap};
use crate::{Error, Model};
use bytes::Bytes;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// A material; one that is not as the standard wants it counts as none.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct MaterialItem {
    name: String,
    pbr_metallic_roughness: Option<MetallicItem>,
    alpha_mode: String,
    alpha_cutoff: Option<f32>,
    double_sided: bool,
    extensions: MaterialExtensions,
}

impl MaterialItem {
    /// Reads the text of a material.
    fn parse(text: &str) -> Self {
        serde_json::from_str(text).unwrap_or_default()
    }

    /// What its opacity means.
    fn alpha(&self) -> AlphaMode {
        match self.alpha_mode.as_str() {
            "MASK" => AlphaMode::Mask(self.alpha_cutoff.filter(|c| *c >= 0.0).unwrap_or(0.5)),
            "BLEND" => AlphaMode::Blend,
            _ => AlphaMode::Opaque,
        }
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct MetallicItem {
    base_color_factor: Option<[f32; 4]>,
    base_color_texture: Option<TextureInfo>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct MaterialExtensions {
    #[serde(rename = "KHR_materials_unlit")]
    unlit: Option<serde::de::IgnoredAny>,
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    glossy: Option<GlossyItem>,
}

/// Where models of some years ago have their colours.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct GlossyItem {
    diffuse_factor: Option<[f32; 4]>,
    diffuse_texture: Option<TextureInfo>,
}

/// How a material uses a texture.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct TextureInfo {
    index: WholeNumber,
    tex_coord: Option<WholeNumber>,
    #[serde(default)]
    extensions: InfoExtensions,
}

impl TextureInfo {
    /// The set of texture coordinates that it names.
    fn set(&self) -> u64 {
        let moved = self.extensions.transform.as_ref().and_then(|t| t.tex_coord);
        moved.or(self.tex_coord).map_or(0, |n| n.0)
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct InfoExtensions {
    #[serde(rename = "KHR_texture_transform")]
    transform: Option<TransformItem>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct TransformItem {
    offset: [f64; 2],
    rotation: f64,
    scale: Option<[f64; 2]>,
    tex_coord: Option<WholeNumber>,
}

/// A material, and what its texture coordinates are.
struct MaterialInUse {
    look: BaseMaterial,
    /// The set of coordinates, and what is done to them: u' = m0 u + m1 v + m2, v' = m3 u + m4 v + m5.
    coordinates: Option<(u64, [f64; 6])>,
}

/// Reads what a model looks like.
pub(super) fn surface_look(model: &Model, notes: &GltfNotes) -> Result<SurfaceLook, Error> {
    let doc = notes.loaded_document(model)?;
    let list = |key: &str| list_of(doc.text, key);
    let sections = LookSections {
        materials: list("materials"),
        textures: list("textures"),
        samplers: list("samplers"),
    };
    let images = list("images");
    let mut look = SurfaceLook {
        is_flat_without_normals: true,
        ..SurfaceLook::default()
    };
    let mut numbers: BTreeMap<Option<usize>, u32> = BTreeMap::new();
    let mut in_use: Vec<MaterialInUse> = Vec::new();
    for row in &notes.rows {
        let index = material_number(&doc, row).filter(|&m| m < sections.materials.len());
        let number = *numbers.entry(index).or_insert_with(|| {
            in_use.push(sections.read_material(index));
            in_use.len() as u32 - 1
        });
        look.material_of.push(number);
        let material = &in_use[number as usize];
        add_coordinates(&doc, row, material, &mut look, model.positions.len())?;
        add_colours(&doc, row, &mut look, model.positions.len())?;
    }
    look.materials = in_use.into_iter().map(|m| m.look).collect();
    let wanted: BTreeSet<usize> = look
        .materials
        .iter()
        .flat_map(|m| &m.texture)
        .map(|t| t.image)
        .collect();
    let mut places = BTreeMap::new();
    for index in wanted {
        places.insert(index, look.images.len());
        let found = images
            .get(index)
            .ok_or_else(|| "its picture is of a kind that is not read".to_owned());
        look.images
            .push(found.and_then(|text| image_bytes(&doc, model, index, text)));
    }
    for texture in look.materials.iter_mut().flat_map(|m| &mut m.texture) {
        texture.image = places.get(&texture.image).copied().unwrap_or_default();
    }
    Ok(look)
}

/// The material that a placed primitive names.
fn material_number(doc: &GltfDocument<'_>, row: &PlacedPrimitive) -> Option<usize> {
    let primitives = list_of(doc.item(&doc.meshes, row.mesh), "primitives");
    index_of(primitives.get(row.primitive)?, "material")
}

/// The lists of a document that say what materials look like, as texts.
struct LookSections<'a> {
    materials: Vec<&'a str>,
    textures: Vec<&'a str>,
    samplers: Vec<&'a str>,
}

impl LookSections<'_> {
    fn read_material(&self, index: Option<usize>) -> MaterialInUse {
        let item = index.and_then(|i| self.materials.get(i));
        let (Some(item), Some(index)) = (item.map(|text| MaterialItem::parse(text)), index) else {
            return MaterialInUse {
                look: BaseMaterial::default(),
                coordinates: None,
            };
        };
        let alpha = item.alpha();
        let (factor, info) = match (item.pbr_metallic_roughness, item.extensions.glossy) {
            (None, Some(glossy)) => (glossy.diffuse_factor, glossy.diffuse_texture),
            (metallic, _) => {
                let metallic = metallic.unwrap_or_default();
                (metallic.base_color_factor, metallic.base_color_texture)
            }
        };
        let unit = |x: f32| if x >= 0.0 { x.min(1.0) } else { 0.0 };
        let look = BaseMaterial {
            name: if item.name.is_empty() {
                format!("material {index}")
            } else {
                item.name
            },
            factor: factor.unwrap_or([1.0; 4]).map(unit),
            texture: info.as_ref().map(|info| self.read_texture(info)),
            alpha,
            double_sided: item.double_sided,
            unlit: item.extensions.unlit.is_some(),
        };
        let coordinates = info.map(|info| {
            let set = info.set();
            (set, matrix_of(&info.extensions.transform.unwrap_or_default()))
        });
        MaterialInUse { look, coordinates }
    }

    fn read_texture(&self, info: &TextureInfo) -> TextureUse {
        let texture = self.textures.get(info.index.index()).copied().unwrap_or_default();
        let sampler = index_of(texture, "sampler").and_then(|s| self.samplers.get(s));
        let sampler = sampler.copied().unwrap_or_default();
        let wrap = |key: &str| match index_of(sampler, key) {
            Some(33071) => TextureWrap::Clamp,
            Some(33648) => TextureWrap::Mirror,
            _ => TextureWrap::Repeat,
        };
        TextureUse {
            // Beyond all images when it names none; extensions may name a picture of another kind.
            image: index_of(texture, "source").unwrap_or(usize::MAX),
            wrap: [wrap("wrapS"), wrap("wrapT")],
            nearest: index_of(sampler, "magFilter") == Some(9728),
        }
    }
}

/// Where texture coordinates lie on a texture that is used.
pub(super) fn placing_of(used: &serde_json::Value) -> PicturePlacing {
    let stored = &used["extensions"]["KHR_texture_transform"];
    let transform = TransformItem::deserialize(stored).unwrap_or_default();
    PicturePlacing(matrix_of(&transform))
}

/// `KHR_texture_transform`: scale, then rotate, then offset.
fn matrix_of(transform: &TransformItem) -> [f64; 6] {
    let (sin, cos) = libm::sincos(transform.rotation);
    let [sx, sy] = transform.scale.unwrap_or([1.0; 2]);
    let [ox, oy] = transform.offset;
    let matrix = [cos * sx, sin * sy, ox, -sin * sx, cos * sy, oy];
    if matrix.iter().all(|x| x.is_finite()) {
        matrix
    } else {
        [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    }
}

fn add_coordinates(
    doc: &GltfDocument<'_>,
    row: &PlacedPrimitive,
    material: &MaterialInUse,
    look: &mut SurfaceLook,
    vertices: usize,
) -> Result<(), Error> {
    let Some((set, [a, b, c, d, e, f])) = material.coordinates else {
        return Ok(());
    };
    let Some((2, values)) = read_attribute(doc, row, &format!("TEXCOORD_{set}"))? else {
        return Ok(());
    };
    look.uv.resize(vertices, [0.0; 2]);
    for (place, &own) in look.uv[row.vertices.clone()].iter_mut().zip(values.as_chunks::<2>().0) {
        let [u, v] = own.map(f64::from);
        let moved = [a * u + b * v + c, d * u + e * v + f];
        *place = moved.map(|x| if x.is_finite() { x as f32 } else { 0.0 });
    }
    Ok(())
}

fn add_colours(
    doc: &GltfDocument<'_>,
    row: &PlacedPrimitive,
    look: &mut SurfaceLook,
    vertices: usize,
) -> Result<(), Error> {
    let Some((lanes @ (3 | 4), values)) = read_attribute(doc, row, "COLOR_0")? else {
        return Ok(());
    };
    look.colours.resize(vertices, [1.0; 4]);
    for (place, own) in look.colours[row.vertices.clone()]
        .iter_mut()
        .zip(values.chunks_exact(lanes))
    {
        for (channel, &x) in place.iter_mut().zip(own) {
            *channel = if x >= 0.0 { x.min(1.0) } else { 0.0 };
        }
    }
    Ok(())
}

/// An attribute of a placed primitive, with how many numbers a vertex has; `None` when it is not there or has another
/// number of vertices.
fn read_attribute(
    doc: &GltfDocument<'_>,
    row: &PlacedPrimitive,
    name: &str,
) -> Result<Option<(usize, Vec<f32>)>, Error> {
    let Some(index) = doc.meshes.values[row.mesh].primitives[row.primitive].attribute(name) else {
        return Ok(None);
    };
    let Some(layout) = doc
        .layout(index)
        .filter(|_| doc.accessors.values[index].count.index() == row.vertices.len())
    else {
        return Ok(None);
    };
    Ok(Some((layout.lanes, doc.read_values(index, layout)?)))
}

/// The file of a picture, or why there is none.
fn image_bytes(doc: &GltfDocument<'_>, model: &Model, index: usize, text: &str) -> Result<Bytes, String> {
    let Some(uri) = string_of(text, "uri") else {
        let view = index_of(text, "bufferView").ok_or_else(|| format!("image {index} names no file"))?;
        let bytes = doc.view(view).map_err(|e| e.to_string())?;
        return Ok(Bytes::copy_from_slice(bytes));
    };
    if uri.starts_with("data:") {
        let decoded = buffers::embedded_bytes(&uri).map(Bytes::from);
        return decoded.ok_or_else(|| format!("image {index} is not base64 data"));
    }
    match buffers::resolve(&uri, &format!("images/{index}/uri"), doc.fault, &mut |_| Ok(())) {
        Ok(UriTarget::Companion(name)) => match model.files.companions.get(&name) {
            Some(bytes) => Ok(bytes.clone()),
            None => Err(format!("the picture {name:?} is missing")),
        },
        Ok(UriTarget::Embedded(bytes)) => Ok(bytes.into()),
        Err(e) => Err(e.to_string()),
    }
}

//! Materials of an edited glTF: what they give to other formats, and how they are copied along with a joined base.

use super::super::buffers::{self, RelativeName, file_extension};
use super::super::builder::BufferBuilder;
use super::super::document::GltfDocument;
use super::super::looks::placing_of;
use super::super::read::GltfNotes;
use super::super::text::{index_of, list_of, quoted, with_member, without_keys};
use super::blended::{AttributeBlender, read};
use crate::edited::{EditedModel, PrimitiveRun};
use crate::look::{AlphaMode, BaseLook, MaterialPicture, NamedMaterial, inside_folder};
use crate::neutral::{CAP_COLOUR, RunAttributes};
use crate::{Error, FileSet, WrittenWarning};
use bytes::Bytes;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
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
    let doc = notes.loaded_document(model)?;
    let materials = read_looks(&doc, notes.files(model))?;
    let mut all = Vec::with_capacity(runs.len());
    for run in runs {
        let row = &notes.rows[run.primitive as usize];
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let mixer = AttributeBlender::new(edited, run);
        let mut extras = RunAttributes::default();
        let stored = list_of(doc.item(&doc.meshes, row.mesh), "primitives");
        let material = stored
            .get(row.primitive)
            .and_then(|p| index_of(p, "material"))
            .and_then(|m| materials.get(m));
        extras.material = material.map(|(material, _)| Arc::clone(material));
        // The coordinates that the picture of the base colour uses.
        let own_set = material.map(|(_, set)| format!("TEXCOORD_{set}"));
        let set = own_set.filter(|set| primitive.attribute(set).is_some());
        let set = set.as_deref().unwrap_or("TEXCOORD_0");
        if let Some(accessor) = primitive.attribute(set) {
            let channel = read(&doc, accessor)?;
            if channel.lanes == 2 {
                extras.uv = mixer.blend_linearly(&channel).as_chunks::<2>().0.to_vec();
            }
        }
        if let Some(accessor) = primitive.attribute("COLOR_0") {
            let channel = read(&doc, accessor)?;
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
type LookedAt = (Arc<NamedMaterial>, usize);

/// All materials of a document.
fn read_looks(doc: &GltfDocument<'_>, files: &FileSet) -> Result<Vec<LookedAt>, Error> {
    let textures = parsed_items(doc, "textures")?;
    let images = parsed_items(doc, "images")?;
    let mut pictures = ImageNames {
        doc,
        files,
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

/// Parses the items of a section.
fn parsed_items(doc: &GltfDocument<'_>, key: &str) -> Result<Vec<Value>, Error> {
    let texts = list_of(doc.text, key).into_iter().enumerate();
    texts.map(|(i, text)| parsed_item(doc, key, i, text)).collect()
}

fn parsed_item(doc: &GltfDocument<'_>, key: &str, index: usize, text: &str) -> Result<Value, Error> {
    serde_json::from_str(text).map_err(|e| doc.fault.malformed(format!("{key}/{index}"), e.to_string()))
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
        Some("MASK") => AlphaMode::Mask(material["alphaCutoff"].as_f64().unwrap_or(0.5) as f32),
        Some("BLEND") => AlphaMode::Blend,
        _ => AlphaMode::Opaque,
    };
    let (texture, normals) = (&base["baseColorTexture"], &material["normalTexture"]);
    look.picture = source_of(texture, textures).and_then(|image| pictures.picture_of(image));
    let set = match look.picture {
        Some(_) => set_of(texture),
        None => set_of(normals),
    };
    look.placing = placing_of(if look.picture.is_some() { texture } else { normals });
    // Other formats have one set of texture coordinates for both.
    let is_shared = set_of(normals) == set && placing_of(normals) == look.placing;
    let shared = source_of(normals, textures).filter(|_| is_shared);
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
        let made = match uri.map(buffers::relative_name) {
            Some(RelativeName::Inside(name)) => {
                let bytes = self.files.companions.get(&name).cloned();
                self.taken.insert(name.clone());
                MaterialPicture { name, bytes }
            }
            _ => {
                let bytes = match uri {
                    Some(uri) => Bytes::from(buffers::embedded_bytes(uri)?),
                    None => {
                        let view = usize::try_from(stored["bufferView"].as_u64()?).ok()?;
                        Bytes::copy_from_slice(self.doc.view(view).ok()?)
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

/// What was taken over from one base so far.
pub(super) struct MaterialCopier<'p> {
    doc: &'p GltfDocument<'p>,
    files: &'p FileSet,
    /// The files of the first base, whose names are taken.
    first: &'p FileSet,
    base: usize,
    /// New numbers by section and old number; `None` where the base has no such item.
    known: BTreeMap<(&'static str, usize), Option<usize>>,
}

/// Extensions of textures that only name another image.
const OTHER_IMAGE: [&str; 4] = [
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
];

/// Where new things go.
pub(super) struct CopyTarget<'t, 'f> {
    pub(super) frame: &'t GltfDocument<'f>,
    pub(super) fresh: &'t mut BufferBuilder,
    pub(super) joined: &'t mut JoinedBases,
}

impl<'p> MaterialCopier<'p> {
    pub(super) fn new(doc: &'p GltfDocument<'p>, files: &'p FileSet, first: &'p FileSet, base: usize) -> Self {
        Self {
            doc,
            files,
            first,
            base,
            known: BTreeMap::new(),
        }
    }

    /// The new number of a material of the base; `None` when there is none of that number.
    pub(super) fn copy_material(&mut self, old: usize, to: &mut CopyTarget<'_, '_>) -> Result<Option<usize>, Error> {
        self.copy_item("materials", old, to, |copier, mut material, to| {
            copier.keep_extensions(&mut material, to, |name| name.contains("_materials_"));
            copier.textures_in(&mut material, to)?;
            Ok((material.to_string(), None))
        })
    }

    /// The new number of an item of a section, which `copy` makes of the parsed one when it is first asked for.
    fn copy_item(
        &mut self,
        key: &'static str,
        old: usize,
        to: &mut CopyTarget<'_, '_>,
        copy: impl FnOnce(&mut Self, Value, &mut CopyTarget<'_, '_>) -> Result<JoinedItem, Error>,
    ) -> Result<Option<usize>, Error> {
        if let Some(new) = self.known.get(&(key, old)) {
            return Ok(*new);
        }
        let mut new = None;
        if let Some(text) = list_of(self.doc.text, key).get(old) {
            let item = copy(self, parsed_item(self.doc, key, old, text)?, to)?;
            let joined = to.joined.sections.entry(key).or_default();
            joined.push(item);
            new = Some(list_of(to.frame.text, key).len() + joined.len() - 1);
        }
        self.known.insert((key, old), new);
        Ok(new)
    }

    /// Takes out the extensions of an object that are not kept, and notes those that are.
    fn keep_extensions(&self, object: &mut Value, to: &mut CopyTarget<'_, '_>, keep: impl Fn(&str) -> bool) {
        let Some(object) = object.as_object_mut() else { return };
        if let Some(extensions) = object.get_mut("extensions").and_then(Value::as_object_mut) {
            extensions.retain(|name, _| keep(name));
            for name in extensions.keys() {
                let note = |list: &mut Vec<String>| {
                    if !list.contains(name) {
                        list.push(name.clone());
                    }
                };
                note(&mut to.joined.extensions_used);
                if self.doc.extensions_required.contains(name) {
                    note(&mut to.joined.extensions_required);
                }
            }
            if extensions.is_empty() {
                object.remove("extensions");
            }
        }
    }

    /// Renumbers every texture that a material names, at any depth; a parsed text is at most 128 levels deep.
    fn textures_in(&mut self, material: &mut Value, to: &mut CopyTarget<'_, '_>) -> Result<(), Error> {
        let Some(object) = material.as_object_mut() else {
            return Ok(());
        };
        let mut lost = Vec::new();
        for (key, inner) in object.iter_mut().filter(|(key, _)| *key != "extras") {
            if !key.ends_with("Texture") || inner.get("index").is_none() {
                self.textures_in(inner, to)?;
                continue;
            }
            let old = inner.get("index").and_then(Value::as_u64).unwrap_or(u64::MAX);
            match self.copy_texture(usize::try_from(old).unwrap_or(usize::MAX), to)? {
                Some(new) => inner["index"] = new.into(),
                None => lost.push(key.clone()),
            }
            self.keep_extensions(inner, to, |name| name == "KHR_texture_transform");
        }
        for key in lost {
            object.shift_remove(&key);
        }
        Ok(())
    }

    fn copy_texture(&mut self, old: usize, to: &mut CopyTarget<'_, '_>) -> Result<Option<usize>, Error> {
        self.copy_item("textures", old, to, |copier, mut texture, to| {
            copier.keep_extensions(&mut texture, to, |name| OTHER_IMAGE.contains(&name));
            if let Some(texture) = texture.as_object_mut() {
                copier.renumber_image(texture, to)?;
                for name in OTHER_IMAGE {
                    let inner = texture.get_mut("extensions").and_then(|e| e.get_mut(name));
                    if let Some(inner) = inner.and_then(Value::as_object_mut) {
                        copier.renumber_image(inner, to)?;
                    }
                }
                if let Some(old) = index_member(texture, "sampler") {
                    let stored = list_of(copier.doc.text, "samplers");
                    let copy = |_: &mut Self, _, _: &mut CopyTarget<'_, '_>| Ok((stored[old].to_owned(), None));
                    let sampler = copier.copy_item("samplers", old, to, copy)?;
                    renumber(texture, "sampler", sampler);
                }
            }
            Ok((texture.to_string(), None))
        })
    }

    fn renumber_image(&mut self, object: &mut Map<String, Value>, to: &mut CopyTarget<'_, '_>) -> Result<(), Error> {
        if let Some(source) = index_member(object, "source") {
            let image = self.copy_image(source, to)?;
            renumber(object, "source", image);
        }
        Ok(())
    }

    fn copy_image(&mut self, old: usize, to: &mut CopyTarget<'_, '_>) -> Result<Option<usize>, Error> {
        self.copy_item("images", old, to, |copier, image, to| {
            let stored = list_of(copier.doc.text, "images")[old];
            let text = without_keys(stored, &["bufferView", "extensions"]);
            if let Some(stored) = image.as_object().and_then(|i| index_member(i, "bufferView")) {
                let view = to.fresh.add_view(copier.doc.view(stored)?, None);
                return Ok((text, Some(view)));
            }
            let Some(uri) = image["uri"].as_str() else {
                return Ok((text, None));
            };
            let uri = quoted(&copier.free_companion_uri(uri, to));
            Ok((with_member(&text, "uri", uri), None))
        })
    }

    /// The URI under which a companion image comes along: its own, unless another file has that name.
    fn free_companion_uri(&self, uri: &str, to: &mut CopyTarget<'_, '_>) -> String {
        let name = percent_encoding::percent_decode_str(uri)
            .decode_utf8_lossy()
            .into_owned();
        let Some(bytes) = self.files.companions.get(&name) else {
            return uri.to_owned();
        };
        let taken = self.first.companions.get(&name).map(|b| &b[..]).or(to
            .joined
            .companions
            .get(&name)
            .map(|b| &b[..]));
        if taken == Some(&bytes[..]) {
            return uri.to_owned();
        }
        let (prefix, name) = if taken.is_none() {
            (String::new(), name)
        } else {
            let prefix = format!("merged-{}-", self.base);
            (prefix.clone(), prefix_file_name(&prefix, &name))
        };
        to.joined.companions.insert(name, bytes.to_vec());
        prefix_file_name(&prefix, uri)
    }
}

/// The path with a prefix before the name of its file.
fn prefix_file_name(prefix: &str, path: &str) -> String {
    match path.rsplit_once('/') {
        Some((folder, name)) => format!("{folder}/{prefix}{name}"),
        None => format!("{prefix}{path}"),
    }
}

/// Gives a key of an object a new number; without one it goes.
fn renumber(object: &mut Map<String, Value>, key: &str, new: Option<usize>) {
    match new {
        Some(new) => drop(object.insert(key.into(), new.into())),
        None => drop(object.shift_remove(key)),
    }
}

fn index_member(object: &Map<String, Value>, key: &str) -> Option<usize> {
    object
        .get(key)
        .and_then(Value::as_u64)
        .and_then(|n| usize::try_from(n).ok())
}

/// The text of an item, and its new view, if it has one.
type JoinedItem = (String, Option<usize>);

/// What joins the document. Accessors are numbered virtually, as in the frame.
#[derive(Default)]
pub(super) struct JoinedBases {
    pub(super) meshes: Vec<String>,
    /// Nodes; their meshes count from 0 among the joined ones.
    pub(super) nodes: Vec<(String, Option<usize>)>,
    /// The new nodes that the scene lists.
    pub(super) roots: Vec<usize>,
    /// New children by the number of the node in the whole file.
    pub(super) children: BTreeMap<usize, Vec<usize>>,
    pub(super) skins: Vec<String>,
    pub(super) warnings: Vec<WrittenWarning>,
    /// Materials, textures, samplers and images, by section.
    sections: BTreeMap<&'static str, Vec<JoinedItem>>,
    pub(super) extensions_used: Vec<String>,
    pub(super) extensions_required: Vec<String>,
    pub(super) companions: BTreeMap<String, Vec<u8>>,
}

impl JoinedBases {
    /// Nothing but the materials of caps, which so come first.
    pub(super) fn of_caps(edited: &EditedModel<'_>) -> Self {
        let [r, g, b, a] = CAP_COLOUR;
        let text = |name: &&str| {
            let name = quoted(name);
            let base = format!(r#"{{"baseColorFactor":[{r},{g},{b},{a}],"metallicFactor":0}}"#);
            (format!(r#"{{"name":{name},"pbrMetallicRoughness":{base}}}"#), None)
        };
        let materials: Vec<JoinedItem> = edited.cap_materials().iter().map(text).collect();
        let mut joined = Self::default();
        if !materials.is_empty() {
            joined.sections.insert("materials", materials);
        }
        joined
    }

    pub(super) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The new nodes, with joined meshes numbered from `first_mesh` on.
    pub(super) fn node_texts(&self, first_mesh: usize) -> Vec<String> {
        let one = |(text, mesh): &(String, Option<usize>)| match mesh {
            Some(mesh) => with_member(text, "mesh", first_mesh + mesh),
            None => text.clone(),
        };
        self.nodes.iter().map(one).collect()
    }

    /// The new items of a section, with new views numbered from `first_view` on.
    pub(super) fn item_texts(&self, key: &'static str, first_view: usize) -> Vec<String> {
        let one = |(text, view): &JoinedItem| match view {
            Some(view) => with_member(text, "bufferView", first_view + view),
            None => text.clone(),
        };
        self.sections.get(key).into_iter().flatten().map(one).collect()
    }
}

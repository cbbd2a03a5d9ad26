//! Materials that come along with a joined base, with what they draw with.

use super::super::buffers::BufferBytes;
use super::super::builder::BufferBuilder;
use super::super::document::GltfDocument;
use super::super::text::{list_of, quoted, with_member, without_keys};
use crate::asset::{Error, FileSet};
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// What was taken over from one base so far: new numbers by old ones.
pub(super) struct MaterialCopier<'p> {
    doc: &'p GltfDocument<'p>,
    files: &'p FileSet,
    /// The files of the first base, whose names are taken.
    first: &'p FileSet,
    base: usize,
    materials: BTreeMap<usize, Option<usize>>,
    textures: BTreeMap<usize, Option<usize>>,
    images: BTreeMap<usize, Option<usize>>,
    samplers: BTreeMap<usize, Option<usize>>,
}

/// Extensions of textures that only name another image.
const OTHER_IMAGE: [&str; 4] = [
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
];

/// Where new things go.
struct CopyTarget<'t, 'f> {
    frame: &'t GltfDocument<'f>,
    buffers: &'t BufferBytes<'t>,
    fresh: &'t mut BufferBuilder,
    joined: &'t mut JoinedBases,
}

impl<'p> MaterialCopier<'p> {
    pub(super) fn new(doc: &'p GltfDocument<'p>, files: &'p FileSet, first: &'p FileSet, base: usize) -> Self {
        Self {
            doc,
            files,
            first,
            base,
            materials: BTreeMap::new(),
            textures: BTreeMap::new(),
            images: BTreeMap::new(),
            samplers: BTreeMap::new(),
        }
    }

    /// The new number of a material of the base; `None` when there is none of that number.
    pub(super) fn copy_material(
        &mut self,
        old: usize,
        frame: &GltfDocument<'_>,
        buffers: &BufferBytes,
        fresh: &mut BufferBuilder,
        joined: &mut JoinedBases,
    ) -> Result<Option<usize>, Error> {
        if let Some(new) = self.materials.get(&old) {
            return Ok(*new);
        }
        let mut to = CopyTarget {
            frame,
            buffers,
            fresh,
            joined,
        };
        let new = match self.parse_item("materials", old)? {
            None => None,
            Some(mut material) => {
                self.keep_extensions(&mut material, &mut to, |name| name.contains("_materials_"));
                self.textures_in(&mut material, &mut to)?;
                to.joined.materials.push(material.to_string());
                Some(next_number(to.frame, "materials", to.joined.materials.len() - 1))
            }
        };
        self.materials.insert(old, new);
        Ok(new)
    }

    fn parse_item(&self, key: &str, index: usize) -> Result<Option<Value>, Error> {
        let Some(text) = list_of(self.doc.text, key).get(index).copied() else {
            return Ok(None);
        };
        let parsed = serde_json::from_str(text);
        parsed
            .map(Some)
            .map_err(|e| self.doc.fault.malformed(format!("{key}/{index}"), e.to_string()))
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
        if let Some(new) = self.textures.get(&old) {
            return Ok(*new);
        }
        let new = match self.parse_item("textures", old)? {
            None => None,
            Some(mut texture) => {
                self.keep_extensions(&mut texture, to, |name| OTHER_IMAGE.contains(&name));
                if let Some(texture) = texture.as_object_mut() {
                    self.renumber_image(texture, to)?;
                    for name in OTHER_IMAGE {
                        let inner = texture.get_mut("extensions").and_then(|e| e.get_mut(name));
                        if let Some(inner) = inner.and_then(Value::as_object_mut) {
                            self.renumber_image(inner, to)?;
                        }
                    }
                    if let Some(sampler) = index_member(texture, "sampler") {
                        match self.copy_sampler(sampler, to)? {
                            Some(new) => drop(texture.insert("sampler".into(), new.into())),
                            None => drop(texture.shift_remove("sampler")),
                        }
                    }
                }
                to.joined.textures.push(texture.to_string());
                Some(next_number(to.frame, "textures", to.joined.textures.len() - 1))
            }
        };
        self.textures.insert(old, new);
        Ok(new)
    }

    fn renumber_image(&mut self, object: &mut Map<String, Value>, to: &mut CopyTarget<'_, '_>) -> Result<(), Error> {
        if let Some(source) = index_member(object, "source") {
            match self.copy_image(source, to)? {
                Some(new) => drop(object.insert("source".into(), new.into())),
                None => drop(object.shift_remove("source")),
            }
        }
        Ok(())
    }

    fn copy_sampler(&mut self, old: usize, to: &mut CopyTarget<'_, '_>) -> Result<Option<usize>, Error> {
        if let Some(new) = self.samplers.get(&old) {
            return Ok(*new);
        }
        let new = list_of(self.doc.text, "samplers").get(old).map(|text| {
            to.joined.samplers.push((*text).to_owned());
            next_number(to.frame, "samplers", to.joined.samplers.len() - 1)
        });
        self.samplers.insert(old, new);
        Ok(new)
    }

    fn copy_image(&mut self, old: usize, to: &mut CopyTarget<'_, '_>) -> Result<Option<usize>, Error> {
        if let Some(new) = self.images.get(&old) {
            return Ok(*new);
        }
        let new = match self.parse_item("images", old)? {
            None => None,
            Some(image) => {
                let mut text = without_keys(list_of(self.doc.text, "images")[old], &["bufferView", "extensions"]);
                let mut view = None;
                if let Some(stored) = image.as_object().and_then(|i| index_member(i, "bufferView")) {
                    view = Some(to.fresh.add_view(to.buffers.view(self.doc, stored)?, None));
                } else if let Some(uri) = image["uri"].as_str() {
                    text = with_member(&text, "uri", quoted(&self.free_companion_uri(uri, to)));
                }
                to.joined.images.push((text, view));
                Some(next_number(to.frame, "images", to.joined.images.len() - 1))
            }
        };
        self.images.insert(old, new);
        Ok(new)
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

fn index_member(object: &Map<String, Value>, key: &str) -> Option<usize> {
    object
        .get(key)
        .and_then(Value::as_u64)
        .and_then(|n| usize::try_from(n).ok())
}

/// What joins the document. Accessors are numbered virtually, as in the frame.
#[derive(Default)]
pub(super) struct JoinedBases {
    pub(super) meshes: Vec<String>,
    /// Nodes; their meshes count from 0 among the joined ones.
    pub(super) nodes: Vec<(String, Option<usize>)>,
    /// The new nodes that the scene lists.
    pub(super) roots: Vec<usize>,
    pub(super) materials: Vec<String>,
    pub(super) textures: Vec<String>,
    pub(super) samplers: Vec<String>,
    /// Images; with their new view, if they have one.
    pub(super) images: Vec<(String, Option<usize>)>,
    pub(super) extensions_used: Vec<String>,
    pub(super) extensions_required: Vec<String>,
    pub(super) companions: BTreeMap<String, Vec<u8>>,
}

impl JoinedBases {
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

    /// The new images, with new views numbered from `first_view` on.
    pub(super) fn image_texts(&self, first_view: usize) -> Vec<String> {
        let one = |(text, view): &(String, Option<usize>)| match view {
            Some(view) => with_member(text, "bufferView", first_view + view),
            None => text.clone(),
        };
        self.images.iter().map(one).collect()
    }
}

/// The stored items of a section and those that have joined it.
pub(super) fn next_number(frame: &GltfDocument<'_>, key: &str, joined: usize) -> usize {
    list_of(frame.text, key).len() + joined
}

//! A glTF document: its text, and the sections that geometry needs, item by item.

use super::container::{self, GlbContainer, GltfFault};
use super::schema::{AssetHeader, BufferView, GltfAccessor, GltfBuffer, GltfMesh, GltfNode, GltfScene, WholeNumber};
use super::stored::BufferBytes;
use super::text::{count_items, items, members, place_in};
use crate::files::ReadWatch;
use crate::format::{FormatDetails, Recognition};
use crate::{Error, FileSet, Format};
use serde::de::DeserializeOwned;
use std::cell::Cell;
use std::ops::{Deref, Range};

/// Binary glTF, by what it is known.
pub(in super::super) const GLB_FORMAT: Format = Format::new(&FormatDetails {
    name: "glb",
    aliases: &["vrm"],
    media_types: &["model/gltf-binary"],
    recognise: |bytes| Recognition::mark(bytes.starts_with(b"glTF")),
});

/// glTF as JSON, by what it is known.
pub(in super::super) const GLTF_FORMAT: Format = Format::new(&FormatDetails {
    name: "gltf",
    aliases: &[],
    media_types: &["model/gltf+json"],
    recognise: |bytes| Recognition::mark(bytes.trim_ascii_start().starts_with(b"{")),
});

/// One top-level array of a document, item by item.
#[derive(Debug)]
pub(super) struct DocumentSection<T> {
    /// Where the array lies in the text; `None` when the document has none.
    array: Option<Range<usize>>,
    /// Where its items lie.
    items: Vec<Range<usize>>,
    /// Its items as values.
    pub(super) values: Vec<T>,
}

impl<T> DocumentSection<T> {
    pub(super) fn len(&self) -> usize {
        self.items.len()
    }

    /// The item of that index, which has been checked to be in range or may be absent.
    pub(super) fn get(&self, index: usize) -> Option<&T> {
        self.values.get(index)
    }
}

/// What is parsed of a document, once. A model owns it for life, and [`ParsedDocument::of`] joins it to the files.
#[derive(Debug)]
pub(super) struct ParsedDocument {
    format: Format,
    pub(super) buffers: DocumentSection<GltfBuffer>,
    pub(super) views: DocumentSection<BufferView>,
    pub(super) accessors: DocumentSection<GltfAccessor>,
    pub(super) meshes: DocumentSection<GltfMesh>,
    pub(super) nodes: DocumentSection<GltfNode>,
    pub(super) scenes: DocumentSection<GltfScene>,
    /// The default scene.
    pub(super) scene: Option<usize>,
    /// Skins and animations as texts; only their references are ever looked at.
    pub(super) skins: DocumentSection<()>,
    pub(super) animations: DocumentSection<()>,
    pub(super) extensions_used: Vec<String>,
    pub(super) extensions_required: Vec<String>,
    /// About how many bytes all of it takes, as it was reserved.
    bytes: u64,
}

/// A parsed document with its text, and the bytes of its buffers once they are loaded; borrows the files it came from.
/// Dereferences to what is parsed.
pub(super) struct GltfDocument<'a> {
    parsed: &'a ParsedDocument,
    pub(super) fault: GltfFault,
    /// The JSON text.
    pub(super) text: &'a str,
    /// The GLB parts, when it came in a GLB.
    pub(super) container: Option<GlbContainer<'a>>,
    /// The bytes of its buffers.
    pub(super) bytes: BufferBytes<'a>,
}

impl Deref for GltfDocument<'_> {
    type Target = ParsedDocument;

    fn deref(&self) -> &ParsedDocument {
        self.parsed
    }
}

/// The JSON text of a main file, and the GLB that it lies in.
fn text_of(main: &[u8], format: Format) -> Result<(&str, Option<GlbContainer<'_>>), Error> {
    let fault = GltfFault(format);
    let container = if format == GLB_FORMAT {
        Some(container::split(main, fault)?)
    } else {
        None
    };
    let bytes = container.as_ref().map_or(main, |c| c.json);
    if bytes.starts_with(b"\xef\xbb\xbf") {
        return Err(fault.malformed("json", "starts with a byte order mark, which glTF does not allow"));
    }
    let text = std::str::from_utf8(bytes)
        .map_err(|e| fault.malformed("json", format!("byte {} is not UTF-8", e.valid_up_to())))?;
    Ok((text, container))
}

impl ParsedDocument {
    /// Parses the main file of a set; references between sections are checked by [`check`](super::references::check).
    ///
    /// What the parsed text will take is counted before it is: an empty item of three bytes becomes hundreds.
    pub(super) fn parse(files: &FileSet, format: Format, watch: &ReadWatch<'_>) -> Result<Self, Error> {
        let fault = GltfFault(format);
        let (text, _) = text_of(&files.main, format)?;
        // Its texts, such as data URIs, are copied once.
        watch.check_document(text.len() as u64)?;
        let root = JsonRoot {
            fault,
            text,
            allowance: DocumentAllowance::new(text, watch),
            members: members(text).map_err(|e| fault.malformed("json", e.to_string()))?,
        };

        // First of all: a document of another version has other rules for everything else.
        check_version(root.one::<AssetHeader>("asset")?, fault)?;
        let extensions_used = root.one("extensionsUsed")?.unwrap_or_default();
        let extensions_required: Vec<String> = root.one("extensionsRequired")?.unwrap_or_default();
        check_required(&extensions_required, fault)?;

        Ok(Self {
            format,
            buffers: root.section("buffers")?,
            views: root.section("bufferViews")?,
            accessors: root.section("accessors")?,
            meshes: root.section("meshes")?,
            nodes: root.section("nodes")?,
            scenes: root.section("scenes")?,
            scene: root.one::<WholeNumber>("scene")?.map(WholeNumber::index),
            skins: root.texts_section("skins")?,
            animations: root.texts_section("animations")?,
            extensions_used,
            extensions_required,
            bytes: root.allowance.counted.get(),
        })
    }

    /// About how many bytes it holds in memory.
    pub(super) fn bytes_held(&self) -> u64 {
        self.bytes
    }

    /// The document with the text that it was parsed from, the main file of `files`; without the bytes of its buffers.
    pub(super) fn of<'a>(&'a self, files: &'a FileSet) -> Result<GltfDocument<'a>, Error> {
        let (text, container) = text_of(&files.main, self.format)?;
        Ok(GltfDocument {
            parsed: self,
            fault: GltfFault(self.format),
            text,
            container,
            bytes: BufferBytes::default(),
        })
    }

    /// Whether the document says that it uses an extension.
    pub(super) fn uses(&self, extension: &str) -> bool {
        self.extensions_used
            .iter()
            .chain(&self.extensions_required)
            .any(|e| e == extension)
    }
}

impl<'a> GltfDocument<'a> {
    /// An item of a section as text; an empty one when it has no such item.
    pub(super) fn item<T>(&self, section: &DocumentSection<T>, index: usize) -> &'a str {
        section.items.get(index).map_or("", |place| &self.text[place.clone()])
    }

    /// The items of a section as texts.
    pub(super) fn items<T>(&self, section: &DocumentSection<T>) -> impl Iterator<Item = &'a str> {
        section.items.iter().map(|place| &self.text[place.clone()])
    }

    /// A GLB of a new text and chunk, with the other chunks that the document came with.
    pub(super) fn join(&self, json: &str, bin: Option<&[u8]>, fault: GltfFault) -> Result<Vec<u8>, Error> {
        let rest = self.container.as_ref().map_or(&[][..], |c| &c.rest);
        container::join(json, bin, rest, fault)
    }

    /// The chunk that it came with.
    pub(super) fn chunk(&self) -> Option<&'a [u8]> {
        self.container.as_ref()?.bin
    }

    /// A section as text; `None` when the document has none.
    pub(super) fn array<T>(&self, section: &DocumentSection<T>) -> Option<&'a str> {
        section.array.clone().map(|place| &self.text[place])
    }
}

/// What the items of a document may take, and what those that were counted will.
struct DocumentAllowance<'a> {
    watch: &'a ReadWatch<'a>,
    most: u64,
    counted: Cell<u64>,
}

impl<'a> DocumentAllowance<'a> {
    /// Bytes for each byte of the text: a node that only places a mesh takes less.
    const BYTES_PER_BYTE: u64 = 64;
    /// Bytes that no document is refused for.
    const FREE: u64 = 16 << 20;
    /// Bytes of an item beside its value: slices of the text, its place in the scene.
    const BYTES_PER_ITEM: u64 = 192;

    fn new(text: &str, watch: &'a ReadWatch<'a>) -> Self {
        Self {
            watch,
            most: (text.len() as u64).saturating_mul(Self::BYTES_PER_BYTE) + Self::FREE,
            counted: Cell::new(text.len() as u64),
        }
    }

    /// Counts the items of one section, each a value of so many bytes.
    fn count_section(&self, key: &str, text: &str, value_bytes: usize, fault: GltfFault) -> Result<usize, Error> {
        let mut cancelled = false;
        let items = count_items(text, |item| {
            cancelled = self.watch.check_at(item).is_err();
            !cancelled
        });
        if cancelled {
            return Err(Error::Cancelled);
        }
        let items = items.map_err(|e| fault.malformed(key, without_position(&e.to_string())))?;
        let bytes = (items as u64).saturating_mul(value_bytes as u64 + Self::BYTES_PER_ITEM);
        let all = self.counted.get().saturating_add(bytes);
        self.counted.set(all);
        if all > self.most {
            let problem = format!(
                "{items} items, of which many are empty, take {all} bytes; {} bytes of text may take {}",
                (self.most - Self::FREE) / Self::BYTES_PER_BYTE,
                self.most
            );
            return Err(fault.malformed(key, problem));
        }
        self.watch.check_document(all)?;
        Ok(items)
    }
}

struct JsonRoot<'a, 'w> {
    fault: GltfFault,
    text: &'a str,
    allowance: DocumentAllowance<'w>,
    members: Vec<super::text::JsonMember<'a>>,
}

impl<'a> JsonRoot<'a, '_> {
    fn find(&self, key: &str) -> Result<Option<&'a str>, Error> {
        let mut found = self.members.iter().filter(|m| m.key == key).map(|m| m.value);
        match (found.next(), found.next()) {
            (_, Some(_)) => Err(self.fault.malformed(key, "occurs twice")),
            (value, None) => Ok(value),
        }
    }

    fn one<T: DeserializeOwned>(&self, key: &str) -> Result<Option<T>, Error> {
        self.find(key)?
            .map(|text| parse_value(text, key, self.fault))
            .transpose()
    }

    /// A section of which no values are made.
    fn texts_section(&self, key: &str) -> Result<DocumentSection<()>, Error> {
        self.section_of(key, 0, |_, _| Ok(()))
    }

    fn section<T: DeserializeOwned>(&self, key: &str) -> Result<DocumentSection<T>, Error> {
        self.section_of(key, size_of::<T>(), |i, text| {
            self.allowance.watch.check_at(i)?;
            parse_value(text, &format!("{key}/{i}"), self.fault)
        })
    }

    /// A section of which `parse` makes values of so many bytes.
    fn section_of<T>(
        &self,
        key: &str,
        value_bytes: usize,
        parse: impl Fn(usize, &'a str) -> Result<T, Error>,
    ) -> Result<DocumentSection<T>, Error> {
        let array = self.find(key)?;
        let mut texts = Vec::new();
        if let Some(array) = array {
            self.allowance.count_section(key, array, value_bytes, self.fault)?;
            texts = items(array).map_err(|e| self.fault.malformed(key, without_position(&e.to_string())))?;
        }
        let values = texts.iter().enumerate().map(|(i, text)| parse(i, text));
        Ok(DocumentSection {
            values: values.collect::<Result<_, Error>>()?,
            array: array.map(|array| place_in(self.text, array)),
            items: texts.iter().map(|part| place_in(self.text, part)).collect(),
        })
    }
}

/// Reads one value, naming the place inside it that is wrong.
fn parse_value<T: DeserializeOwned>(text: &str, place: &str, fault: GltfFault) -> Result<T, Error> {
    serde_path_to_error::deserialize(&mut serde_json::Deserializer::from_str(text)).map_err(|e| {
        let inside = e.path().to_string().replace(['.', '['], "/").replace([']', '?'], "");
        let inside = inside.trim_matches('/');
        let separator = if inside.is_empty() { "" } else { "/" };
        fault.malformed(
            format!("{place}{separator}{inside}"),
            without_position(&e.inner().to_string()),
        )
    })
}

/// The parser counts lines from the start of the slice it was given, which would mislead.
fn without_position(text: &str) -> String {
    text.rfind(" at line ").map_or(text, |at| &text[..at]).to_owned()
}

fn check_version(asset: Option<AssetHeader>, fault: GltfFault) -> Result<(), Error> {
    let Some(asset) = asset else {
        return Err(fault.malformed("asset", "missing; glTF 2.0 needs asset.version"));
    };
    let read = |text: &str, place: &str| {
        let parts = text
            .split_once('.')
            .and_then(|(major, minor)| Some((digits(major)?, digits(minor)?)));
        parts.ok_or_else(|| fault.malformed(place, format!("{text:?} is not a version such as 2.0")))
    };
    let version = read(&asset.version, "asset/version")?;
    if version.0 != 2 {
        let problem = format!("glTF version {}, only 2.x is read", asset.version);
        return Err(fault.unsupported("asset/version", problem, "convert it to glTF 2.0"));
    }
    if let Some(text) = &asset.min_version {
        let least = read(text, "asset/minVersion")?;
        if least > version {
            let problem = format!("{text} is above the asset's own version {}", asset.version);
            return Err(fault.malformed("asset/minVersion", problem));
        }
        if least > (2, 0) {
            let problem = format!("needs a reader of version {text}, this one reads 2.0");
            return Err(fault.unsupported("asset/minVersion", problem, "export it as glTF 2.0"));
        }
    }
    Ok(())
}

fn digits(text: &str) -> Option<u32> {
    text.bytes()
        .all(|b| b.is_ascii_digit())
        .then(|| text.parse().ok())
        .flatten()
}

/// Families of extensions that say how a model looks, moves or is described, and never how its triangles are stored.
const HARMLESS: [&str; 21] = [
    "_materials_",
    "_texture_",
    "_lights_",
    "_node_",
    "_animation_",
    "_xmp",
    "_metadata",
    "_vrm",
    "_mesh_features",
    "_instance_features",
    "_physics_",
    "_collision_",
    "_audio",
    "_environment",
    "_lod",
    "_variants",
    "_mesh_gpu_instancing",
    "_ngon_encoding",
    "cesium_rtc",
    "_articulations",
    "_techniques_",
];

/// Extensions that this reader knows, or that it need not know.
fn is_readable(extension: &str) -> bool {
    matches!(
        extension,
        "KHR_mesh_quantization" | "EXT_meshopt_compression" | "KHR_meshopt_compression" | "KHR_draco_mesh_compression"
    ) || HARMLESS
        .iter()
        .any(|family| extension.to_ascii_lowercase().contains(family))
}

fn check_required(required: &[String], fault: GltfFault) -> Result<(), Error> {
    match required.iter().position(|e| !is_readable(e)) {
        None => Ok(()),
        Some(i) => Err(fault.unsupported(
            format!("extensionsRequired/{i}"),
            format!("extension {:?} is required and not known here", required[i]),
            "export without it",
        )),
    }
}

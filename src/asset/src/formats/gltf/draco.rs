//! Draco-compressed primitives become ordinary ones before anything else is read.
//!
//! A document with primitives that are kept in Draco alone is read, edited and written in a form without them: each
//! decoded attribute gets a view of its own behind the data that is there, its accessor names that view, and the extension
//! goes. Streams that nothing else names go too: the first decoded view takes the place of theirs. Numbers of accessors,
//! views and meshes stay. A model that nothing was done to still comes back as it was uploaded.

use super::accessors::{AccessorLayout, ComponentType};
use super::buffers;
use super::builder::{BufferBuilder, INDICES, VERTICES, bounds, embedded_buffer_text};
use super::document::{GLB_FORMAT, GltfDocument};
use super::schema::{DRACO, MeshPrimitive, WholeNumber};
use super::stored::BufferOrigin;
use super::text::{JsonEdits, json_array, list_of, quoted, value_of};
use super::used_bytes::{BufferCuts, count_view_uses};
use crate::files::ReadWatch;
use crate::{Error, FileSet};
use draco_core::{DataType, DecodeLimits, DecoderBuffer, ErrorKind, Mesh, MeshDecoder, PointAttribute, PointIndex};
use serde::Deserialize;
use std::collections::BTreeMap;

/// Bytes of memory that a stream is decoded within first for each of its bytes, and at least.
const BYTES_PER_BYTE: u64 = 64;
const LEAST_BYTES: u64 = 1 << 20;
/// Bytes of memory that decoding takes for a face (its corners and their neighbours), and for a byte of a value (as it is stored,
/// predicted and given out).
const BYTES_PER_FACE: u64 = 128;
const BYTES_PER_VALUE_BYTE: u64 = 4;
/// How often what was decoded is in memory at most until it is written into plain files.
const COPIES: u64 = 4;

/// What the extension says of a primitive.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct DracoStream {
    buffer_view: WholeNumber,
    /// The identity of each attribute in the stream, by its name.
    attributes: BTreeMap<String, WholeNumber>,
}

/// The files in a form without primitives that are kept in Draco alone, and how many those were; `None` when there is
/// none.
pub(super) fn uncompress(
    doc: &GltfDocument<'_>,
    files: &FileSet,
    watch: &ReadWatch<'_>,
) -> Result<Option<(FileSet, usize)>, Error> {
    let mut streams = DracoUncompressor {
        doc,
        edits: JsonEdits::new(doc.text),
        watch,
        decoded: BTreeMap::new(),
        filled: BTreeMap::new(),
        data: BufferBuilder::default(),
        uses_left: count_view_uses(doc).unwrap_or_default(),
        unused: Vec::new(),
        replaced: Vec::new(),
    };
    let (mut compressed, mut left) = (Vec::new(), 0);
    for (m, mesh) in doc.meshes.values.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate().filter(|(_, p)| p.has_draco()) {
            if needs_draco(doc, primitive) {
                compressed.push((m, p));
            } else {
                left += 1;
            }
        }
    }
    if compressed.is_empty() {
        return Ok(None);
    }
    compressed.iter().for_each(|&(m, p)| streams.forget_use(m, p));
    for &(m, p) in &compressed {
        streams.uncompress_primitive(m, p)?;
    }
    let files = streams.write_plain_files(files, left == 0)?;
    Ok(Some((files, compressed.len())))
}

/// Whether a primitive's triangles are only to be had from its Draco stream.
fn needs_draco(doc: &GltfDocument<'_>, primitive: &MeshPrimitive) -> bool {
    let used = primitive.attributes.values().chain(&primitive.indices);
    doc.extensions_required.iter().any(|e| e == DRACO)
        || used
            .map(|a| a.index())
            .any(|a| doc.accessors.values[a].buffer_view.is_none() && doc.accessors.values[a].sparse.is_none())
}

/// How many faces or bytes of values a stream says it has, as the decoder says when it refuses them.
struct DeclaredCount {
    is_faces: bool,
    count: u64,
}

impl DeclaredCount {
    /// `None` where the text says nothing of it: then twice as much is tried.
    fn of_refusal(text: &str) -> Option<Self> {
        let (_, rest) = text.split_once("decodes ")?;
        let (count, rest) = rest.split_once(' ')?;
        Some(Self {
            is_faces: rest.starts_with("faces"),
            count: count.parse().ok()?,
        })
    }

    /// Bytes within which so many are decoded: half of them are for faces, half for values.
    fn bytes_needed(&self) -> u64 {
        let each = if self.is_faces {
            BYTES_PER_FACE
        } else {
            BYTES_PER_VALUE_BYTE
        };
        self.count.saturating_add(1).saturating_mul(2 * each)
    }
}

struct DracoUncompressor<'d, 'a> {
    doc: &'d GltfDocument<'a>,
    edits: JsonEdits<'a>,
    watch: &'d ReadWatch<'d>,
    /// Decoded streams by their view.
    decoded: BTreeMap<usize, Mesh>,
    /// What an accessor has been given: view and attribute of a stream, `None` for its indices.
    filled: BTreeMap<usize, (usize, Option<usize>)>,
    /// New data, and the views over it.
    data: BufferBuilder,
    /// How often what stays names each view of the document; empty when that is unknown.
    uses_left: Vec<usize>,
    /// Views of decoded streams that nothing names any more.
    unused: Vec<usize>,
    /// For each of those the new view that takes its number.
    replaced: Vec<usize>,
}

impl<'a> DracoUncompressor<'_, 'a> {
    fn primitive_text(&self, m: usize, p: usize) -> &'a str {
        let all = list_of(self.doc.item(&self.doc.meshes, m), "primitives");
        all.get(p).copied().unwrap_or("{}")
    }

    /// Counts off that a primitive names its stream, which it will not.
    fn forget_use(&mut self, m: usize, p: usize) {
        let extensions = value_of(self.primitive_text(m, p), "extensions");
        let stream = extensions.and_then(|text| value_of(text, DRACO));
        let read = stream.and_then(|text| serde_json::from_str::<DracoStream>(text).ok());
        if let Some(uses) = read.and_then(|s| self.uses_left.get_mut(s.buffer_view.index())) {
            *uses = uses.saturating_sub(1);
        }
    }

    /// The number of the view that is added next: that of a stream which nothing uses, or one behind all.
    fn next_view(&self) -> usize {
        let waiting = self.unused.get(self.replaced.len());
        waiting
            .copied()
            .unwrap_or(self.doc.views.len() + self.data.view_count() - self.replaced.len())
    }

    fn uncompress_primitive(&mut self, m: usize, p: usize) -> Result<(), Error> {
        let (doc, fault) = (self.doc, self.doc.fault);
        let place = format!("meshes/{m}/primitives/{p}/extensions/{DRACO}");
        let primitive = &doc.meshes.values[m].primitives[p];
        let text = self.primitive_text(m, p);
        let extensions = value_of(text, "extensions").unwrap_or("{}");
        let stream = value_of(extensions, DRACO).unwrap_or("{}");
        let stream: DracoStream =
            serde_json::from_str(stream).map_err(|e| fault.malformed(place.as_str(), e.to_string()))?;
        if !matches!(primitive.mode(), 4 | 5) {
            let problem = format!("mode {}; Draco holds triangles, modes 4 and 5", primitive.mode());
            return Err(fault.malformed(place, problem));
        }
        let view = stream.buffer_view.index();
        self.decode_stream(view, &place)?;
        let Some(mesh) = self.decoded.remove(&view) else {
            return Err(fault.malformed(place, "was not decoded"));
        };
        let filled = self.fill_primitive(primitive, &mesh, &stream, &place);
        self.decoded.insert(view, mesh);
        filled?;
        // The decoded triangles are a list, whatever they were before.
        if primitive.mode() != 4 {
            self.edits.set(text, "mode", "4");
        }
        self.edits.remove_extension(text, DRACO);
        Ok(())
    }

    fn decode_stream(&mut self, view: usize, place: &str) -> Result<(), Error> {
        if self.decoded.contains_key(&view) {
            return Ok(());
        }
        let fault = self.doc.fault;
        if view >= self.doc.views.len() {
            let problem = format!("buffer view {view} does not exist, there are {}", self.doc.views.len());
            return Err(fault.malformed(format!("{place}/bufferView"), problem));
        }
        let mesh = self.decode_within_reserve(view, place)?;
        if self.uses_left.get(view) == Some(&0) && self.doc.views.values[view].compression().is_none() {
            self.unused.push(view);
        }
        self.doc.bytes.reserve(COPIES * 12 * mesh.num_faces() as u64)?;
        self.decoded.insert(view, mesh);
        Ok(())
    }

    /// Decodes a stream within as much memory as is reserved for it, and reserves twice as much for another try where that was too
    /// little: a stream says how many points, faces and values it has as it is decoded.
    fn decode_within_reserve(&self, view: usize, place: &str) -> Result<Mesh, Error> {
        let fault = self.doc.fault;
        let stream = self.doc.view(view)?.len() as u64;
        let mut reserved = stream.saturating_mul(BYTES_PER_BYTE).max(LEAST_BYTES);
        loop {
            self.watch.check()?;
            self.doc.bytes.reserve(reserved)?;
            let limits = DecodeLimits::default()
                .with_max_points(self.watch.vertices)
                .with_max_faces((self.watch.triangles).min(reserved / 2 / BYTES_PER_FACE))
                .with_max_decoded_bytes(reserved / 2 / BYTES_PER_VALUE_BYTE);
            let mut mesh = Mesh::new();
            let mut input = DecoderBuffer::new(self.doc.view(view)?).with_limits(limits);
            let Err(e) = MeshDecoder::new().decode(&mut input, &mut mesh) else {
                return Ok(mesh);
            };
            let problem = format!("the Draco stream cannot be decoded: {e}");
            if e.kind() != ErrorKind::LimitExceeded {
                return Err(fault.malformed(place, problem));
            }
            self.doc.bytes.release(reserved);
            let declared = DeclaredCount::of_refusal(&problem);
            let is_too_large = declared
                .as_ref()
                .is_some_and(|d| d.is_faces && d.count > self.watch.triangles);
            let twice = reserved.checked_mul(2).filter(|_| !is_too_large);
            let Some(twice) = twice else {
                return Err(fault.unsupported(place, problem, "decimate the model"));
            };
            reserved = declared.map_or(0, |d| d.bytes_needed()).max(twice);
        }
    }

    fn fill_primitive(
        &mut self,
        primitive: &MeshPrimitive,
        mesh: &Mesh,
        stream: &DracoStream,
        place: &str,
    ) -> Result<(), Error> {
        let fault = self.doc.fault;
        let view = stream.buffer_view.index();
        let Some(indices) = primitive.indices.map(|i| i.index()) else {
            return Err(fault.malformed(place, "the primitive has no indices, which Draco always gives"));
        };
        if self.is_new(indices, view, None, place)? {
            self.fill_indices(mesh, indices, place)?;
        }
        for (name, id) in &stream.attributes {
            let place = format!("{place}/attributes/{name}");
            let Some(accessor) = primitive.attribute(name) else {
                return Err(fault.malformed(place, "the primitive has no attribute of that name"));
            };
            let id = id.index();
            if !self.is_new(accessor, view, Some(id), &place)? {
                continue;
            }
            let attribute = u32::try_from(id).ok().and_then(|id| mesh.attribute_by_unique_id(id));
            let Some(attribute) = attribute else {
                return Err(fault.malformed(place, format!("the Draco stream has no attribute {id}")));
            };
            let limits = self.fill_attribute(mesh.num_points(), attribute, accessor, &place)?;
            // Positions must have bounds, other attributes need not.
            let text = self.doc.item(&self.doc.accessors, accessor);
            if name == "POSITION" && value_of(text, "min").is_none() {
                self.edits.set(text, "min", &limits.0);
                self.edits.set(text, "max", &limits.1);
            }
        }
        Ok(())
    }

    /// Whether an accessor has been given nothing yet; an error when it has been given something else.
    fn is_new(&mut self, accessor: usize, view: usize, attribute: Option<usize>, place: &str) -> Result<bool, Error> {
        let from = (view, attribute);
        match self.filled.insert(accessor, from) {
            None => Ok(true),
            Some(before) if before == from => Ok(false),
            Some(_) => {
                let problem = format!("accessor {accessor} stands for two different Draco streams or attributes");
                Err(self.doc.fault.malformed(place, problem))
            }
        }
    }

    fn fill_indices(&mut self, mesh: &Mesh, accessor: usize, place: &str) -> Result<(), Error> {
        let points = mesh.num_points();
        let declared = self.doc.accessors.values[accessor].component_type.0;
        // The largest value of a type is the restart mark, which no index may be.
        let component = match declared {
            5121 if points <= 255 => ComponentType::U8,
            5121 | 5123 if points <= 65_535 => ComponentType::U16,
            _ => ComponentType::U32,
        };
        let mut bytes = Vec::with_capacity(mesh.num_faces() * 3 * component.size());
        let (mut least, mut most) = (u32::MAX, 0);
        for index in mesh.faces().iter().flatten().map(|v| v.0) {
            if index as usize >= points {
                let problem = format!("the Draco stream names vertex {index} of {points}");
                return Err(self.doc.fault.malformed(place, problem));
            }
            (least, most) = (least.min(index), most.max(index));
            bytes.extend_from_slice(&index.to_le_bytes()[..component.size()]);
        }
        let code = match component {
            ComponentType::U8 => "5121",
            ComponentType::U16 => "5123",
            _ => "5125",
        };
        let text = self.doc.item(&self.doc.accessors, accessor);
        self.edits.set(text, "componentType", code);
        self.set_accessor(
            accessor,
            mesh.num_faces() * 3,
            &format!("[{least}]"),
            &format!("[{most}]"),
        );
        self.add_view(&bytes, None, INDICES);
        Ok(())
    }

    /// Gives an accessor the values of an attribute, and returns their bounds as JSON.
    fn fill_attribute(
        &mut self,
        points: usize,
        attribute: &PointAttribute,
        accessor: usize,
        place: &str,
    ) -> Result<(String, String), Error> {
        let (doc, fault) = (self.doc, self.doc.fault);
        let described = &doc.accessors.values[accessor];
        let Some(layout) = doc.layout(accessor) else {
            return Err(fault.malformed(
                place,
                format!("accessor {accessor} is of a type that glTF does not know"),
            ));
        };
        if usize::from(attribute.num_components()) != layout.lanes || described.shape.starts_with("MAT") {
            let problem = format!(
                "the Draco stream has {} numbers for each vertex, accessor {accessor} is a {}",
                attribute.num_components(),
                described.shape
            );
            return Err(fault.malformed(place, problem));
        }
        let element = layout.lanes * layout.component.size();
        let stride = element.next_multiple_of(4);
        self.doc
            .bytes
            .reserve((points as u64).saturating_mul(COPIES * stride as u64))?;
        let mut bytes = Vec::with_capacity(points * stride);
        let stored = component_of(attribute.data_type());
        let limits = if layout.component == ComponentType::F32 {
            let values = attribute.read_f32s(points, layout.lanes);
            bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
            bounds(&values, layout.lanes)
        } else if stored == Some(layout.component) {
            for point in 0..points as u32 {
                let at = attribute.mapped_index(PointIndex(point)).0 as usize * attribute.byte_stride().max(0) as usize;
                let data = attribute.buffer().data();
                let Some(value) = at.checked_add(element).and_then(|end| data.get(at..end)) else {
                    return Err(fault.malformed(place, format!("the Draco stream has no value for vertex {point}")));
                };
                bytes.extend_from_slice(value);
                bytes.resize(bytes.len().next_multiple_of(4), 0);
            }
            whole_bounds(&bytes, stride, layout)
        } else {
            let problem = format!("the Draco stream and accessor {accessor} have numbers of different types");
            return Err(fault.malformed(place, problem));
        };
        self.set_accessor(accessor, points, &limits.0, &limits.1);
        self.add_view(&bytes, Some(stride).filter(|_| stride != element), VERTICES);
        Ok(limits)
    }

    /// Lets an accessor stand for the next view.
    fn set_accessor(&mut self, accessor: usize, count: usize, least: &String, most: &String) {
        let text = self.doc.item(&self.doc.accessors, accessor);
        let view = self.next_view();
        self.edits.set(text, "bufferView", view);
        self.edits.set(text, "count", count);
        if value_of(text, "byteOffset").is_some() {
            self.edits.set(text, "byteOffset", "0");
        }
        for (key, limit) in [("min", least), ("max", most)] {
            // Bounds that are there must be those of the decoded numbers.
            if value_of(text, key).is_some() {
                self.edits.set(text, key, limit);
            }
        }
    }

    fn add_view(&mut self, bytes: &[u8], stride: Option<usize>, target: u32) {
        if self.replaced.len() < self.unused.len() {
            self.replaced.push(self.data.view_count());
        }
        self.data.add_strided_view(bytes, stride, Some(target));
    }

    /// The files with all edits made; `none_left` when no primitive has the extension any more.
    fn write_plain_files(mut self, files: &FileSet, none_left: bool) -> Result<FileSet, Error> {
        let doc = self.doc;
        let target = doc.growing_buffer();
        let stored = target.and_then(|i| doc.buffer_bytes(i));
        let stored = stored.map_or(&[][..], |bytes| bytes);
        self.unused.truncate(self.replaced.len());
        let unused = std::mem::take(&mut self.unused);
        let mut bytes = match target {
            Some(buffer) => {
                let cuts = BufferCuts::new(doc, buffer, &unused);
                cuts.move_views(doc, &mut self.edits);
                cuts.kept_bytes(stored)
            }
            None => Vec::new(),
        };
        let buffer = target.unwrap_or(doc.buffers.len());
        let views = self
            .data
            .append_bytes(&mut bytes, buffer, &format!("buffer {buffer}"), doc.fault)?;
        let mut added = Vec::new();
        for (k, text) in views.into_iter().enumerate() {
            match self.replaced.binary_search(&k) {
                Ok(at) => self.edits.replace(doc.item(&doc.views, unused[at]), text),
                Err(_) => added.push(text),
            }
        }
        self.edits
            .push_or_set(doc.text, "bufferViews", doc.array(&doc.views), &added);
        let mut plain = files.clone();
        let mut bin = doc.chunk().map(<[u8]>::to_vec);
        match target {
            Some(i) => {
                let item = doc.item(&doc.buffers, i);
                self.edits.set(item, "byteLength", bytes.len());
                match doc.origins().nth(i) {
                    Some(BufferOrigin::Bin) => bin = Some(bytes),
                    Some(BufferOrigin::Companion(name)) => drop(plain.companions.insert(name.clone(), bytes.into())),
                    _ => self.edits.set(item, "uri", quoted(&buffers::embed(&bytes))),
                }
            }
            None => {
                let item = embedded_buffer_text(&bytes);
                self.edits
                    .push_or_set(doc.text, "buffers", doc.array(&doc.buffers), &[item]);
            }
        }
        let mut text = self.edits.apply();
        if none_left {
            for key in ["extensionsUsed", "extensionsRequired"] {
                text = without_draco(text, key);
            }
        }
        plain.main = if doc.fault.0 == GLB_FORMAT {
            doc.join(text.trim_end(), bin.as_deref(), doc.fault)?.into()
        } else {
            text.into_bytes().into()
        };
        Ok(plain)
    }
}

/// The document without the extension in one of its lists of extensions; an empty list goes.
fn without_draco(text: String, key: &str) -> String {
    let Some(array) = value_of(&text, key) else {
        return text;
    };
    let list = list_of(&text, key);
    let kept: Vec<&str> = list.iter().copied().filter(|name| *name != quoted(DRACO)).collect();
    if kept.len() == list.len() {
        return text;
    }
    let mut edits = JsonEdits::new(&text);
    if kept.is_empty() {
        edits.remove(&text, key);
    } else {
        edits.replace(array, json_array(kept));
    }
    edits.apply()
}

fn component_of(kind: DataType) -> Option<ComponentType> {
    Some(match kind {
        DataType::Int8 => ComponentType::I8,
        DataType::Uint8 => ComponentType::U8,
        DataType::Int16 => ComponentType::I16,
        DataType::Uint16 => ComponentType::U16,
        DataType::Uint32 => ComponentType::U32,
        DataType::Float32 => ComponentType::F32,
        _ => return None,
    })
}

/// The least and the largest whole number of each lane as JSON.
fn whole_bounds(bytes: &[u8], stride: usize, layout: AccessorLayout) -> (String, String) {
    let mut lanes = vec![(i64::MAX, i64::MIN); layout.lanes];
    let size = layout.component.size();
    for element in bytes.chunks_exact(stride.max(1)) {
        for (lane, number) in lanes.iter_mut().zip(element.chunks_exact(size)) {
            let unsigned = number.iter().rev().fold(0i64, |v, b| v << 8 | i64::from(*b));
            let bits = 8 * size as u32;
            let signed = matches!(layout.component, ComponentType::I8 | ComponentType::I16);
            let value = if signed && unsigned >= 1 << (bits - 1) {
                unsigned - (1 << bits)
            } else {
                unsigned
            };
            *lane = (lane.0.min(value), lane.1.max(value));
        }
    }
    (
        json_array(lanes.iter().map(|lane| lane.0)),
        json_array(lanes.iter().map(|lane| lane.1)),
    )
}

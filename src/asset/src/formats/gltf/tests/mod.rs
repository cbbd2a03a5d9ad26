//! Small documents made by hand, read and written through the module's own interface.

mod looks;
mod reading;
mod rigs;
mod skins;
mod writing;

use super::builder::float_bytes;
use super::container::{self, GltfFault};
use crate::{Error, FileSet, Following, Format, Limits, Model, WrittenFiles};
use glam::{DVec3, Vec3};
use serde_json::Value;

const GLB_FAULT: GltfFault = GltfFault(Format::GLB);

/// A document in the making: one buffer, and what lies in it.
#[derive(Default)]
struct DocumentDraft {
    bin: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl DocumentDraft {
    fn view(&mut self, bytes: &[u8], more: &str) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let (offset, length) = (self.bin.len(), bytes.len());
        self.views.push(format!(
            r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{length}{more}}}"#
        ));
        self.bin.extend_from_slice(bytes);
        self.views.len() - 1
    }

    /// `more` starts with a comma.
    fn accessor(&mut self, view: usize, component: u32, count: usize, shape: &str, more: &str) -> usize {
        self.accessors.push(format!(
            r#"{{"bufferView":{view},"componentType":{component},"count":{count},"type":"{shape}"{more}}}"#
        ));
        self.accessors.len() - 1
    }

    fn points(&mut self, points: &[[f32; 3]]) -> usize {
        self.elements(points, "VEC3", "")
    }

    /// Floats with a view of their own.
    fn elements<const N: usize>(&mut self, values: &[[f32; N]], shape: &str, more: &str) -> usize {
        let view = self.view(&float_bytes(values.as_flattened()), "");
        self.accessor(view, 5126, values.len(), shape, more)
    }

    fn indices(&mut self, indices: &[u16]) -> usize {
        let bytes: Vec<u8> = indices.iter().flat_map(|i| i.to_le_bytes()).collect();
        let view = self.view(&bytes, "");
        self.accessor(view, 5123, indices.len(), "SCALAR", "")
    }

    /// The JSON, with `body` as the first members after the asset.
    fn json(&self, body: &str, buffer: &str) -> String {
        format!(
            r#"{{"asset":{{"version":"2.0"}},{body},"accessors":[{}],"bufferViews":[{}],"buffers":[{{"byteLength":{}{buffer}}}]}}"#,
            self.accessors.join(","),
            self.views.join(","),
            self.bin.len()
        )
    }

    /// A GLB; the nodes of `body` are placed by one scene of its own unless it has one.
    fn glb(&self, body: &str) -> FileSet {
        let glb = container::join(&self.json(body, ""), Some(&self.bin), &[], GLB_FAULT);
        FileSet::single("draft.glb", glb.expect("small"))
    }
}

/// A GLB with some texts of its JSON replaced.
fn with_replaced(files: &FileSet, texts: &[(&str, &str)]) -> FileSet {
    let json = texts
        .iter()
        .fold(text(&files.main), |json, (from, to)| json.replace(from, to));
    let glb = container::join(&json, Some(&bin(&files.main)), &[], GLB_FAULT);
    FileSet::single("replaced.glb", glb.expect("small"))
}

fn bytes_of(points: &[[f32; 3]]) -> Vec<u8> {
    float_bytes(points.as_flattened())
}

/// A flat square of two triangles, and its indices.
const SQUARE: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
const CORNERS: [u16; 6] = [0, 1, 2, 0, 2, 3];
const UP: [[f32; 3]; 4] = [[0.0, 0.0, 1.0]; 4];

/// A primitive of accessors 0 and 1.
const PLAIN: &str = r#"{"attributes":{"POSITION":0},"indices":1}"#;

/// The square as accessor 0, its indices as accessor 1.
fn square_draft() -> DocumentDraft {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.indices(&CORNERS);
    draft
}

/// One scene with one node with one mesh with one primitive.
fn one(primitive: &str) -> String {
    format!(r#""scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{primitive}]}}]"#)
}

fn format_of(files: &FileSet) -> Format {
    if files.main.starts_with(b"glTF") {
        Format::GLB
    } else {
        Format::GLTF
    }
}

fn read(files: &FileSet) -> Result<Model, Error> {
    Model::read(files.clone(), Some(format_of(files)), &Limits::default())
}

fn open(files: &FileSet) -> Model {
    read(files).expect("readable")
}

fn refusal(files: &FileSet) -> String {
    read(files).expect_err("refused").to_string()
}

/// Moves the vertices by `f` and writes in the same format.
fn moved(files: &FileSet, f: impl Fn(usize, DVec3) -> DVec3) -> WrittenFiles {
    try_moved(files, f).expect("writable")
}

fn try_moved(files: &FileSet, f: impl Fn(usize, DVec3) -> DVec3) -> Result<WrittenFiles, Error> {
    let model = open(files);
    model.write(&places_of(&model, f), format_of(files))
}

fn places_of(model: &Model, f: impl Fn(usize, DVec3) -> DVec3) -> Vec<DVec3> {
    model.positions.iter().enumerate().map(|(i, &p)| f(i, p)).collect()
}

/// Moves the vertices by `f` and writes a GLB in which so much follows.
fn followed(files: &FileSet, following: Following, f: impl Fn(usize, DVec3) -> DVec3) -> WrittenFiles {
    let model = open(files);
    let written = model.write_following(&places_of(&model, f), Format::GLB, following);
    written.expect("writable")
}

fn again(written: &WrittenFiles) -> FileSet {
    written.clone().into_files("again")
}

/// The JSON of a file, as text.
fn text(main: &[u8]) -> String {
    let is_glb = main.starts_with(b"glTF");
    let parts = is_glb.then(|| container::split(main, GLB_FAULT).expect("valid"));
    let json = parts.map_or(main, |parts| parts.json.trim_ascii_end());
    String::from_utf8(json.to_vec()).expect("text")
}

fn json_of(main: &[u8]) -> Value {
    serde_json::from_str(&text(main)).expect("JSON")
}

fn json(written: &WrittenFiles) -> Value {
    json_of(&written.main)
}

/// The numbers of a JSON list.
fn numbers(list: &Value) -> Vec<f64> {
    list.as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_f64)
        .collect()
}

fn index(value: &Value) -> usize {
    value.as_u64().expect("a number") as usize
}

/// The BIN chunk of a GLB.
fn bin(main: &[u8]) -> Vec<u8> {
    let parts = container::split(main, GLB_FAULT).expect("valid");
    parts.bin.expect("a BIN chunk").to_vec()
}

/// How many items a section of a file has.
fn count(written: &WrittenFiles, section: &str) -> usize {
    json(written)[section].as_array().map_or(0, Vec::len)
}

/// The floats of an accessor that has a view of its own.
fn floats_of(written: &WrittenFiles, accessor: usize) -> Vec<f32> {
    let json = json(written);
    let view = &json["bufferViews"][index(&json["accessors"][accessor]["bufferView"])];
    let number = |key: &str| view[key].as_u64().unwrap_or(0) as usize;
    floats_in(&bin(&written.main)[number("byteOffset")..][..number("byteLength")])
}

fn floats_in(bytes: &[u8]) -> Vec<f32> {
    let floats = bytes.as_chunks::<4>().0.iter();
    floats.map(|b| f32::from_le_bytes(*b)).collect()
}

fn vectors(floats: &[f32]) -> Vec<Vec3> {
    floats.as_chunks::<3>().0.iter().map(|v| Vec3::from_array(*v)).collect()
}

//! Small files that say they are large: what they unpack to is in their headers, or in what they name over and over.

use flate2::{Compression, write::ZlibEncoder};
use serde_json::json;
use std::io::Write as _;

/// A binary FBX with one mesh whose `count` coordinates are zeros in one compressed array.
pub fn fbx_of_zeros(count: usize) -> Vec<u8> {
    let text = |text: &[u8]| [b"S", &(text.len() as u32).to_le_bytes()[..], text].concat();
    let number = |x: i64| [b"L", &x.to_le_bytes()[..]].concat();
    let array = |kind: &[u8], items: usize, raw: &[u8]| {
        let mut packed = ZlibEncoder::new(Vec::new(), Compression::best());
        packed.write_all(raw).expect("packs");
        let packed = packed.finish().expect("packs");
        let header = [items as u32, 1, packed.len() as u32].map(u32::to_le_bytes);
        [kind, header.as_flattened(), &packed].concat()
    };
    let corners: Vec<u8> = [0i32, 1, -3].into_iter().flat_map(i32::to_le_bytes).collect();
    let geometry = FbxNode {
        name: "Geometry",
        values: vec![number(1), text(b"g\0\x01Geometry"), text(b"Mesh")],
        children: vec![
            FbxNode::leaf("Vertices", vec![array(b"d", count, &vec![0; 8 * count])]),
            FbxNode::leaf("PolygonVertexIndex", vec![array(b"i", 3, &corners)]),
        ],
    };
    let model = FbxNode {
        name: "Model",
        values: vec![number(2), text(b"m\0\x01Model"), text(b"Mesh")],
        children: vec![FbxNode::leaf(
            "Version",
            vec![[b"I", &232i32.to_le_bytes()[..]].concat()],
        )],
    };
    let link = |from: i64, to: i64| FbxNode::leaf("C", vec![text(b"OO"), number(from), number(to)]);
    let mut file = [b"Kaydara FBX Binary  \0\x1a\0", &7400u32.to_le_bytes()[..]].concat();
    let objects = FbxNode::group("Objects", vec![geometry, model]);
    let connections = FbxNode::group("Connections", vec![link(1, 2), link(2, 0)]);
    for node in [objects, connections] {
        node.write(&mut file);
    }
    file.extend([0; 173]);
    file
}

/// A node of a binary FBX.
struct FbxNode {
    name: &'static str,
    values: Vec<Vec<u8>>,
    children: Vec<FbxNode>,
}

impl FbxNode {
    fn leaf(name: &'static str, values: Vec<Vec<u8>>) -> Self {
        Self {
            name,
            values,
            children: Vec::new(),
        }
    }

    fn group(name: &'static str, children: Vec<Self>) -> Self {
        Self {
            name,
            values: Vec::new(),
            children,
        }
    }

    fn write(&self, file: &mut Vec<u8>) {
        let start = file.len();
        let values = self.values.concat();
        let head = [0, self.values.len() as u32, values.len() as u32].map(u32::to_le_bytes);
        file.extend(head.as_flattened());
        file.push(self.name.len() as u8);
        file.extend(self.name.as_bytes());
        file.extend(values);
        self.children.iter().for_each(|child| child.write(file));
        if !self.children.is_empty() {
            file.extend([0; 13]);
        }
        let end = (file.len() as u32).to_le_bytes();
        file[start..start + 4].copy_from_slice(&end);
    }
}

/// A GLB of positions and normals of `count` vertices, all zero, packed by `EXT_meshopt_compression`.
pub fn meshopt_of_zeros(count: usize) -> Vec<u8> {
    meshopt_of(&vec![[0.0; 3]; count])
}

/// A GLB of triangles, three corners for each, packed by `EXT_meshopt_compression`; normals have the numbers of positions.
pub fn meshopt_of(corners: &[[f32; 3]]) -> Vec<u8> {
    const NAME: &str = "EXT_meshopt_compression";
    let count = corners.len();
    let mut packed = meshopt::encode_vertex_buffer(corners).expect("packs");
    let length = packed.len();
    packed.resize(length.next_multiple_of(4), 0);
    let view = |k: usize| {
        let stream = json!({"buffer": 0, "byteLength": length, "byteStride": 12, "count": count, "mode": "ATTRIBUTES"});
        json!({"buffer": 1, "byteOffset": 12 * k * count, "byteLength": 12 * count, "byteStride": 12, "extensions": {NAME: stream}})
    };
    let bound = |k: usize, pick: fn(f32, f32) -> f32| corners.iter().map(|corner| corner[k]).fold(corners[0][k], pick);
    let (least, most) = (
        [0, 1, 2].map(|k| bound(k, f32::min)),
        [0, 1, 2].map(|k| bound(k, f32::max)),
    );
    let accessor = |k: usize| json!({"bufferView": k, "componentType": 5126, "count": count, "type": "VEC3", "min": least, "max": most});
    let document = json!({
        "asset": {"version": "2.0"}, "extensionsUsed": [NAME], "extensionsRequired": [NAME],
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}}]}],
        "buffers": [{"byteLength": packed.len()}, {"byteLength": 24 * count, "extensions": {NAME: {"fallback": true}}}],
        "bufferViews": [view(0), view(1)],
        "accessors": [accessor(0), accessor(1)],
    });
    glb(&document.to_string(), &packed)
}

/// A glTF with one primitive in a Draco stream that says it has so many faces.
pub fn draco_of_faces(faces: u32) -> Vec<u8> {
    // Version 2.2, a mesh, sequential, no metadata; faces, points and how the corners are coded.
    let mut stream = b"DRACO\x02\x02\x01\x00\x00\x00".to_vec();
    for mut number in [faces, faces, 0] {
        while number >= 0x80 {
            stream.push(number as u8 | 0x80);
            number >>= 7;
        }
        stream.push(number as u8);
    }
    // A stream must have a bit for each corner to be believed.
    stream.resize(64 + faces as usize / 2, 0);
    const NAME: &str = "KHR_draco_mesh_compression";
    let extension = json!({"bufferView": 0, "attributes": {"POSITION": 0}});
    let document = json!({
        "asset": {"version": "2.0"}, "extensionsUsed": [NAME], "extensionsRequired": [NAME],
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "extensions": {NAME: extension}}]}],
        "buffers": [{"byteLength": stream.len()}],
        "bufferViews": [{"buffer": 0, "byteLength": stream.len()}],
        "accessors": [
            {"componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]},
            {"componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
    });
    glb(&document.to_string(), &stream)
}

/// A GLB whose scene has so many nodes that all place one mesh of so many vertices.
pub fn placed_often(nodes: usize, vertices: usize) -> Vec<u8> {
    let positions: Vec<u8> = (0..3 * vertices)
        .flat_map(|i| ((i % 97) as f32).to_le_bytes())
        .collect();
    let all: Vec<usize> = (0..nodes).collect();
    let document = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": all}],
        "nodes": vec![json!({"mesh": 0}); nodes],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": positions.len()}],
        "bufferViews": [{"buffer": 0, "byteLength": positions.len()}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3", "min": [0, 0, 0], "max": [96, 96, 96]}],
    });
    glb(&document.to_string(), &positions)
}

/// A glTF with a buffer of so many zeros in a data URI, which nothing names.
pub fn embedded_zeros(bytes: usize) -> Vec<u8> {
    let uri = format!("data:application/octet-stream;base64,{}", "AAAA".repeat(bytes / 3));
    json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": bytes / 3 * 3, "uri": uri}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [0, 0, 0]}],
    })
    .to_string()
    .into_bytes()
}

fn glb(document: &str, bin: &[u8]) -> Vec<u8> {
    let mut text = document.as_bytes().to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bin = bin.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut file = b"glTF".to_vec();
    let numbers = [2, (28 + text.len() + bin.len()) as u32, text.len() as u32];
    file.extend(numbers.map(u32::to_le_bytes).as_flattened());
    file.extend(b"JSON");
    file.extend(text);
    file.extend((bin.len() as u32).to_le_bytes());
    file.extend(b"BIN\0");
    file.extend(bin);
    file
}

//! What stays of the first base's own data.
//!
//! Accessors that only edited primitives used are dead weight, and nothing else is gained by keeping them. They can be
//! dropped, and the rest renumbered and packed, when every extension of the file is known not to name accessors, views
//! or meshes in places that are not looked at here. Else the numbers stay as they are and new data is only added.

use super::super::accessors::{AccessorLayout, ComponentType};
use super::super::buffers::BufferBytes;
use super::super::document::GltfDocument;
use super::super::schema::GltfMesh;
use super::super::text::{list_of, parse_index, with_member, without_extensions};
use super::frame::EditedMeshes;
use super::places::{self, DRACO, References};
use crate::asset::Error;
use std::collections::{BTreeMap, BTreeSet};

/// Beginnings of the names of extensions whose every reference to an accessor or view is looked at.
const KNOWN: [&str; 18] = [
    "KHR_materials_",
    "EXT_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_dds",
    "MSFT_packing_",
    "KHR_lights_",
    "EXT_lights_ies",
    "KHR_mesh_quantization",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_draco_mesh_compression",
    "EXT_mesh_gpu_instancing",
    "KHR_node_visibility",
    "KHR_xmp",
    "MSFT_lod",
    "CESIUM_RTC",
    "FB_ngon_encoding",
];

/// Names of the extensions that compress views.
const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// What is kept, packed into one buffer.
pub(super) struct KeptData {
    pub(super) bytes: Vec<u8>,
    /// Texts of the kept views and accessors, renumbered.
    pub(super) views: Vec<String>,
    pub(super) accessors: Vec<String>,
    /// New numbers by old ones.
    pub(super) view_numbers: BTreeMap<usize, usize>,
    pub(super) accessor_numbers: BTreeMap<usize, usize>,
}

/// Whether unused data may be dropped.
pub(super) fn may_drop(doc: &GltfDocument<'_>) -> bool {
    let mut all = doc.extensions_used.iter().chain(doc.extensions_required);
    all.all(|extension| KNOWN.iter().any(|known| extension.starts_with(known)))
}

/// Packs what the frame, skins, animations, nodes and images still use; `None` when some of it cannot be read.
pub(super) fn pack_kept_data(
    doc: &GltfDocument<'_>,
    buffers: &mut BufferBytes,
    frame: &EditedMeshes,
) -> Result<Option<KeptData>, Error> {
    let images = list_of(doc.text, "images");
    let places = (frame.meshes.iter().flatten().map(|mesh| places::of_mesh(mesh)))
        .chain(doc.skins.iter().map(|skin| places::of_skin(skin)))
        .chain(
            frame
                .animations
                .iter()
                .flatten()
                .map(|animation| places::of_animation(animation)),
        )
        .chain(doc.nodes.items.iter().map(|node| places::of_node(node)))
        .chain(images.iter().map(|image| places::of_image(image)));
    let (mut accessors, mut views) = (BTreeSet::new(), BTreeSet::new());
    for References { accessors: a, views: v } in places {
        accessors.extend(
            a.into_iter()
                .filter_map(parse_index)
                .filter(|&a| a < doc.accessors.len()),
        );
        views.extend(v.into_iter().filter_map(parse_index));
    }
    for &accessor in &accessors {
        let named = places::of_accessor(doc.accessors.items[accessor]);
        views.extend(named.views.into_iter().filter_map(parse_index));
    }
    if buffers.decode_for(doc, &accessors).is_err() {
        return Ok(None);
    }
    let mut kept = KeptData {
        bytes: Vec::new(),
        views: Vec::new(),
        accessors: Vec::new(),
        view_numbers: BTreeMap::new(),
        accessor_numbers: accessors.iter().enumerate().map(|(new, &old)| (old, new)).collect(),
    };
    let mut stored: BTreeMap<(usize, u64, u64), usize> = BTreeMap::new();
    for old in views {
        let Ok(bytes) = buffers.view(doc, old) else {
            return Ok(None);
        };
        let view = &doc.views.values[old];
        let mut place = |bytes: &[u8]| {
            kept.bytes.resize(kept.bytes.len().next_multiple_of(4), 0);
            let start = kept.bytes.len();
            kept.bytes.extend_from_slice(bytes);
            start
        };
        let start = if view.compression().is_some() {
            place(bytes)
        } else {
            let key = (view.buffer.index(), view.offset(), view.byte_length.0);
            *stored.entry(key).or_insert_with(|| place(bytes))
        };
        let text = without_extensions(doc.views.items[old], &MESHOPT);
        let text = with_member(&text, "buffer", "0");
        kept.view_numbers.insert(old, kept.views.len());
        kept.views.push(with_member(&text, "byteOffset", start));
    }
    let renumber = |text| {
        places::renumber_references(
            text,
            places::of_accessor,
            |_| None,
            |view| kept.view_numbers.get(&view).copied(),
        )
    };
    kept.accessors = accessors
        .iter()
        .map(|&old| renumber(doc.accessors.items[old]))
        .collect();
    Ok(Some(kept))
}

/// Which extensions are no longer used: compression, when everything is repacked, and quantisation, when every
/// attribute has a type of the core format.
pub(super) fn unneeded_extensions(doc: &GltfDocument<'_>, meshes: &[Option<String>]) -> Vec<&'static str> {
    let mut unneeded = MESHOPT.to_vec();
    let parsed: Vec<GltfMesh> = meshes
        .iter()
        .flatten()
        .filter_map(|text| serde_json::from_str(text).ok())
        .collect();
    let primitives = || parsed.iter().flat_map(|mesh| &mesh.primitives);
    if !primitives().any(|p| p.has_draco()) {
        unneeded.push(DRACO);
    }
    let is_core = |name: &str, accessor: usize, of_target: bool| {
        let Some(accessor) = doc.accessors.get(accessor) else {
            return true; // a new one
        };
        let component = AccessorLayout::of(accessor, doc.views.values).map(|l| l.component);
        match name {
            "POSITION" | "NORMAL" | "TANGENT" => component == Some(ComponentType::F32),
            _ if name.starts_with("TEXCOORD_") => {
                let unsigned = matches!(component, Some(ComponentType::U8 | ComponentType::U16)) && accessor.normalized;
                component == Some(ComponentType::F32) || (unsigned || of_target)
            }
            _ => true,
        }
    };
    let all_core = primitives().all(|p| {
        let own = p.attributes.iter().all(|(name, a)| is_core(name, a.index(), false));
        own && p
            .targets
            .iter()
            .flatten()
            .all(|(name, a)| is_core(name, a.index(), true))
    });
    if all_core {
        unneeded.push("KHR_mesh_quantization");
    }
    unneeded
}

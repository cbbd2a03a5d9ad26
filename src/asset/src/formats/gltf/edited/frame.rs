//! The first base's own document: its meshes with edited primitives, and the nodes that draw them.
//!
//! What stays of the first base's own data.
//!
//! Accessors that only edited primitives used are dead weight, and nothing else is gained by keeping them. They can be
//! dropped, and the rest renumbered and packed, when every extension of the file is known not to name accessors, views
//! or meshes in places that are not looked at here. Else the numbers stay as they are and new data is only added.

use super::super::accessors::ComponentType;
use super::super::document::GltfDocument;
use super::super::extensions::{MANIFOLD, NGONS};
use super::super::read::GltfNotes;
use super::super::references::{IN_ACCESSOR, IN_ANIMATION, IN_IMAGE, IN_MESH, IN_NODE, IN_SKIN};
use super::super::schema::{DRACO, GltfMesh, MESHOPT};
use super::super::text::{
    WEIGHTS, channel_target, json_array, json_object, list_of, value_of, with_member, without_extensions, without_keys,
};
use super::primitives::{MadePrimitive, MeshSpace, PrimitiveMaker};
use crate::Error;
use crate::edited::PrimitiveRun;
use std::collections::{BTreeMap, BTreeSet};

/// Meshes, and what changes about nodes and animations. Accessors are numbered virtually: those of the file as there,
/// new ones on from their number.
pub(super) struct EditedMeshes {
    /// By number: the file's meshes, `None` for those that nothing draws any more, and new ones.
    pub(super) meshes: Vec<Option<String>>,
    /// Texts of nodes that change.
    pub(super) nodes: BTreeMap<usize, String>,
    /// Animations; `None` for those of which nothing is left.
    pub(super) animations: Vec<Option<String>>,
}

/// What one node is to draw.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
enum MeshVersion {
    AsStored,
    Gone,
    Text(String),
}

/// Bytes of JSON that meshes may take: a mesh is described once in a file, but may be placed any number of times.
const MOST_COPIED: usize = 512 << 20;

/// Remakes the meshes. `runs` are those of the first base.
pub(super) fn remake_meshes<'a>(
    maker: &mut PrimitiveMaker<'a, '_>,
    notes: &GltfNotes,
    runs: &[&'a PrimitiveRun],
) -> Result<EditedMeshes, Error> {
    let doc = maker.doc;
    let mut runs_of: BTreeMap<usize, Vec<&PrimitiveRun>> = BTreeMap::new();
    for run in runs.iter().filter(|run| maker.edited.is_drawn(run)) {
        runs_of.entry(run.primitive as usize).or_default().push(run);
    }
    let mut rows_of: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, row) in notes.rows.iter().enumerate() {
        rows_of.entry(row.node).or_default().push(i);
    }
    let mut versions: BTreeMap<usize, Vec<(usize, MeshVersion)>> = BTreeMap::new();
    let mut copied = 0;
    for &node in &notes.placed {
        let Some(mesh) = doc.nodes.values[node].mesh.map(|m| m.index()) else {
            continue;
        };
        let rows = rows_of.get(&node).map_or(&[][..], Vec::as_slice);
        let version = version_of_mesh(maker, notes, mesh, rows, &runs_of)?;
        if let MeshVersion::Text(text) = &version {
            copied += text.len();
        }
        if copied > MOST_COPIED {
            let problem = format!("the meshes would need {copied} bytes of JSON, at most {MOST_COPIED} are written");
            return Err(maker.fault.unwritable(problem));
        }
        versions.entry(mesh).or_default().push((node, version));
    }
    let mut outside = vec![false; doc.meshes.len()];
    for (i, node) in doc.nodes.values.iter().enumerate() {
        if let Some(mesh) = node.mesh.filter(|_| notes.placed.binary_search(&i).is_err()) {
            outside[mesh.index()] = true;
        }
    }
    let mut frame = EditedMeshes {
        meshes: doc.items(&doc.meshes).map(|text| Some(text.to_owned())).collect(),
        nodes: BTreeMap::new(),
        animations: Vec::new(),
    };
    for (mesh, nodes) in versions {
        frame.share_meshes(doc, mesh, nodes, outside[mesh]);
    }
    let gone = |node: usize| {
        frame
            .nodes
            .get(&node)
            .is_some_and(|text| value_of(text, "mesh").is_none())
    };
    frame.animations = doc
        .items(&doc.animations)
        .map(|text| animation_without(text, &gone))
        .collect();
    Ok(frame)
}

fn version_of_mesh<'a>(
    maker: &mut PrimitiveMaker<'a, '_>,
    notes: &GltfNotes,
    mesh: usize,
    rows: &[usize],
    runs_of: &BTreeMap<usize, Vec<&'a PrimitiveRun>>,
) -> Result<MeshVersion, Error> {
    let text = maker.doc.item(&maker.doc.meshes, mesh);
    let stored = list_of(text, "primitives");
    let mut primitives = Vec::with_capacity(stored.len());
    let (mut as_stored, mut has_other_triangles) = (true, false);
    for (p, &old) in stored.iter().enumerate() {
        let Some(&row) = rows.iter().find(|&&row| notes.rows[row].primitive == p) else {
            primitives.push(old.to_owned());
            continue;
        };
        let runs = runs_of.get(&row).map_or(&[][..], Vec::as_slice);
        as_stored &= runs.len() == 1;
        has_other_triangles |= runs.len() != 1;
        for &run in runs {
            let row = &notes.rows[row];
            match maker.make_primitive(run, row, MeshSpace::OfRow)? {
                None => primitives.push(old.to_owned()),
                Some(made) => {
                    as_stored = false;
                    has_other_triangles |= made.indices.is_some();
                    let mut text = primitive_text(maker, run, old, made)?;
                    if let Some(cap) = maker.edited.cap_number(run) {
                        let stored = list_of(maker.doc.text, "materials").len();
                        text = without_extensions(&text, &["KHR_materials_variants"]);
                        text = with_member(&text, "material", stored + cap);
                    }
                    primitives.push(text);
                }
            }
        }
    }
    Ok(if as_stored {
        MeshVersion::AsStored
    } else if primitives.is_empty() {
        MeshVersion::Gone
    } else {
        let text = match has_other_triangles {
            true => maker.without_extension(text, MANIFOLD),
            false => text.to_owned(),
        };
        MeshVersion::Text(with_member(&text, "primitives", json_array(&primitives)))
    })
}

/// A stored primitive with other accessors.
fn primitive_text(
    maker: &mut PrimitiveMaker<'_, '_>,
    run: &PrimitiveRun,
    stored: &str,
    mut made: MadePrimitive,
) -> Result<String, Error> {
    let mut text = without_extensions(stored, &[DRACO]);
    if let Some(indices) = made.indices {
        text = maker.without_extension(&text, NGONS);
        text = maker.with_outline(run, &text)?;
        text = maker.with_feature_numbers(run, &text, &mut made.attributes);
        text = with_member(&text, "indices", indices);
        if value_of(&text, "mode").is_some() {
            text = with_member(&text, "mode", made.mode.unwrap_or(4));
        }
    }
    if !made.targets.is_empty() {
        let targets = made.targets.iter().map(json_object);
        text = with_member(&text, "targets", json_array(targets));
    }
    Ok(with_member(&text, "attributes", json_object(&made.attributes)))
}

impl EditedMeshes {
    /// Gives the nodes of one mesh meshes to draw; equal ones share theirs. `outside`: nodes outside the scene draw the
    /// mesh too, as it is stored.
    fn share_meshes(&mut self, doc: &GltfDocument<'_>, mesh: usize, nodes: Vec<(usize, MeshVersion)>, outside: bool) {
        let mut known: BTreeMap<MeshVersion, usize> = BTreeMap::new();
        let stays = outside || nodes.iter().any(|(_, version)| *version == MeshVersion::AsStored);
        if stays {
            known.insert(MeshVersion::AsStored, mesh);
        } else {
            self.meshes[mesh] = None;
        }
        for (node, version) in nodes {
            if version == MeshVersion::Gone {
                let text = without_keys(doc.item(&doc.nodes, node), &["mesh", "skin", "weights"]);
                self.nodes.insert(node, text);
                continue;
            }
            let at = match known.get(&version) {
                Some(&at) => at,
                None => {
                    let MeshVersion::Text(text) = &version else { continue };
                    let at = if self.meshes[mesh].is_none() {
                        self.meshes[mesh] = Some(text.clone());
                        mesh
                    } else {
                        self.meshes.push(Some(text.clone()));
                        self.meshes.len() - 1
                    };
                    known.insert(version, at);
                    at
                }
            };
            if at != mesh {
                self.nodes
                    .insert(node, with_member(doc.item(&doc.nodes, node), "mesh", at));
            }
        }
    }
}

/// An animation without what moves the morph targets of nodes that draw nothing any more.
fn animation_without(text: &str, gone: &impl Fn(usize) -> bool) -> Option<String> {
    let channels = list_of(text, "channels");
    let is_lost = |channel: &str| channel_target(channel).is_some_and(|(node, path)| path == WEIGHTS && gone(node));
    let left: Vec<&str> = channels.iter().copied().filter(|c| !is_lost(c)).collect();
    if left.len() == channels.len() {
        return Some(text.to_owned());
    }
    if left.is_empty() {
        return None;
    }
    Some(with_member(text, "channels", json_array(&left)))
}

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

/// What is kept of the data of a document.
#[derive(Default)]
pub(super) struct KeptData {
    /// Whether it is what is used alone, packed into one buffer; else it is all of it, where it was.
    pub(super) is_packed: bool,
    /// What the buffer holds that new data is added to.
    pub(super) bytes: Vec<u8>,
    /// Texts of the kept views and accessors, renumbered.
    pub(super) views: Vec<String>,
    pub(super) accessors: Vec<String>,
    /// New numbers by old ones, of packed data.
    pub(super) view_numbers: BTreeMap<usize, usize>,
    accessor_numbers: BTreeMap<usize, usize>,
}

impl KeptData {
    /// What the frame, skins, animations, nodes and images still use where that can be said and read, else all of it.
    pub(super) fn of(doc: &GltfDocument<'_>, frame: &EditedMeshes) -> Self {
        let packed = may_drop(doc).then(|| pack_kept_data(doc, frame)).flatten();
        packed.unwrap_or_else(|| {
            let stored = doc.growing_buffer().and_then(|i| doc.buffer_bytes(i));
            Self {
                bytes: stored.map(|b| b.to_vec()).unwrap_or_default(),
                views: doc.items(&doc.views).map(str::to_owned).collect(),
                accessors: doc.items(&doc.accessors).map(str::to_owned).collect(),
                ..Self::default()
            }
        })
    }

    /// The new number of an accessor, those from `old` on being new ones; `None` where it keeps its number.
    pub(super) fn accessor_number(&self, accessor: usize, old: usize) -> Option<usize> {
        match accessor.checked_sub(old) {
            Some(fresh) => self.is_packed.then(|| self.accessor_numbers.len() + fresh),
            None => self.accessor_numbers.get(&accessor).copied(),
        }
    }
}

/// Whether unused data may be dropped.
fn may_drop(doc: &GltfDocument<'_>) -> bool {
    let mut all = doc.extensions_used.iter().chain(&doc.extensions_required);
    all.all(|extension| KNOWN.iter().any(|known| extension.starts_with(known)))
}

/// Packs what the frame, skins, animations, nodes and images still use; `None` when some of it cannot be read.
fn pack_kept_data(doc: &GltfDocument<'_>, frame: &EditedMeshes) -> Option<KeptData> {
    let (mut accessors, mut views) = (BTreeSet::new(), BTreeSet::new());
    let meshes = frame.meshes.iter().flatten().map(|text| (text.as_str(), IN_MESH));
    let animations = frame.animations.iter().flatten();
    let animations = animations.map(|text| (text.as_str(), IN_ANIMATION));
    let skins = doc.items(&doc.skins).map(|text| (text, IN_SKIN));
    let nodes = doc.items(&doc.nodes).map(|text| (text, IN_NODE));
    let images = list_of(doc.text, "images").into_iter().map(|text| (text, IN_IMAGE));
    let items = meshes.chain(animations).chain(skins).chain(nodes).chain(images);
    for (text, places) in items {
        let stored = places.accessors(text).into_iter();
        accessors.extend(stored.filter(|&a| a < doc.accessors.len()));
        views.extend(places.views(text));
    }
    for &accessor in &accessors {
        views.extend(IN_ACCESSOR.views(doc.item(&doc.accessors, accessor)));
    }
    doc.decode_for(accessors.iter().copied()).ok()?;
    let mut kept = KeptData {
        is_packed: true,
        accessor_numbers: accessors.iter().enumerate().map(|(new, &old)| (old, new)).collect(),
        ..KeptData::default()
    };
    let mut stored: BTreeMap<(usize, u64, u64), usize> = BTreeMap::new();
    for old in views {
        let bytes = doc.view(old).ok()?;
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
        let text = without_extensions(doc.item(&doc.views, old), &MESHOPT);
        let text = with_member(&text, "buffer", "0");
        kept.view_numbers.insert(old, kept.views.len());
        kept.views.push(with_member(&text, "byteOffset", start));
    }
    let new_view = |view| kept.view_numbers.get(&view).copied();
    let renumbered = accessors
        .iter()
        .map(|&old| IN_ACCESSOR.renumber(doc.item(&doc.accessors, old), |_| None, new_view));
    kept.accessors = renumbered.collect();
    Some(kept)
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
        let component = doc.layout(accessor).map(|l| l.component);
        let Some(accessor) = doc.accessors.get(accessor) else {
            return true; // a new one
        };
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

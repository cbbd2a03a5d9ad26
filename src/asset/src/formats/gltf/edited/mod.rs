//! glTF out after edits of the topology: the first base's document with edited primitives, other bases joined to it.
//!
//! Edited primitives get accessors of their own ([`primitives`], stored by [`BufferBuilder`]); nodes that drew one mesh and now
//! differ get meshes of their own ([`frame`]). What nothing uses any more is dropped where that is safe as well, so
//! that compressed and quantised files come back as plain floats without the extensions they needed.

mod blended;
mod frame;
mod joined;
mod looks;
mod named;
mod primitives;
mod skeletons;

pub(super) use blended::distinguish_vertices;
pub(super) use looks::run_attributes;
pub(super) use named::segments;

use super::buffers;
use super::builder::BufferBuilder;
use super::container::GltfFault;
use super::document::{GLB_FORMAT, GltfDocument};
use super::extensions::{doubtful_extensions, dropped_extensions};
use super::package::package;
use super::patched::PatchedDocument;
use super::read::GltfNotes;
use super::references::{IN_ANIMATION, IN_IMAGE, IN_MESH, IN_NODE, IN_SKIN, ReferencePlaces};
use super::rig::FollowedNodeTree;
use super::rig::avatar::extensions_with_materials;
use super::schema::MESHOPT;
use super::stored::BufferOrigin;
use super::targets::TargetTally;
use super::text::{JsonSections, index_of, json_array, list_of, quoted, with_member, without_extensions, without_keys};
use crate::codec::EditedOutput;
use crate::edited::PrimitiveRun;
use crate::{Error, FileSet, WrittenFiles};
use blended::EditedTurns;
use frame::{EditedMeshes, KeptData};
use looks::JoinedBases;
use primitives::PrimitiveMaker;
use std::collections::BTreeSet;

/// Writes an edited model of which the first base is a glTF. The description has been checked.
pub(super) fn write(output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
    let edited = output.edited;
    let fault = GltfFault(output.format);
    let first = edited.bases.first().map(|base| base.model);
    let Some((model, notes)) = first.and_then(|model| Some((model, model.notes::<GltfNotes>()?))) else {
        return Err(fault.unwritable("the first base is not glTF"));
    };
    let doc = notes.document_to_write(model, output.followers.exec.map(|exec| exec.progress))?;
    let shape = || primitives::shape_of_runs(&doc, notes, output);
    let tree = FollowedNodeTree::fit(&doc, notes, output.followers, shape)?;
    let positions = tree.as_ref().map_or(output.positions, |tree| &tree.to_write);
    let output = &EditedOutput { positions, ..*output };
    let mut fresh = BufferBuilder::behind(&doc);
    let own: Vec<&PrimitiveRun> = edited.runs.iter().filter(|run| run.base == 0).collect();
    let turns = EditedTurns::new(edited, positions, output.followers.rules.morph_targets);
    let mut tally = TargetTally::default();
    let mut maker = PrimitiveMaker {
        doc: &doc,
        edited,
        positions,
        fresh: &mut fresh,
        fault,
        is_frame: true,
        joins_skin: false,
        turns: &turns,
        tally: &mut tally,
        dropped: BTreeSet::new(),
        rounded: None,
    };
    let frame = frame::remake_meshes(&mut maker, notes, &own)?;
    let joined = joined::join_bases(&mut maker, notes.files(model), &frame, output, tree.as_ref())?;
    let dropped: Vec<&'static str> = std::mem::take(&mut maker.dropped).into_iter().collect();
    let rounded = maker.rounded.take();
    let writer = EditedGltfWriter {
        doc: &doc,
        files: notes.files(model),
        frame,
        fresh,
        joined,
        dropped,
        fault,
    };
    let mut written = writer.write(KeptData::of(&doc, &writer.frame))?;
    written.warnings.extend(writer.joined.warnings.iter().cloned());
    written.warnings.extend(dropped_extensions(&writer.dropped));
    written
        .warnings
        .extend(doubtful_extensions(&doc, true, output.followers.rules.rig));
    written.warnings.extend(rounded);
    let clips = writer.frame.animations.iter().flatten().map(String::as_str);
    super::rig::rewrite::finish(tree.as_ref(), written, output.format, &doc, clips, &tally)
}

struct EditedGltfWriter<'a> {
    doc: &'a GltfDocument<'a>,
    files: &'a FileSet,
    frame: EditedMeshes,
    fresh: BufferBuilder,
    joined: JoinedBases,
    /// Extensions that were left out somewhere.
    dropped: Vec<&'static str>,
    fault: GltfFault,
}

impl EditedGltfWriter<'_> {
    /// The files, with what is new behind the data that is kept.
    fn write(&self, mut kept: KeptData) -> Result<WrittenFiles, Error> {
        let (doc, is_packed) = (self.doc, kept.is_packed);
        let new_accessor = |a: usize| kept.accessor_number(a, doc.accessors.len());
        let new_view = |v: usize| kept.view_numbers.get(&v).copied();
        let renumber = |text: &str, places: &ReferencePlaces| places.renumber(text, new_accessor, new_view);

        // Meshes that nothing draws any more go, so the others move up; where something unknown may name them by their
        // numbers, they stay.
        let mut meshes = Vec::new();
        let mut mesh_numbers = vec![None; self.frame.meshes.len()];
        for (i, (mesh, number)) in self.frame.meshes.iter().zip(&mut mesh_numbers).enumerate() {
            let stored = (!is_packed).then(|| doc.item(&doc.meshes, i));
            if let Some(text) = mesh.as_deref().or(stored) {
                *number = Some(meshes.len());
                meshes.push(renumber(text, &IN_MESH));
            }
        }
        let first_joined = meshes.len();
        let joined = self.joined.meshes.iter();
        meshes.extend(joined.map(|text| renumber(text, &IN_MESH)));
        let mut nodes: Vec<String> = Vec::with_capacity(doc.nodes.len());
        for (i, stored) in doc.items(&doc.nodes).enumerate() {
            let text = self.frame.nodes.get(&i).map_or(stored, String::as_str);
            let text = renumber(text, &IN_NODE);
            let mesh = index_of(&text, "mesh");
            nodes.push(match mesh.and_then(|m| mesh_numbers.get(m).copied().flatten()) {
                Some(new) if Some(new) != mesh => with_member(&text, "mesh", new),
                _ => text,
            });
        }
        nodes.extend(self.joined.node_texts(first_joined));
        for (parent, more) in &self.joined.children {
            let stored = list_of(&nodes[*parent], "children").into_iter().map(str::to_owned);
            let children = json_array(stored.chain(more.iter().map(usize::to_string)));
            nodes[*parent] = with_member(&nodes[*parent], "children", children);
        }

        let mut sections = JsonSections::default();
        sections.set_list("meshes", &meshes);
        sections.set_list("nodes", &nodes);
        if is_packed || !self.joined.skins.is_empty() {
            let skins = doc
                .items(&doc.skins)
                .chain(self.joined.skins.iter().map(String::as_str));
            let skins: Vec<String> = skins.map(|text| renumber(text, &IN_SKIN)).collect();
            sections.set_list("skins", &skins);
        }
        if is_packed || self.frame.animations.contains(&None) || !self.joined.is_empty() {
            let animations = self.frame.animations.iter().flatten();
            let animations = animations.map(|text| renumber(text, &IN_ANIMATION));
            sections.set_list("animations", &animations.collect::<Vec<_>>());
        }
        let images = list_of(doc.text, "images").into_iter();
        let mut images: Vec<String> = images.map(|text| renumber(text, &IN_IMAGE)).collect();
        images.extend(self.joined.item_texts("images", kept.views.len()));
        sections.set_list("images", &images);
        self.joined_sections(&mut sections);
        self.set_extensions(&mut sections, is_packed, &meshes);

        let target = doc.growing_buffer().filter(|_| !is_packed);
        let buffer = target.unwrap_or(if is_packed { 0 } else { doc.buffers.len() });
        kept.accessors.extend(self.fresh.accessor_texts(kept.views.len()));
        let views = self
            .fresh
            .append_bytes(&mut kept.bytes, buffer, "a buffer", self.fault)?;
        kept.views.extend(views);
        sections.set_list("accessors", &kept.accessors);
        sections.set_list("bufferViews", &kept.views);
        if is_packed {
            sections.set("bufferViews", json_array(&kept.views));
            return self.package_files(sections, kept.bytes);
        }
        let mut patched = PatchedDocument::new(doc);
        sections.edit(doc.text, &mut patched.edits);
        patched.grow(target, kept.bytes);
        let mut written = package(self.files, patched, self.fault.0)?;
        written.companions.extend(self.joined.companions.clone());
        Ok(written)
    }

    /// Puts the files together around one buffer.
    fn package_files(&self, mut sections: JsonSections, bytes: Vec<u8>) -> Result<WrittenFiles, Error> {
        let doc = self.doc;
        let mut companions = self.files.owned_companions();
        for origin in doc.origins() {
            if let BufferOrigin::Companion(name) = origin {
                companions.remove(name);
            }
        }
        companions.extend(self.joined.companions.clone());
        let stored = doc.items(&doc.buffers).next().unwrap_or("{}");
        let mut buffer = without_extensions(stored, &MESHOPT);
        buffer = with_member(&buffer, "byteLength", bytes.len());
        let is_glb = self.fault.0 == GLB_FORMAT;
        let companion = match doc.origins().next() {
            Some(BufferOrigin::Companion(name)) if !is_glb && doc.is_exclusive(0) => Some(name.clone()),
            _ => None,
        };
        if is_glb {
            buffer = without_keys(&buffer, &["uri"]);
        } else if companion.is_none() {
            buffer = with_member(&buffer, "uri", quoted(&buffers::embed(&bytes)));
        }
        sections.set_list("buffers", &[buffer]);
        let json = sections.replace_in(doc.text);
        let main = if is_glb {
            doc.join(&json, Some(&bytes), self.fault)?
        } else {
            json.into_bytes()
        };
        if let Some(name) = companion {
            companions.insert(name, bytes);
        }
        Ok(WrittenFiles::of(main, companions))
    }

    /// Materials, textures, samplers and scenes with those of the joined bases.
    fn joined_sections(&self, sections: &mut JsonSections) {
        for key in ["materials", "textures", "samplers"] {
            let more = self.joined.item_texts(key, 0);
            if !more.is_empty() {
                if key == "materials"
                    && let Some(extensions) = extensions_with_materials(self.doc, &more)
                {
                    sections.set("extensions", extensions);
                }
                let stored = list_of(self.doc.text, key).into_iter().map(str::to_owned);
                sections.set_list(key, &stored.chain(more).collect::<Vec<_>>());
            }
        }
        let roots = &self.joined.roots;
        let scene = self.doc.scene.unwrap_or(0);
        if scene < self.doc.scenes.len() && !roots.is_empty() {
            let listed = self.doc.scenes.values[scene].nodes.iter().map(|n| n.index());
            let nodes = listed.chain(roots.iter().copied());
            let mut scenes: Vec<String> = self.doc.items(&self.doc.scenes).map(str::to_owned).collect();
            scenes[scene] = with_member(&scenes[scene], "nodes", json_array(nodes));
            sections.set_list("scenes", &scenes);
        }
    }

    /// The lists of extensions with those of the joined bases, and without those that packed data does not need.
    fn set_extensions(&self, sections: &mut JsonSections, is_packed: bool, meshes: &[String]) {
        let mut unneeded = Vec::new();
        if is_packed {
            unneeded = frame::unneeded_extensions(self.doc, &self.frame.meshes);
        }
        let is_gone = |name: &&&str| !meshes.iter().any(|text| text.contains(&quoted(name)));
        unneeded.extend(self.dropped.iter().filter(is_gone));
        let (doc, joined) = (self.doc, &self.joined);
        for (key, stored, more) in [
            ("extensionsUsed", &doc.extensions_used, &joined.extensions_used),
            (
                "extensionsRequired",
                &doc.extensions_required,
                &joined.extensions_required,
            ),
        ] {
            let kept = stored.iter().filter(|e| !unneeded.contains(&e.as_str()));
            let list = kept.chain(more.iter().filter(|e| !stored.contains(e)));
            let list: Vec<String> = list.map(|e| quoted(e)).collect();
            if list.len() != stored.len() || !more.is_empty() {
                sections.set_list(key, &list);
            }
        }
    }
}

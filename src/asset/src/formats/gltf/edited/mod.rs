//! glTF out after edits of the topology: the first base's document with edited primitives, other bases joined to it.
//!
//! Edited primitives get accessors of their own ([`primitives`], stored by [`BufferBuilder`]); nodes that drew one mesh and now
//! differ get meshes of their own ([`frame`]). What nothing uses any more is dropped where that is safe as well, so
//! that compressed and quantised files come back as plain floats without the extensions they needed.

mod blended;
mod frame;
mod joined;
mod looks;
mod primitives;

pub(super) use blended::distinguish_vertices;
pub(super) use looks::run_attributes;

use super::buffers::{self, BufferOrigin};
use super::builder::BufferBuilder;
use super::container::{self, GltfFault};
use super::document::{GLB_FORMAT, GltfDocument};
use super::package::package;
use super::patch::PatchedDocument;
use super::read::GltfNotes;
use super::rig::FollowedNodeTree;
use super::schema::MESHOPT;
use super::targets::TargetTally;
use super::text::{
    index_of, json_array, json_object, list_of, members, quoted, with_member, without_extensions, without_keys,
};
use crate::codec::EditedOutput;
use crate::edited::PrimitiveRun;
use crate::{Error, FileSet, WrittenFiles};
use blended::EditedTurns;
use frame::{EditedMeshes, KeptData};
use looks::JoinedBases;
use primitives::PrimitiveMaker;
use std::collections::BTreeMap;

/// New texts of top-level members; `None` for those that go.
pub(super) type JsonSections = BTreeMap<&'static str, Option<String>>;

/// Writes an edited model of which the first base is a glTF. The description has been checked.
pub(super) fn write(output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
    let edited = output.edited;
    let fault = GltfFault(output.format);
    let first = edited.bases.first().map(|base| base.model);
    let Some((model, notes)) = first.and_then(|model| Some((model, model.notes::<GltfNotes>()?))) else {
        return Err(fault.unwritable("the first base is not glTF"));
    };
    let doc = notes.loaded_document(model)?;
    let mut tree = None;
    if super::rig::may_move_nodes(notes, output.followers) {
        let before = primitives::positions_before(edited);
        let shape = primitives::shape_of_runs(&doc, notes, output, &before)?;
        tree = FollowedNodeTree::fit(&doc, notes, &shape, output.followers)?.map(|tree| {
            let to_write = tree.positions_to_write(&shape);
            (tree, to_write)
        });
    }
    let positions = tree.as_ref().map_or(output.positions, |(_, to_write)| to_write);
    let output = &EditedOutput { positions, ..*output };
    let mut fresh = BufferBuilder::default();
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
        turns: &turns,
        tally: &mut tally,
    };
    let frame = frame::remake_meshes(&mut maker, notes, &own)?;
    let joined = joined::join_bases(&mut maker, notes.files(model), &frame, output)?;
    let mut writer = EditedGltfWriter {
        doc: &doc,
        files: notes.files(model),
        frame,
        fresh,
        joined,
        fault,
    };
    let kept = match frame::may_drop(&doc) {
        true => frame::pack_kept_data(&doc, &writer.frame),
        false => None,
    };
    let mut written = match kept {
        Some(kept) => writer.write_packed(kept)?,
        None => writer.write_appended()?,
    };
    let clips = writer.frame.animations.iter().flatten().map(String::as_str);
    let mut followed = super::deformed::followable(&doc, clips);
    tally.count_into(&mut followed);
    if let Some((tree, _)) = &tree {
        written = tree.rewrite(written, output.format)?;
        tree.count_into(&doc, &mut followed);
    }
    followed.rewritten_clips = written.followed.rewritten_clips;
    written.followed = followed;
    Ok(written)
}

struct EditedGltfWriter<'a> {
    doc: &'a GltfDocument<'a>,
    files: &'a FileSet,
    frame: EditedMeshes,
    fresh: BufferBuilder,
    joined: JoinedBases,
    fault: GltfFault,
}

impl EditedGltfWriter<'_> {
    /// The document with all of its data packed into one buffer.
    fn write_packed(&mut self, kept: KeptData) -> Result<WrittenFiles, Error> {
        let doc = self.doc;
        let unneeded = frame::unneeded_extensions(doc, &self.frame.meshes);
        let old = doc.accessors.len();
        let new_accessor = |a: usize| match a.checked_sub(old) {
            Some(fresh) => Some(kept.accessors.len() + fresh),
            None => kept.accessor_numbers.get(&a).copied(),
        };
        let new_view = |v: usize| kept.view_numbers.get(&v).copied();
        let renumber = |text: &str, of: fn(&str) -> super::references::References<'_>| {
            super::references::renumber_references(text, of, new_accessor, new_view)
        };

        // Meshes that nothing draws any more go, so the others move up.
        let mut meshes = Vec::new();
        let mut mesh_numbers = vec![None; self.frame.meshes.len()];
        for (mesh, number) in self.frame.meshes.iter().zip(&mut mesh_numbers) {
            if let Some(text) = mesh {
                *number = Some(meshes.len());
                meshes.push(renumber(text, super::references::of_mesh));
            }
        }
        let first_joined = meshes.len();
        meshes.extend(
            self.joined
                .meshes
                .iter()
                .map(|text| renumber(text, super::references::of_mesh)),
        );
        let mut nodes: Vec<String> = Vec::with_capacity(doc.nodes.len());
        for (i, stored) in doc.items(&doc.nodes).enumerate() {
            let text = self.frame.nodes.get(&i).map_or(stored, String::as_str);
            let text = renumber(text, super::references::of_node);
            let mesh = index_of(&text, "mesh");
            nodes.push(match mesh.and_then(|m| mesh_numbers.get(m).copied().flatten()) {
                Some(new) if Some(new) != mesh => with_member(&text, "mesh", new),
                _ => text,
            });
        }
        nodes.extend(self.joined.node_texts(first_joined));

        let mut sections = JsonSections::new();
        sections.insert("meshes", Some(json_array(&meshes)));
        sections.insert("nodes", Some(json_array(&nodes)));
        let skins = doc.items(&doc.skins);
        let skins: Vec<String> = skins.map(|text| renumber(text, super::references::of_skin)).collect();
        let animations = self.frame.animations.iter().flatten();
        let animations: Vec<String> = animations
            .map(|text| renumber(text, super::references::of_animation))
            .collect();
        for (key, list) in [("skins", skins), ("animations", animations)] {
            sections.insert(key, (!list.is_empty()).then(|| json_array(&list)));
        }
        let mut images: Vec<String> = list_of(doc.text, "images")
            .into_iter()
            .map(|text| renumber(text, super::references::of_image))
            .collect();
        images.extend(self.joined.image_texts(kept.views.len()));
        sections.insert("images", (!images.is_empty()).then(|| json_array(&images)));
        self.joined_sections(&mut sections);
        self.set_extensions(&mut sections, &unneeded);

        let KeptData {
            mut bytes,
            mut views,
            mut accessors,
            ..
        } = kept;
        accessors.extend(self.fresh.accessor_texts(views.len()));
        views.extend(self.fresh.append_bytes(&mut bytes, 0, self.fault)?);
        sections.insert("accessors", Some(json_array(&accessors)));
        sections.insert("bufferViews", Some(json_array(&views)));
        self.package_files(sections, bytes)
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
        sections.insert("buffers", Some(json_array(&[buffer])));
        let json = replace_members(doc.text, sections);
        let main = if is_glb {
            let rest = doc.container.as_ref().map_or(&[][..], |c| &c.rest);
            container::join(&json, Some(&bytes), rest, self.fault)?
        } else {
            json.into_bytes()
        };
        if let Some(name) = companion {
            companions.insert(name, bytes);
        }
        Ok(WrittenFiles::of(main, companions))
    }

    /// The document with all of its old data where it was, and new data behind it.
    fn write_appended(&mut self) -> Result<WrittenFiles, Error> {
        let doc = self.doc;
        let target = doc.growing_buffer();
        let stored = target.and_then(|i| doc.buffer_bytes(i));
        let mut bytes = stored.map(|b| b.to_vec()).unwrap_or_default();
        let number = target.unwrap_or(doc.buffers.len());
        let view_texts = self.fresh.append_bytes(&mut bytes, number, self.fault)?;
        let accessor_texts = self.fresh.accessor_texts(doc.views.len());

        let whole = |list: Vec<String>| (!list.is_empty()).then(|| json_array(&list));
        let mut sections = JsonSections::new();
        let mut meshes: Vec<String> = Vec::new();
        for (i, mesh) in self.frame.meshes.iter().enumerate() {
            // Something unknown may name the mesh by its number, so it stays.
            let stored = || (i < doc.meshes.len()).then(|| doc.item(&doc.meshes, i).to_owned());
            meshes.extend(mesh.clone().or_else(stored));
        }
        let first_joined = meshes.len();
        meshes.extend(self.joined.meshes.iter().cloned());
        sections.insert("meshes", whole(meshes));
        let stored = doc.items(&doc.nodes).enumerate();
        let mut nodes: Vec<String> = stored
            .map(|(i, text)| self.frame.nodes.get(&i).cloned().unwrap_or_else(|| text.to_owned()))
            .collect();
        nodes.extend(self.joined.node_texts(first_joined));
        sections.insert("nodes", whole(nodes));
        if self.frame.animations.contains(&None) || !self.joined.is_empty() {
            sections.insert(
                "animations",
                whole(self.frame.animations.iter().flatten().cloned().collect()),
            );
        }
        let old = |key: &str| -> Vec<String> { list_of(doc.text, key).into_iter().map(str::to_owned).collect() };
        let mut images = old("images");
        images.extend(self.joined.image_texts(doc.views.len()));
        sections.insert("images", whole(images));
        self.joined_sections(&mut sections);
        self.set_extensions(&mut sections, &[]);
        for (key, mut list, more) in [
            ("bufferViews", old("bufferViews"), view_texts),
            ("accessors", old("accessors"), accessor_texts),
        ] {
            list.extend(more);
            sections.insert(key, whole(list));
        }

        let mut patched = PatchedDocument::new(doc);
        for (key, value) in &sections {
            match value {
                Some(value) => patched.edits.set(doc.text, key, value),
                None => patched.edits.remove(doc.text, key),
            }
        }
        patched.grow(target, bytes);
        let mut written = package(self.files, patched, self.fault.0)?;
        written.companions.extend(self.joined.companions.clone());
        Ok(written)
    }

    /// Materials, textures, samplers and scenes with those of the joined bases.
    fn joined_sections(&self, sections: &mut JsonSections) {
        for (key, more) in [
            ("materials", &self.joined.materials),
            ("textures", &self.joined.textures),
            ("samplers", &self.joined.samplers),
        ] {
            if !more.is_empty() {
                let mut list: Vec<String> = list_of(self.doc.text, key).into_iter().map(str::to_owned).collect();
                list.extend(more.iter().cloned());
                sections.insert(key, Some(json_array(&list)));
            }
        }
        let roots = &self.joined.roots;
        let scene = self.doc.scene.unwrap_or(0);
        if scene < self.doc.scenes.len() && !roots.is_empty() {
            let listed = self.doc.scenes.values[scene].nodes.iter().map(|n| n.index());
            let nodes = listed.chain(roots.iter().copied());
            let mut scenes: Vec<String> = self.doc.items(&self.doc.scenes).map(str::to_owned).collect();
            scenes[scene] = with_member(&scenes[scene], "nodes", json_array(nodes));
            sections.insert("scenes", Some(json_array(&scenes)));
        }
    }

    /// The lists of extensions, without some and with those of the joined bases.
    fn set_extensions(&self, sections: &mut JsonSections, unneeded: &[&str]) {
        for (key, stored, more) in [
            (
                "extensionsUsed",
                &self.doc.extensions_used,
                &self.joined.extensions_used,
            ),
            (
                "extensionsRequired",
                &self.doc.extensions_required,
                &self.joined.extensions_required,
            ),
        ] {
            let mut list: Vec<&String> = stored.iter().filter(|e| !unneeded.contains(&e.as_str())).collect();
            list.extend(more.iter().filter(|e| !stored.contains(e)));
            if list.len() != stored.len() || !more.is_empty() {
                sections.insert(
                    key,
                    (!list.is_empty()).then(|| json_array(list.into_iter().map(|e| quoted(e)))),
                );
            }
        }
    }
}

/// The document with new values of some members, in the order in which they were; added ones follow.
pub(super) fn replace_members(text: &str, mut sections: JsonSections) -> String {
    let mut out = Vec::new();
    for member in members(text).unwrap_or_default() {
        let value = sections.remove(member.key.as_str());
        out.extend(
            value
                .unwrap_or_else(|| Some(member.value.to_owned()))
                .map(|value| (member.key, value)),
        );
    }
    let added = sections
        .into_iter()
        .filter_map(|(key, value)| Some((key.to_owned(), value?)));
    json_object(out.into_iter().chain(added))
}

//! Puts moved nodes into files: nodes, inverse bind matrices, and clips.
//!
//! Clips after joints have moved: the samplers whose values change, and how.
//!
//! Old and new rest pose of a node differ by a turn in its parent's frame and by where it stands there. A rotation of a clip is
//! turned by the same, and a translation's difference from the old rest is turned and added to the new. In the node's own
//! frame a clip so does what it did. Where a bone keeps its length, translations turn with the bone instead. All of it is linear in what interpolation mixes, tangents of splines included.

use super::super::accessors::{AccessorLayout, ComponentType, decode_values};
use super::super::buffers::BufferBytes;
use super::super::builder::{AccessorKind, BufferBuilder, bounds, json_floats};
use super::super::document::{GltfDocument, PatchedDocument};
use super::super::package::package;
use super::super::read::{load_bytes, parse_written};
use super::super::references::{self, References};
use super::super::text::{JsonEdits, index_of, list_of, parse_index, value_of, with_member};
use super::super::used_bytes::ByteSpans;
use super::nodes::{MovedNode, MovedNodes};
use super::{BindChanges, FollowedNodeTree};
use crate::files::within;
use crate::{Error, FileSet, Format, WrittenFiles};
use glam::{DQuat, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// How many bytes of clips are rewritten for one file: channels may share their numbers, so that their size is not bounded by
/// the file's.
const MOST_REWRITTEN: u64 = 1 << 30;

impl FollowedNodeTree {
    /// Puts the moved nodes into files that were written as if none had moved, and counts the clips that change.
    pub(in super::super) fn rewrite(&self, written: WrittenFiles, format: Format) -> Result<WrittenFiles, Error> {
        let files = FileSet {
            name: String::new(),
            main: written.main.into(),
            companions: written.companions.into_iter().map(|(n, b)| (n, b.into())).collect(),
        };
        let parsed = parse_written(&files, format)?;
        let doc = parsed.of(&files)?;
        let buffers = load_bytes(&doc, &files)?;
        let mut writer = RigWriter {
            edits: JsonEdits::new(doc.text),
            uses: accessor_uses(&doc),
            spans: ByteSpans::collect(&doc),
            doc: &doc,
            buffers,
            fresh: BufferBuilder::default(),
            overwritten: BTreeMap::new(),
            rewritten: 0,
            clips: BTreeSet::new(),
        };
        writer.write_nodes(self);
        for (&skin, changes) in &self.binds {
            writer.write_binds(skin, changes)?;
        }
        writer.write_clips(self)?;
        let clips = u32::try_from(writer.clips.len()).unwrap_or(u32::MAX);
        let mut written = writer.finish(&files, format)?;
        written.followed.rewritten_clips = clips;
        Ok(written)
    }
}

struct RigWriter<'d, 'a> {
    doc: &'d GltfDocument<'a>,
    buffers: BufferBytes<'static>,
    edits: JsonEdits<'a>,
    fresh: BufferBuilder,
    /// Whole new contents by buffer.
    overwritten: BTreeMap<usize, Vec<u8>>,
    /// How often each accessor is named.
    uses: Vec<u32>,
    spans: ByteSpans,
    rewritten: u64,
    /// Clips that change.
    clips: BTreeSet<usize>,
}

/// New values on their way into a file.
struct NewValues<'v> {
    values: &'v [f32],
    lanes: usize,
    shape: &'static str,
}

impl<'a> RigWriter<'_, 'a> {
    fn write_nodes(&mut self, tree: &FollowedNodeTree) {
        for (&index, node) in &tree.nodes.moved {
            let text = self.doc.nodes.items[index];
            let parts = [
                ("translation", node.translation.as_ref().map(|v| &v[..])),
                ("rotation", node.rotation.as_ref().map(|v| &v[..])),
                ("matrix", node.matrix.as_ref().map(|v| &v[..])),
            ];
            for (key, values) in parts {
                if let Some(values) = values {
                    self.edits.set(text, key, json_floats(values));
                }
            }
        }
    }

    fn write_binds(&mut self, skin: usize, changes: &BindChanges) -> Result<(), Error> {
        let doc = self.doc;
        let (Some(&text), count) = (doc.skins.get(skin), super::joint_count(doc, skin)) else {
            return Ok(());
        };
        let accessor = index_of(text, "inverseBindMatrices");
        let mut values: Vec<f32> = match accessor {
            Some(accessor) => self.read(accessor, 16)?.unwrap_or_default(),
            None => Vec::new(),
        };
        let one = glam::Mat4::IDENTITY.to_cols_array();
        while values.len() < 16 * count {
            values.extend(one);
        }
        for (number, matrix) in changes {
            values[16 * number..16 * number + 16].copy_from_slice(matrix);
        }
        let new = NewValues {
            values: &values,
            lanes: 16,
            shape: "MAT4",
        };
        // Skins that share their matrices come one by one; the first to come would spoil those of the others.
        let in_place = accessor.filter(|_| self.names(accessor) == 1);
        if let Some(at) = self.store(in_place, &new)? {
            self.edits.set(text, "inverseBindMatrices", at);
        }
        Ok(())
    }

    fn names(&self, accessor: Option<usize>) -> u32 {
        accessor.and_then(|a| self.uses.get(a)).copied().unwrap_or(0)
    }

    fn write_clips(&mut self, tree: &FollowedNodeTree) -> Result<(), Error> {
        let samplers = changed_samplers(self.doc, &tree.nodes);
        let mut wanted: BTreeMap<(SampledValues, ClipTarget), Vec<&ChangedSampler<'a>>> = BTreeMap::new();
        for sampler in &samplers {
            wanted
                .entry((sampler.values, sampler.target))
                .or_default()
                .push(sampler);
        }
        // New samplers by animation, in order.
        let mut parted: BTreeMap<usize, Vec<String>> = BTreeMap::new();
        for ((sampled, target), users) in wanted {
            let (Some(node), Some(stored)) = (
                tree.nodes.moved.get(&target.node),
                self.read(sampled.accessor, target.lanes())?,
            ) else {
                continue;
            };
            let values = carried_values(&stored, node, target.is_rotation, sampled.is_spline);
            if values
                .iter()
                .map(|v| v.to_bits())
                .eq(stored.iter().map(|v| v.to_bits()))
            {
                continue;
            }
            self.spend(4 * values.len() as u64)?;
            let direct = users.iter().filter(|user| user.parting.is_empty()).count();
            let is_all = direct == users.len() && self.names(Some(sampled.accessor)) as usize == direct;
            let new = NewValues {
                values: &values,
                lanes: target.lanes(),
                shape: if target.is_rotation { "VEC4" } else { "VEC3" },
            };
            self.clips.extend(users.iter().map(|user| user.animation));
            let Some(at) = self.store(Some(sampled.accessor).filter(|_| is_all), &new)? else {
                continue;
            };
            for user in users {
                self.point_sampler(user, at, &mut parted);
            }
        }
        for (animation, samplers) in parted {
            if let Some(array) = value_of(self.doc.animations[animation], "samplers") {
                self.edits.push(array, &samplers);
            }
        }
        Ok(())
    }

    /// Points a sampler at new values, or the channels that part from it at a new sampler.
    fn point_sampler(&mut self, user: &ChangedSampler<'a>, accessor: usize, parted: &mut BTreeMap<usize, Vec<String>>) {
        if user.parting.is_empty() {
            self.edits.set(user.sampler, "output", accessor);
            return;
        }
        let stored = value_of(self.doc.animations[user.animation], "samplers");
        let stored = stored
            .and_then(|list| super::super::text::items(list).ok())
            .map_or(0, |list| list.len());
        let new = parted.entry(user.animation).or_default();
        let number = (stored + new.len()).to_string();
        new.push(with_member(user.sampler, "output", accessor));
        for channel in &user.parting {
            self.edits.set(channel, "sampler", &number);
        }
    }

    fn spend(&mut self, bytes: u64) -> Result<(), Error> {
        self.rewritten = self.rewritten.saturating_add(bytes);
        within("number of bytes of clips that follow", self.rewritten, MOST_REWRITTEN)
    }

    /// The values of an accessor with so many lanes; `None` for one of another kind.
    fn read(&mut self, accessor: usize, lanes: usize) -> Result<Option<Vec<f32>>, Error> {
        let layout = AccessorLayout::find(self.doc, accessor).filter(|l| l.lanes == lanes);
        let read = |layout| decode_values(self.doc, &mut self.buffers, accessor, layout);
        layout.map(read).transpose()
    }

    /// Stores values in place of those of an accessor where that changes nothing else, in a new accessor otherwise, the number of
    /// which is returned.
    fn store(&mut self, in_place: Option<usize>, new: &NewValues<'_>) -> Result<Option<usize>, Error> {
        if let Some(accessor) = in_place
            && self.overwrite(accessor, new)
        {
            return Ok(None);
        }
        let number = self
            .fresh
            .add_floats(new.values, new.lanes, new.shape, AccessorKind::Numbers);
        Ok(Some(self.doc.accessors.len() + number))
    }

    fn overwrite(&mut self, index: usize, new: &NewValues<'_>) -> bool {
        let doc = self.doc;
        let accessor = &doc.accessors.values[index];
        let layout = AccessorLayout::of(accessor, doc.views.values);
        let (Some(layout), Some(view)) = (layout, accessor.buffer_view.and_then(|v| doc.views.get(v.index()))) else {
            return false;
        };
        let buffer = view.buffer.index();
        let fits = layout.component == ComponentType::F32
            && accessor.sparse.is_none()
            && accessor.count.index().saturating_mul(new.lanes) == new.values.len()
            && self.buffers.takes_floats(doc, view)
            && self.spans.is_alone(index);
        if !fits {
            return false;
        }
        let stored = &self.buffers.stored;
        let bytes = self.overwritten.entry(buffer).or_insert_with(|| {
            let bytes = stored.get(buffer).and_then(|s| s.bytes.as_ref());
            bytes.map(|b| b.to_vec()).unwrap_or_default()
        });
        let (start, stride) = ((view.offset() + accessor.offset()) as usize, layout.stride as usize);
        let end = start + (accessor.count.index().saturating_sub(1)) * stride + 4 * new.lanes;
        if bytes.len() < end {
            return false;
        }
        for (i, element) in new.values.chunks_exact(new.lanes).enumerate() {
            let place = &mut bytes[start + i * stride..][..4 * new.lanes];
            for (to, value) in place.as_chunks_mut::<4>().0.iter_mut().zip(element) {
                *to = value.to_le_bytes();
            }
        }
        let text = doc.accessors.items[index];
        let (least, most) = bounds(new.values, new.lanes);
        for (key, value) in [("min", least), ("max", most)] {
            if value_of(text, key).is_some() {
                self.edits.set(text, key, &value);
            }
        }
        true
    }

    /// Adds what is new to the end of the first buffer that takes more, and makes the files.
    fn finish(self, files: &FileSet, format: Format) -> Result<WrittenFiles, Error> {
        let Self {
            doc,
            buffers,
            edits,
            fresh,
            overwritten,
            ..
        } = self;
        let mut patched = PatchedDocument {
            edits,
            buffers: overwritten,
            added_buffer: None,
        };
        fresh.append_to(doc, &buffers, &mut patched)?;
        package(doc, files, &buffers, patched, format)
    }
}

/// How often each accessor is named.
fn accessor_uses(doc: &GltfDocument<'_>) -> Vec<u32> {
    let mut uses = vec![0; doc.accessors.len()];
    let mut count = |places: References<'_>| {
        for index in places.accessors.into_iter().filter_map(parse_index) {
            if let Some(uses) = uses.get_mut(index) {
                *uses += 1;
            }
        }
    };
    doc.meshes
        .items
        .iter()
        .for_each(|text| count(references::of_mesh(text)));
    doc.nodes.items.iter().for_each(|text| count(references::of_node(text)));
    doc.skins.iter().for_each(|text| count(references::of_skin(text)));
    doc.animations
        .iter()
        .for_each(|text| count(references::of_animation(text)));
    uses
}

/// What a clip does to a node that has moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ClipTarget {
    pub(super) node: usize,
    pub(super) is_rotation: bool,
}

/// How values of a sampler lie in their accessor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct SampledValues {
    pub(super) accessor: usize,
    /// Whether each value stands between two tangents.
    pub(super) is_spline: bool,
}

/// A sampler that needs other values.
pub(super) struct ChangedSampler<'a> {
    pub(super) animation: usize,
    /// Its text.
    pub(super) sampler: &'a str,
    pub(super) values: SampledValues,
    pub(super) target: ClipTarget,
    /// The channels that need a sampler of their own, because others use this one for something else; empty when the sampler
    /// itself changes.
    pub(super) parting: Vec<&'a str>,
}

impl ClipTarget {
    /// Numbers of one value.
    pub(super) fn lanes(self) -> usize {
        if self.is_rotation { 4 } else { 3 }
    }
}

/// All samplers that need other values, animation by animation.
pub(super) fn changed_samplers<'a>(doc: &GltfDocument<'a>, nodes: &MovedNodes) -> Vec<ChangedSampler<'a>> {
    let mut all = Vec::new();
    for (animation, &text) in doc.animations.iter().enumerate() {
        let list = |key: &str| list_of(text, key);
        let samplers = list("samplers");
        let mut users: BTreeMap<usize, Vec<(Option<ClipTarget>, &'a str)>> = BTreeMap::new();
        for channel in list("channels") {
            if let Some(sampler) = index_of(channel, "sampler") {
                let target = target_of(channel).filter(|target| is_changed(nodes, *target));
                users.entry(sampler).or_default().push((target, channel));
            }
        }
        for (sampler, users) in users {
            let Some(&text) = samplers.get(sampler) else { continue };
            let Some(accessor) = index_of(text, "output") else {
                continue;
            };
            let is_spline = value_of(text, "interpolation") == Some("\"CUBICSPLINE\"");
            let mut wanted: BTreeMap<ClipTarget, Vec<&'a str>> = BTreeMap::new();
            for (target, channel) in &users {
                if let Some(target) = target {
                    wanted.entry(*target).or_default().push(channel);
                }
            }
            let is_agreed = wanted.len() == 1 && users.iter().all(|(target, _)| target.is_some());
            for (target, channels) in wanted {
                all.push(ChangedSampler {
                    animation,
                    sampler: text,
                    values: SampledValues { accessor, is_spline },
                    target,
                    parting: if is_agreed { Vec::new() } else { channels },
                });
            }
        }
    }
    all
}

/// Which node a channel moves, and how; `None` for what no joint's motion changes.
fn target_of(channel: &str) -> Option<ClipTarget> {
    let target = value_of(channel, "target")?;
    let path: String = serde_json::from_str(value_of(target, "path")?).ok()?;
    let (node, path) = if path == "pointer" {
        let extension = value_of(value_of(target, "extensions")?, "KHR_animation_pointer")?;
        let pointer: String = serde_json::from_str(value_of(extension, "pointer")?).ok()?;
        let (node, path) = pointer.strip_prefix("/nodes/")?.split_once('/')?;
        (node.parse().ok()?, path.to_owned())
    } else {
        (index_of(target, "node")?, path)
    };
    let is_rotation = path == "rotation";
    (is_rotation || path == "translation").then_some(ClipTarget { node, is_rotation })
}

/// Whether a clip moves or turns any node. Others, such as those of morph weights alone, never change.
pub(in super::super) fn moves_nodes(animation: &str) -> bool {
    let channels = list_of(animation, "channels");
    channels.into_iter().any(|channel| target_of(channel).is_some())
}

fn is_changed(nodes: &MovedNodes, target: ClipTarget) -> bool {
    let turns = |node: &MovedNode| node.turn != DQuat::IDENTITY;
    let node = nodes.moved.get(&target.node);
    node.is_some_and(|node| turns(node) || (!target.is_rotation && node.translation.is_some()))
}

/// Values of a sampler relative to the new rest pose.
pub(super) fn carried_values(stored: &[f32], node: &MovedNode, is_rotation: bool, is_spline: bool) -> Vec<f32> {
    let mut values = stored.to_vec();
    if is_rotation {
        for value in values.as_chunks_mut::<4>().0 {
            let carried = (node.turn * DQuat::from_array(value.map(f64::from))).as_quat();
            if carried.is_finite() {
                *value = carried.to_array();
            }
        }
        return values;
    }
    let turn = node.bone_turn.unwrap_or(node.turn);
    for (i, value) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
        let stored = DVec3::from_array(value.map(f64::from));
        let is_tangent = is_spline && i % 3 != 1;
        let carried = if is_tangent {
            turn * stored
        } else {
            node.to + turn * (stored - node.from)
        };
        if carried.as_vec3().is_finite() {
            *value = carried.as_vec3().to_array();
        }
    }
    values
}

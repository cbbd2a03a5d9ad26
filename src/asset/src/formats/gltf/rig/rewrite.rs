//! Puts moved nodes into files: nodes, inverse bind matrices, and clips.
//!
//! Clips after joints have moved: the samplers whose values change, and how.
//!
//! Old and new rest pose of a node differ by a turn in its parent's frame and by where it stands there. A rotation of a clip is
//! turned by the same, and a translation's difference from the old rest is turned and added to the new. In the node's own
//! frame a clip so does what it did. Where a bone keeps its length, translations turn with the bone instead. All of it is linear in what interpolation mixes, tangents of splines included.

use super::super::accessors::{AccessorLayout, ComponentType};
use super::super::builder::{AccessorKind, BufferBuilder, json_floats};
use super::super::document::GltfDocument;
use super::super::package::package;
use super::super::patched::PatchedDocument;
use super::super::placement::joint_nodes;
use super::super::read::parse_written;
use super::super::references::{IN_MESH, accessors_beside_meshes};
use super::super::schema::WholeNumber;
use super::super::stored::ViewDecoding;
use super::super::targets::TargetTally;
use super::super::text::{index_of, list_of, string_of, value_at, value_of, with_member};
use super::super::used_bytes::ByteSpans;
use super::nodes::{MovedNode, MovedNodes};
use super::{BindChanges, FollowedNodeTree};
use crate::files::within;
use crate::{Error, FollowedCounts, Format, WrittenFiles};
use glam::{DQuat, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// How many bytes of clips are rewritten for one file: channels may share their numbers, so that their size is not bounded by
/// the file's.
const MOST_REWRITTEN: u64 = 1 << 30;

impl FollowedNodeTree {
    /// Puts the moved nodes into files that were written as if none had moved, and counts the clips that change. `decoding` is how
    /// their views are decompressed.
    fn rewrite(
        &self,
        written: WrittenFiles,
        format: Format,
        decoding: ViewDecoding<'_>,
    ) -> Result<WrittenFiles, Error> {
        let files = written.into_files("");
        let parsed = parse_written(&files, format)?;
        let mut doc = parsed.of(&files)?;
        doc.bytes.decoding = decoding;
        let doc = doc.load_bytes(&files, None)?;
        let mut writer = RigWriter {
            uses: accessor_uses(&doc),
            spans: ByteSpans::collect(&doc),
            doc: &doc,
            patched: PatchedDocument::new(&doc),
            fresh: BufferBuilder::behind(&doc),
            rewritten: 0,
            clips: BTreeSet::new(),
        };
        writer.write_nodes(self);
        self.avatar.write(&doc, &mut writer.patched.edits);
        for (&skin, changes) in &self.binds {
            writer.write_binds(skin, changes)?;
        }
        writer.write_clips(self)?;
        let clips = u32::try_from(writer.clips.len()).unwrap_or(u32::MAX);
        writer.patched.append(&writer.fresh, "a buffer")?;
        let mut written = package(&files, writer.patched, format)?;
        written.followed.rewritten_clips = clips;
        Ok(written)
    }
}

/// The joints of a document, and those of its clips that move nodes; others have nothing that could follow.
pub(in super::super) fn followable<'t>(
    doc: &GltfDocument<'_>,
    clips: impl IntoIterator<Item = &'t str>,
) -> FollowedCounts {
    let clips = clips.into_iter().filter(|text| moves_nodes(text)).count();
    let number = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    FollowedCounts {
        joints: number(joint_nodes(doc).len()),
        clips: number(clips),
        ..FollowedCounts::default()
    }
}

/// Puts the moved nodes, where there are some, into files that were written as if none had moved, and counts what followed.
/// `clips` are those of the document that the files still have.
pub(in super::super) fn finish<'t>(
    tree: Option<&FollowedNodeTree>,
    written: WrittenFiles,
    format: Format,
    doc: &GltfDocument<'_>,
    clips: impl IntoIterator<Item = &'t str>,
    tally: &TargetTally,
) -> Result<WrittenFiles, Error> {
    let mut followed = followable(doc, clips);
    tally.count_into(&mut followed);
    let mut written = written;
    if let Some(tree) = tree {
        written = tree.rewrite(written, format, doc.bytes.decoding)?;
        tree.count_into(doc, &mut followed);
        followed.rewritten_clips = written.followed.rewritten_clips;
    }
    written.followed = followed;
    Ok(written)
}

struct RigWriter<'d, 'a> {
    doc: &'d GltfDocument<'a>,
    patched: PatchedDocument<'d, 'a>,
    fresh: BufferBuilder,
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
            let text = self.doc.item(&self.doc.nodes, index);
            let parts = [
                ("translation", node.translation.as_ref().map(|v| &v[..])),
                ("rotation", node.rotation.as_ref().map(|v| &v[..])),
                ("matrix", node.matrix.as_ref().map(|v| &v[..])),
            ];
            for (key, values) in parts {
                if let Some(values) = values {
                    self.patched.edits.set(text, key, json_floats(values));
                }
            }
        }
    }

    fn write_binds(&mut self, skin: usize, changes: &BindChanges) -> Result<(), Error> {
        let doc = self.doc;
        let (text, count) = (doc.item(&doc.skins, skin), super::joint_count(doc, skin));
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
        if let Some(at) = self.store(in_place, &new) {
            self.patched.edits.set(text, "inverseBindMatrices", at);
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
            let Some(at) = self.store(Some(sampled.accessor).filter(|_| is_all), &new) else {
                continue;
            };
            for user in users {
                self.point_sampler(user, at, &mut parted);
            }
        }
        for (animation, samplers) in parted {
            if let Some(array) = value_of(self.doc.item(&self.doc.animations, animation), "samplers") {
                self.patched.edits.push(array, &samplers);
            }
        }
        Ok(())
    }

    /// Points a sampler at new values, or the channels that part from it at a new sampler.
    fn point_sampler(&mut self, user: &ChangedSampler<'a>, accessor: usize, parted: &mut BTreeMap<usize, Vec<String>>) {
        if user.parting.is_empty() {
            self.patched.edits.set(user.sampler, "output", accessor);
            return;
        }
        let animation = self.doc.item(&self.doc.animations, user.animation);
        let stored = list_of(animation, "samplers").len();
        let new = parted.entry(user.animation).or_default();
        let number = (stored + new.len()).to_string();
        new.push(with_member(user.sampler, "output", accessor));
        for channel in &user.parting {
            self.patched.edits.set(channel, "sampler", &number);
        }
    }

    fn spend(&mut self, bytes: u64) -> Result<(), Error> {
        self.rewritten = self.rewritten.saturating_add(bytes);
        within("number of bytes of clips that follow", self.rewritten, MOST_REWRITTEN)
    }

    /// The values of an accessor with so many lanes; `None` for one of another kind.
    fn read(&self, accessor: usize, lanes: usize) -> Result<Option<Vec<f32>>, Error> {
        let layout = self.doc.layout(accessor).filter(|l| l.lanes == lanes);
        layout.map(|layout| self.doc.read_values(accessor, layout)).transpose()
    }

    /// Stores values in place of those of an accessor where that changes nothing else, in a new accessor otherwise, the number of
    /// which is returned.
    fn store(&mut self, in_place: Option<usize>, new: &NewValues<'_>) -> Option<usize> {
        if let Some(accessor) = in_place
            && self.overwrite(accessor, new)
        {
            return None;
        }
        let kind = AccessorKind::Numbers;
        Some(self.fresh.add_floats(new.values, new.shape, kind))
    }

    fn overwrite(&mut self, index: usize, new: &NewValues<'_>) -> bool {
        let doc = self.doc;
        let accessor = &doc.accessors.values[index];
        let view = accessor.buffer_view.map_or(usize::MAX, WholeNumber::index);
        let fits = |layout: &AccessorLayout| {
            layout.component == ComponentType::F32
                && accessor.sparse.is_none()
                && accessor.count.index().saturating_mul(new.lanes) == new.values.len()
                && doc.views.get(view).is_some_and(|view| doc.takes_floats(view))
                && self.spans.is_alone(index)
        };
        let Some(layout) = doc.layout(index).filter(fits) else {
            return false;
        };
        let elements = new.values.chunks_exact(new.lanes).enumerate();
        let elements = elements.map(|(i, element)| (Some(i), element));
        let written = self.patched.overwrite(view, accessor.offset(), layout.stride, elements);
        if written.is_some() {
            self.patched.set_bounds(index, new.values, new.lanes, false);
        }
        written.is_some()
    }
}

/// How often each accessor is named.
fn accessor_uses(doc: &GltfDocument<'_>) -> Vec<u32> {
    let mut uses = vec![0; doc.accessors.len()];
    let in_meshes = doc.items(&doc.meshes).flat_map(|text| IN_MESH.accessors(text));
    for index in in_meshes.chain(accessors_beside_meshes(doc)) {
        if let Some(uses) = uses.get_mut(index) {
            *uses += 1;
        }
    }
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
    for (animation, text) in doc.items(&doc.animations).enumerate() {
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
    let path = string_of(target, "path")?;
    let (node, path) = if path == "pointer" {
        let extension = value_at(target, &["extensions", "KHR_animation_pointer"])?;
        let pointer = string_of(extension, "pointer")?;
        let (node, path) = pointer.strip_prefix("/nodes/")?.split_once('/')?;
        (node.parse().ok()?, path.to_owned())
    } else {
        (index_of(target, "node")?, path)
    };
    let is_rotation = path == "rotation";
    (is_rotation || path == "translation").then_some(ClipTarget { node, is_rotation })
}

/// Whether a clip moves or turns any node. Others, such as those of morph weights alone, never change.
fn moves_nodes(animation: &str) -> bool {
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

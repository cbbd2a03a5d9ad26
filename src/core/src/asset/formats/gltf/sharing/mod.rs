//! Which places of a file are used by several, and so must part when they are to become different.
//!
//! A mesh under several nodes parts when the nodes want different shapes: the first node keeps it, the others get
//! copies. An accessor is overwritten only when everyone who uses it, and everyone whose bytes it touches, wants the
//! same; else the changed users get an accessor of their own.

use super::accessors::{AccessorLayout, ComponentType, ShapeAttribute};
use super::buffers::BufferBytes;
use super::deformed::{ChangedAttribute, DeformedAttributes};
use super::document::GltfDocument;
use super::read::GltfNotes;
use super::text;
use crate::asset::Geometry;
use indices::{member_index, parse_index};
use std::collections::{BTreeMap, BTreeSet};

mod bytes;
mod indices;
mod mesh_ref;
mod variants;

pub(super) use mesh_ref::MeshRef;
pub(super) use variants::MeshCopy;

/// An accessor whose bytes are overwritten where they are.
pub(super) struct AccessorOverwrite {
    pub(super) accessor: usize,
    pub(super) role: ShapeAttribute,
    pub(super) channel: ChangedAttribute,
}

/// A new accessor and the attributes that are pointed at it.
pub(super) struct AppendedAccessor {
    pub(super) role: ShapeAttribute,
    pub(super) values: Vec<f32>,
    pub(super) users: Vec<(MeshRef, usize)>,
}

/// Everything that is to be changed.
#[derive(Default)]
pub(super) struct SharingPlan {
    pub(super) overwrites: Vec<AccessorOverwrite>,
    pub(super) appends: Vec<AppendedAccessor>,
    pub(super) copies: Vec<MeshCopy>,
    /// Primitives whose compressed twin no longer tells the truth.
    pub(super) stale_draco: BTreeSet<(MeshRef, usize)>,
}

impl SharingPlan {
    pub(super) fn is_empty(&self) -> bool {
        self.overwrites.is_empty() && self.appends.is_empty() && self.copies.is_empty()
    }
}

/// One attribute that is to become something else.
struct AttributeChange {
    mesh: MeshRef,
    primitive: usize,
    role: ShapeAttribute,
    channel: ChangedAttribute,
    row: usize,
}

/// Changes that agree wherever they are looked at.
struct ChangeGroup {
    role: ShapeAttribute,
    channel: ChangedAttribute,
    /// Vertices on whose value a member insists; empty when nobody else uses the accessor.
    claimed: Vec<bool>,
    users: Vec<(MeshRef, usize)>,
}

/// Decides what is overwritten and what parts.
pub(super) fn plan_overwrites(
    doc: &GltfDocument<'_>,
    buffers: &BufferBytes,
    notes: &GltfNotes,
    rest: &Geometry,
    mut wanted: Vec<DeformedAttributes>,
) -> SharingPlan {
    let mut plan = SharingPlan::default();
    if !wanted.iter().any(DeformedAttributes::is_changed) {
        return plan;
    }
    let variants = variants::divide_meshes(doc, notes, &wanted);
    let uses = AccessorUses::collect(doc, &variants, &wanted);
    plan.copies = variants.copies;

    let mut by_accessor: BTreeMap<usize, Vec<AttributeChange>> = BTreeMap::new();
    for (mesh, row) in variants.changed_rows {
        let at = &notes.rows[row];
        let primitive = &doc.meshes.values[at.mesh].primitives[at.primitive];
        for (role, channel) in ShapeAttribute::ALL.into_iter().zip(&mut wanted[row].0) {
            let (Some(accessor), Some(channel)) = (primitive.attribute(role.name()), channel.take()) else {
                continue;
            };
            if primitive.has_draco() {
                plan.stale_draco.insert((mesh, at.primitive));
            }
            let change = AttributeChange {
                mesh,
                primitive: at.primitive,
                role,
                channel,
                row,
            };
            by_accessor.entry(accessor).or_default().push(change);
        }
    }
    let referenced = |row: usize| referenced_vertices(notes, rest, row);
    let mut neighbours = None;
    for (accessor, changes) in by_accessor {
        let still = uses.still.get(&accessor).map_or(&[][..], Vec::as_slice);
        let one_role = changes.iter().all(|c| c.role == changes[0].role);
        let mut groups = group_changes(changes, !still.is_empty(), &referenced);
        let in_place = one_role
            && !uses.strangers.contains(&accessor)
            && still.iter().all(|&row| agrees_at_rest(&groups[0], &referenced(row)))
            && is_writable(doc, buffers, accessor, groups[0].role)
            && neighbours
                .get_or_insert_with(|| bytes::ByteSpans::collect(doc))
                .is_alone(accessor);
        if in_place {
            let first = groups.remove(0);
            plan.overwrites.push(AccessorOverwrite {
                accessor,
                role: first.role,
                channel: first.channel,
            });
        }
        let appends = groups.into_iter().map(|g| AppendedAccessor {
            role: g.role,
            values: g.channel.values,
            users: g.users,
        });
        plan.appends.extend(appends);
    }
    plan
}

/// How many groups a change is compared with before it gets its own, when it is equal to none.
const MOST_COMPARED: usize = 16;

/// Puts changes of one accessor together as far as they agree, in order.
fn group_changes(
    changes: Vec<AttributeChange>,
    shared: bool,
    referenced: &impl Fn(usize) -> Vec<bool>,
) -> Vec<ChangeGroup> {
    let alone = changes.len() == 1 && !shared;
    let mut groups: Vec<ChangeGroup> = Vec::new();
    let mut equal: BTreeMap<u64, usize> = BTreeMap::new();
    for change in changes {
        let user = (change.mesh, change.primitive);
        let claimed = if alone {
            Vec::new()
        } else {
            claimed_vertices(&change.channel, referenced(change.row))
        };
        let fingerprint = change.channel.fingerprint();
        let candidates = equal
            .get(&fingerprint)
            .copied()
            .into_iter()
            .chain(0..groups.len().min(MOST_COMPARED));
        let found = candidates
            .into_iter()
            .find(|&i| groups[i].role == change.role && groups[i].agrees_with(&change.channel, &claimed));
        match found {
            Some(i) => {
                groups[i].take_in(&change.channel, &claimed);
                groups[i].users.push(user);
            }
            None => {
                equal.insert(fingerprint, groups.len());
                groups.push(ChangeGroup {
                    role: change.role,
                    channel: change.channel,
                    claimed,
                    users: vec![user],
                });
            }
        }
    }
    groups
}

fn claimed_vertices(channel: &ChangedAttribute, mut referenced: Vec<bool>) -> Vec<bool> {
    referenced
        .iter_mut()
        .zip(&channel.changed)
        .for_each(|(claim, changed)| *claim |= changed);
    referenced
}

impl ChangeGroup {
    fn vertex_values<'c>(&self, channel: &'c ChangedAttribute, i: usize) -> &'c [f32] {
        let lanes = self.role.lanes();
        &channel.values[i * lanes..][..lanes]
    }

    fn agrees_with(&self, other: &ChangedAttribute, claimed: &[bool]) -> bool {
        let same = |i| {
            let bits = |c| self.vertex_values(c, i).iter().map(|v| v.to_bits());
            bits(&self.channel).eq(bits(other))
        };
        (0..claimed.len()).all(|i| !(claimed[i] && self.claimed[i]) || same(i))
    }

    fn take_in(&mut self, other: &ChangedAttribute, claimed: &[bool]) {
        let lanes = self.role.lanes();
        for i in (0..claimed.len()).filter(|&i| claimed[i]) {
            let values = self.vertex_values(other, i);
            self.channel.values[i * lanes..][..lanes].copy_from_slice(values);
            self.channel.changed[i] |= other.changed[i];
            self.claimed[i] = true;
        }
    }
}

/// Whether a user who wants nothing changed sees no change.
fn agrees_at_rest(group: &ChangeGroup, referenced: &[bool]) -> bool {
    group
        .channel
        .changed
        .iter()
        .zip(referenced)
        .all(|(changed, referenced)| !(*changed && *referenced))
}

/// Which vertices of a row its triangles use.
fn referenced_vertices(notes: &GltfNotes, rest: &Geometry, row: usize) -> Vec<bool> {
    let row = &notes.rows[row];
    let mut used = vec![false; row.vertices.len()];
    for v in rest.triangles[row.triangles.clone()].iter().flatten() {
        used[*v as usize - row.vertices.start] = true;
    }
    used
}

/// Who uses accessors without wanting to change them.
#[derive(Default)]
struct AccessorUses {
    /// Rows that want their stored values, by accessor.
    still: BTreeMap<usize, Vec<usize>>,
    /// Accessors that something else uses: other attributes, morph targets, indices, primitives that are no rows,
    /// animations, skins, instances.
    strangers: BTreeSet<usize>,
}

impl AccessorUses {
    fn collect(doc: &GltfDocument<'_>, variants: &variants::MeshVariants, wanted: &[DeformedAttributes]) -> Self {
        let mut uses = Self::default();
        for (m, mesh) in doc.meshes.values.iter().enumerate() {
            for (p, primitive) in mesh.primitives.iter().enumerate() {
                uses.strangers.extend(primitive.indices.map(|i| i.index()));
                uses.strangers
                    .extend(primitive.targets.iter().flat_map(|t| t.values()).map(|a| a.index()));
                let rows = variants.rows_of.get(&(m, p));
                for (name, accessor) in &primitive.attributes {
                    match (ShapeAttribute::ALL.iter().position(|r| r.name() == name), rows) {
                        (Some(role), Some(rows)) => {
                            let still = rows
                                .iter()
                                .filter(|&&row| variants.is_also_unchanged(row) || wanted[row].0[role].is_none());
                            uses.still.entry(accessor.index()).or_default().extend(still);
                        }
                        _ => drop(uses.strangers.insert(accessor.index())),
                    }
                }
            }
        }
        for animation in &doc.animations {
            let samplers = text::value_of(animation, "samplers")
                .and_then(|s| text::items(s).ok())
                .unwrap_or_default();
            for sampler in samplers {
                uses.strangers
                    .extend(["input", "output"].iter().filter_map(|key| member_index(sampler, key)));
            }
        }
        uses.strangers.extend(
            doc.skins
                .iter()
                .filter_map(|skin| member_index(skin, "inverseBindMatrices")),
        );
        for node in &doc.nodes.items {
            let instances = text::value_of(node, "extensions")
                .and_then(|e| text::value_of(e, "EXT_mesh_gpu_instancing"))
                .and_then(|e| text::value_of(e, "attributes"));
            let attributes = instances.and_then(|a| text::members(a).ok()).unwrap_or_default();
            uses.strangers
                .extend(attributes.iter().filter_map(|m| parse_index(m.value)));
        }
        uses
    }
}

/// Whether the accessor's own bytes can hold new floats.
fn is_writable(doc: &GltfDocument<'_>, buffers: &BufferBytes, index: usize, role: ShapeAttribute) -> bool {
    let accessor = &doc.accessors.values[index];
    let Some(view) = accessor.buffer_view.and_then(|v| doc.views.get(v.index())) else {
        return false;
    };
    let is_float = AccessorLayout::of(accessor, &doc.views.values)
        .is_some_and(|l| l.component == ComponentType::F32 && l.lanes == role.lanes());
    let buffer = view.buffer.index();
    is_float
        && accessor.sparse.is_none()
        && view.compression().is_none()
        && buffers.is_exclusive(buffer)
        && !doc.buffers.values[buffer].is_fallback()
}

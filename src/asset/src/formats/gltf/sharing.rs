//! Which parts of a file are shared, and so must be copied before they become different.
//!
//! When several nodes of one mesh get different shapes, the first node keeps the mesh and the others get copies. An
//! accessor is overwritten only when all attributes that use it or share its bytes become the same; else the changed
//! ones get an accessor of their own.

use super::accessors::{ComponentType, ShapeAttribute};
use super::document::GltfDocument;
use super::read::GltfNotes;
use super::references::accessors_beside_meshes;
use super::schema::WholeNumber;
use super::targets::{AttributeSlot, ChangedAttribute, DeformedAttributes};
use crate::Geometry;
use std::collections::{BTreeMap, BTreeSet};

/// An accessor whose bytes are overwritten where they are.
pub(super) struct AccessorOverwrite {
    pub(super) accessor: usize,
    pub(super) slot: AttributeSlot,
    pub(super) channel: ChangedAttribute,
    /// The elements that its sparse values replace, when it is these that hold what changed.
    pub(super) sparse: Option<Vec<usize>>,
}

/// A new accessor and the attributes that are pointed at it.
pub(super) struct AppendedAccessor {
    pub(super) values: Vec<f32>,
    /// The attributes, which all mean the same: meshes, primitives and slots.
    pub(super) users: Vec<AttributeUser>,
}

/// One attribute of one primitive of a mesh.
pub(super) type AttributeUser = (MeshRef, usize, AttributeSlot);

/// Everything that is to be changed.
#[derive(Default)]
pub(super) struct SharingPlan {
    pub(super) overwrites: Vec<AccessorOverwrite>,
    pub(super) appends: Vec<AppendedAccessor>,
    pub(super) copies: Vec<MeshCopy>,
    /// Primitives whose Draco copy is stale.
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
    slot: AttributeSlot,
    channel: ChangedAttribute,
    row: usize,
}

/// Changes that agree wherever they are looked at.
struct ChangeGroup {
    channel: ChangedAttribute,
    /// Vertices whose value a member needs; empty when nothing else uses the accessor.
    claimed: Vec<bool>,
    /// At least one.
    users: Vec<AttributeUser>,
}

/// Decides what is overwritten and copied.
pub(super) fn plan_overwrites(
    doc: &GltfDocument<'_>,
    notes: &GltfNotes,
    rest: &Geometry,
    mut wanted: Vec<DeformedAttributes>,
) -> SharingPlan {
    let mut plan = SharingPlan::default();
    if !wanted.iter().any(DeformedAttributes::is_changed) {
        return plan;
    }
    let variants = divide_meshes(doc, notes, &wanted);
    let uses = AccessorUses::collect(doc, &variants, &wanted);
    plan.copies = variants.copies;

    let mut by_accessor: BTreeMap<usize, Vec<AttributeChange>> = BTreeMap::new();
    for (mesh, row) in variants.changed_rows {
        let at = &notes.rows[row];
        let primitive = &doc.meshes.values[at.mesh].primitives[at.primitive];
        for (slot, channel) in std::mem::take(&mut wanted[row].0) {
            let Some(accessor) = slot.accessor(primitive) else {
                continue;
            };
            if primitive.has_draco() && slot.target.is_none() {
                plan.stale_draco.insert((mesh, at.primitive));
            }
            let change = AttributeChange {
                mesh,
                primitive: at.primitive,
                slot,
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
        let slot = changes[0].slot;
        let is_agreed = changes.iter().all(|c| c.slot.is_alike(slot)) && !uses.strangers.contains(&accessor);
        let mut groups = group_changes(changes, !still.is_empty(), &referenced);
        let is_agreed = is_agreed && still.iter().all(|&row| agrees_at_rest(&groups[0], &referenced(row)));
        let in_place = if !is_agreed {
            None
        } else {
            let spans = neighbours.get_or_insert_with(|| super::used_bytes::ByteSpans::collect(doc));
            if is_writable(doc, accessor, slot) && spans.is_alone(accessor) {
                Some(None)
            } else {
                writable_sparse_elements(doc, accessor, &groups[0])
                    .filter(|_| spans.is_sparse_alone(doc, accessor))
                    .map(Some)
            }
        };
        if let Some(sparse) = in_place {
            let first = groups.remove(0);
            plan.overwrites.push(AccessorOverwrite {
                accessor,
                slot,
                channel: first.channel,
                sparse,
            });
        }
        let appends = groups.into_iter().map(|g| AppendedAccessor {
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
        let user = (change.mesh, change.primitive, change.slot);
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
            .find(|&i| groups[i].slot().is_alike(change.slot) && groups[i].agrees_with(&change.channel, &claimed));
        match found {
            Some(i) => {
                groups[i].take_in(&change.channel, &claimed);
                groups[i].users.push(user);
            }
            None => {
                equal.insert(fingerprint, groups.len());
                groups.push(ChangeGroup {
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
    /// What all its users take it for.
    fn slot(&self) -> AttributeSlot {
        self.users[0].2
    }

    fn vertex_values<'c>(&self, channel: &'c ChangedAttribute, i: usize) -> &'c [f32] {
        let lanes = self.slot().lanes();
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
        let lanes = self.slot().lanes();
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
    /// Accessors that something else uses: other attributes, indices, primitives that are no rows, animations, skins, instances.
    strangers: BTreeSet<usize>,
}

impl AccessorUses {
    fn collect(doc: &GltfDocument<'_>, variants: &MeshVariants, wanted: &[DeformedAttributes]) -> Self {
        let mut uses = Self::default();
        for (m, mesh) in doc.meshes.values.iter().enumerate() {
            for (p, primitive) in mesh.primitives.iter().enumerate() {
                uses.strangers.extend(primitive.indices.map(|i| i.index()));
                let rows = variants.rows_of.get(&(m, p));
                let own = primitive.attributes.iter().map(|(name, a)| (None, name, a));
                let of_targets = primitive.targets.iter().enumerate();
                let of_targets = of_targets.flat_map(|(t, all)| all.iter().map(move |(name, a)| (Some(t), name, a)));
                for (target, name, accessor) in own.chain(of_targets) {
                    let role = ShapeAttribute::of_name(name);
                    let slot = role.map(|role| AttributeSlot { target, role });
                    match (slot, rows) {
                        (Some(slot), Some(rows)) => {
                            let still = rows
                                .iter()
                                .filter(|&&row| variants.is_also_unchanged(row) || wanted[row].of(slot).is_none());
                            uses.still.entry(accessor.index()).or_default().extend(still);
                        }
                        _ => drop(uses.strangers.insert(accessor.index())),
                    }
                }
            }
        }
        uses.strangers.extend(accessors_beside_meshes(doc));
        uses
    }
}

/// Whether the accessor's own bytes can hold new floats.
fn is_writable(doc: &GltfDocument<'_>, index: usize, slot: AttributeSlot) -> bool {
    let accessor = &doc.accessors.values[index];
    let holds_floats = |view: WholeNumber| takes_floats(doc, index, view, slot);
    accessor.sparse.is_none() && accessor.buffer_view.is_some_and(holds_floats)
}

/// The elements of which an accessor's sparse values can take what changed, when they can take all of it: the usual case
/// for morph targets, where what is zero stays zero.
fn writable_sparse_elements(doc: &GltfDocument<'_>, index: usize, group: &ChangeGroup) -> Option<Vec<usize>> {
    let sparse = doc.accessors.values[index].sparse.as_ref()?;
    if !takes_floats(doc, index, sparse.values.buffer_view, group.slot()) {
        return None;
    }
    let elements = doc.sparse_indices(index).ok()?;
    let changed = group
        .channel
        .changed
        .iter()
        .enumerate()
        .filter(|(_, changed)| **changed);
    let mut changed = changed.map(|(i, _)| i);
    changed.all(|i| elements.binary_search(&i).is_ok()).then_some(elements)
}

/// Whether the bytes of a view of an accessor can hold new floats.
fn takes_floats(doc: &GltfDocument<'_>, accessor: usize, view: WholeNumber, slot: AttributeSlot) -> bool {
    let layout = doc.layout(accessor);
    let is_float = layout.is_some_and(|l| l.component == ComponentType::F32 && l.lanes == slot.lanes());
    let view = doc.views.get(view.index());
    is_float && view.is_some_and(|view| doc.takes_floats(view))
}

/// A mesh of the document, or the n-th copy to be appended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum MeshRef {
    Original(usize),
    Copy(usize),
}

/// A copy of a mesh, to be appended.
pub(super) struct MeshCopy {
    /// The mesh it starts from.
    pub(super) of: usize,
    /// The nodes that are pointed at it.
    pub(super) nodes: Vec<usize>,
}

/// The shapes that each mesh is wanted in.
pub(super) struct MeshVariants {
    pub(super) copies: Vec<MeshCopy>,
    /// Rows with changes, each with the mesh that shows them; one row for every shape.
    pub(super) changed_rows: Vec<(MeshRef, usize)>,
    /// Rows that stand for the shapes of each (mesh, primitive): one per shape.
    pub(super) rows_of: BTreeMap<(usize, usize), Vec<usize>>,
    /// Rows that also stand for the rest shape, which nodes outside the scene draw.
    staying: BTreeSet<usize>,
}

impl MeshVariants {
    /// Whether a row also stands for nodes with the rest shape.
    pub(super) fn is_also_unchanged(&self, row: usize) -> bool {
        self.staying.contains(&row)
    }
}

/// Finds the shapes of every mesh. Nodes that want the same shape share it.
pub(super) fn divide_meshes(doc: &GltfDocument<'_>, notes: &GltfNotes, wanted: &[DeformedAttributes]) -> MeshVariants {
    let mut variants = MeshVariants {
        copies: Vec::new(),
        changed_rows: Vec::new(),
        rows_of: BTreeMap::new(),
        staying: BTreeSet::new(),
    };
    // A node may have rows at two places: those of points and lines come after all those of triangles.
    let mut rows_of_node: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, row) in notes.rows.iter().enumerate() {
        rows_of_node.entry(row.node).or_default().push(i);
    }
    let mut nodes_of: BTreeMap<usize, Vec<(usize, Vec<usize>)>> = BTreeMap::new();
    for row in &notes.rows {
        if let Some(rows) = rows_of_node.remove(&row.node) {
            nodes_of.entry(row.mesh).or_default().push((row.node, rows));
        }
    }
    let mut outsiders: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, node) in doc.nodes.values.iter().enumerate() {
        if let Some(mesh) = node.mesh.filter(|_| notes.placed.binary_search(&i).is_err()) {
            outsiders.entry(mesh.index()).or_default().push(i);
        }
    }
    for (mesh, nodes) in nodes_of {
        let outside = outsiders.remove(&mesh).unwrap_or_default();
        variants.add_variants(notes, wanted, mesh, nodes, outside);
    }
    variants
}

impl MeshVariants {
    fn add_variants(
        &mut self,
        notes: &GltfNotes,
        wanted: &[DeformedAttributes],
        mesh: usize,
        nodes: Vec<(usize, Vec<usize>)>,
        outside: Vec<usize>,
    ) {
        let same = |a: &[usize], b: &[usize]| a.iter().zip(b).all(|(&a, &b)| wanted[a].is_same(&wanted[b]));
        let at_rest = |rows: &[usize]| !rows.iter().any(|&row| wanted[row].is_changed());
        // The first node of the scene keeps the mesh, whatever shape it wants.
        let mut shapes: Vec<(Vec<usize>, Vec<usize>)> = Vec::new();
        // Thousands of instances may each have a shape of their own.
        let mut known: BTreeMap<Vec<u64>, Vec<usize>> = BTreeMap::new();
        for (node, rows) in nodes {
            let alike = known
                .entry(rows.iter().map(|&row| wanted[row].fingerprint()).collect())
                .or_default();
            match alike.iter().find(|&&i| same(&shapes[i].0, &rows)) {
                Some(&i) => shapes[i].1.push(node),
                None => {
                    alike.push(shapes.len());
                    shapes.push((rows, vec![node]));
                }
            }
        }
        // Nodes outside the scene were not deformed.
        let mut rest_copy = None;
        if !outside.is_empty() {
            match shapes.iter_mut().find(|(shape, _)| at_rest(shape)) {
                Some((_, users)) => users.extend(outside),
                None => rest_copy = Some(outside),
            }
        }
        for (i, (rows, users)) in shapes.into_iter().enumerate() {
            let at = if i == 0 {
                MeshRef::Original(mesh)
            } else {
                self.copies.push(MeshCopy { of: mesh, nodes: users });
                MeshRef::Copy(self.copies.len() - 1)
            };
            for row in rows {
                self.rows_of
                    .entry((mesh, notes.rows[row].primitive))
                    .or_default()
                    .push(row);
                if wanted[row].is_changed() {
                    self.changed_rows.push((at, row));
                }
                if i == 0 && rest_copy.is_some() {
                    self.staying.insert(row);
                }
            }
        }
        if let Some(nodes) = rest_copy {
            self.copies.push(MeshCopy { of: mesh, nodes });
        }
    }
}

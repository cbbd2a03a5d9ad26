//! Attributes that follow a deformation, of primitives and of their morph targets, and displacements carried along with the surface.

use super::accessors::{ComponentType, ShapeAttribute};
use super::document::GltfDocument;
use super::placement::VertexTransforms;
use super::schema::MeshPrimitive;
use crate::files::within;
use crate::{Error, FollowedCounts};
use glam::{DMat3, Vec3};
use pliant_mesh::local_turns::LocalTurn;
use std::collections::BTreeMap;
use std::hash::{Hash as _, Hasher as _};

/// An attribute of a primitive or of one of its morph targets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct AttributeSlot {
    /// The morph target; `None` for the primitive itself.
    pub(super) target: Option<usize>,
    pub(super) role: ShapeAttribute,
}

impl AttributeSlot {
    /// An attribute of the primitive itself.
    pub(super) fn own(role: ShapeAttribute) -> Self {
        Self { target: None, role }
    }

    /// Numbers per vertex. The displacement of a tangent has no handedness.
    pub(super) fn lanes(self) -> usize {
        if self.target.is_some() { 3 } else { self.role.lanes() }
    }

    /// The accessor type's name.
    pub(super) fn shape(self) -> &'static str {
        if self.target.is_some() {
            "VEC3"
        } else {
            self.role.shape()
        }
    }

    /// Whether two slots may have one accessor in common: the same numbers with the same meaning.
    pub(super) fn is_alike(self, other: Self) -> bool {
        self.role == other.role && self.target.is_some() == other.target.is_some()
    }

    /// The slot's accessor in a primitive.
    pub(super) fn accessor(self, primitive: &MeshPrimitive) -> Option<usize> {
        match self.target {
            None => primitive.attribute(self.role.name()),
            Some(target) => Some(primitive.targets.get(target)?.get(self.role.name())?.index()),
        }
    }
}

/// The slots that the morph targets of a primitive fill, target by target.
pub(super) fn target_slots(primitive: &MeshPrimitive) -> Vec<AttributeSlot> {
    let of_target = |target: usize| {
        ShapeAttribute::ALL.map(|role| AttributeSlot {
            target: Some(target),
            role,
        })
    };
    let all = (0..primitive.targets.len()).flat_map(of_target);
    all.filter(|slot| slot.accessor(primitive).is_some()).collect()
}

/// New values of one attribute, all elements, lane by lane.
#[derive(Debug, Clone)]
pub(super) struct ChangedAttribute {
    pub(super) values: Vec<f32>,
    /// Which elements differ from the stored ones.
    pub(super) changed: Vec<bool>,
}

impl ChangedAttribute {
    pub(super) fn where_changed(stored: &[f32], values: Vec<f32>, lanes: usize) -> Option<Self> {
        let differ = |(a, b): (&[f32], &[f32])| a.iter().zip(b).any(|(a, b)| a.to_bits() != b.to_bits());
        let changed: Vec<bool> = stored
            .chunks_exact(lanes)
            .zip(values.chunks_exact(lanes))
            .map(differ)
            .collect();
        changed.contains(&true).then_some(Self { values, changed })
    }

    /// Equal for what is the same, nearly always different for what is not.
    pub(super) fn fingerprint(&self) -> u64 {
        let mut hasher = std::hash::DefaultHasher::new();
        self.values.iter().for_each(|v| hasher.write_u32(v.to_bits()));
        hasher.finish()
    }

    /// Whether two attributes become the same.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.values.len() == other.values.len()
            && self
                .values
                .iter()
                .zip(&other.values)
                .all(|(a, b)| a.to_bits() == b.to_bits())
    }
}

/// What one row of the primitive table should become: the slots that change, in order.
#[derive(Debug, Clone, Default)]
pub(super) struct DeformedAttributes(pub(super) Vec<(AttributeSlot, ChangedAttribute)>);

impl DeformedAttributes {
    pub(super) fn is_changed(&self) -> bool {
        !self.0.is_empty()
    }

    /// What a slot becomes; `None` when it stays as it is stored.
    pub(super) fn of(&self, slot: AttributeSlot) -> Option<&ChangedAttribute> {
        let at = self.0.binary_search_by_key(&slot, |(slot, _)| *slot).ok()?;
        Some(&self.0[at].1)
    }

    /// Equal for what is the same, nearly always different for what is not.
    pub(super) fn fingerprint(&self) -> u64 {
        let mut hasher = std::hash::DefaultHasher::new();
        for (slot, change) in &self.0 {
            slot.hash(&mut hasher);
            change.values.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        }
        hasher.finish()
    }

    pub(super) fn is_same(&self, other: &Self) -> bool {
        let pairs = || self.0.iter().zip(&other.0);
        self.0.len() == other.0.len() && pairs().all(|(a, b)| a.0 == b.0 && a.1.is_same(&b.1))
    }
}

/// How many bytes of displacements are carried for one file. Targets may be sparse or share their numbers, so that
/// their size is not bounded by the file's.
const MOST_CARRIED: u64 = 2 << 30;

/// Whether any mesh of a document has morph targets.
pub(super) fn has_targets(doc: &GltfDocument<'_>) -> bool {
    let mut primitives = doc.meshes.values.iter().flat_map(|mesh| &mesh.primitives);
    primitives.any(|primitive| !primitive.targets.is_empty())
}

/// Counts the displacements that are carried, and which targets have some.
#[derive(Default)]
pub(super) struct TargetTally {
    spent: u64,
    /// For each node of a base that draws targets, which of them were carried.
    carried: BTreeMap<(u32, usize), Vec<bool>>,
}

impl TargetTally {
    /// Counts the targets of a primitive that a node of a base draws.
    pub(super) fn meet(&mut self, base: u32, node: usize, primitive: &MeshPrimitive) {
        let targets = primitive.targets.len();
        if targets > 0 {
            let known = self.carried.entry((base, node)).or_default();
            known.resize(known.len().max(targets), false);
        }
    }

    /// Counts a target as carried that has been met.
    pub(super) fn carry(&mut self, base: u32, node: usize, target: usize) {
        let known = self.carried.get_mut(&(base, node));
        if let Some(carried) = known.and_then(|known| known.get_mut(target)) {
            *carried = true;
        }
    }

    /// Adds what was met and carried to the counts of a file.
    pub(super) fn count_into(&self, counts: &mut FollowedCounts) {
        let number = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        counts.morph_targets = number(self.carried.values().flatten().count());
        counts.carried_morph_targets = number(self.carried.values().flatten().filter(|c| **c).count());
    }

    /// Refuses more than is carried for one file.
    pub(super) fn spend(&mut self, vertices: usize) -> Result<(), Error> {
        self.spent = self.spent.saturating_add(12 * vertices as u64);
        within("number of bytes of morph targets that follow", self.spent, MOST_CARRIED)
    }
}

/// Carries the targets of one primitive.
pub(super) struct TargetCarrier<'a> {
    /// How the surface turned around each vertex.
    pub(super) turns: &'a [Option<LocalTurn>],
    /// How stored displacements get into the world, and how back.
    pub(super) world_from_old: &'a VertexTransforms,
    pub(super) new_from_world: &'a VertexTransforms,
}

impl TargetCarrier<'_> {
    /// What the targets of a primitive become.
    pub(super) fn changes(
        &self,
        doc: &GltfDocument<'_>,
        primitive: &MeshPrimitive,
        tally: &mut TargetTally,
    ) -> Result<Vec<(AttributeSlot, ChangedAttribute)>, Error> {
        let mut changes = Vec::new();
        if self.turns.iter().all(Option::is_none) {
            return Ok(changes);
        }
        for slot in target_slots(primitive) {
            tally.spend(self.turns.len())?;
            if let Some(accessor) = slot.accessor(primitive)
                && let Some(stored) = read_displacements(doc, accessor)?
                && let Some(change) = ChangedAttribute::where_changed(&stored, self.carried(slot.role, &stored), 3)
            {
                changes.push((slot, change));
            }
        }
        Ok(changes)
    }

    /// Displacements after the turn; zeros and those of vertices that did not turn stay bit for bit.
    fn carried(&self, role: ShapeAttribute, stored: &[f32]) -> Vec<f32> {
        let mut values = stored.to_vec();
        for (i, (place, turn)) in values.as_chunks_mut::<3>().0.iter_mut().zip(self.turns).enumerate() {
            let Some(turn) = turn.filter(|_| *place != [0.0; 3]) else {
                continue;
            };
            let (old, new) = (&self.world_from_old.at(i).matrix3, &self.new_from_world.at(i).matrix3);
            let moved = displacement_map(role, &turn, old, new) * Vec3::from_array(*place).as_dvec3();
            if moved.as_vec3().is_finite() {
                *place = moved.as_vec3().to_array();
            }
        }
        values
    }
}

/// What takes a stored displacement to the one that says the same of the surface after it has turned. `world_from_old` and
/// `new_from_world` are the linear parts of the vertex's placement before, and of the way back after.
pub(super) fn displacement_map(
    role: ShapeAttribute,
    turn: &LocalTurn,
    world_from_old: &DMat3,
    new_from_world: &DMat3,
) -> DMat3 {
    // Unit vectors keep their length whatever the scale of the mesh's space.
    let size = |m: &DMat3| libm::cbrt(m.determinant().abs());
    match role {
        ShapeAttribute::Position => *new_from_world * turn.similarity() * *world_from_old,
        ShapeAttribute::Tangent => {
            let unit = 1.0 / (size(world_from_old) * size(new_from_world));
            *new_from_world * turn.turn * *world_from_old * unit
        }
        ShapeAttribute::Normal => {
            let (old, new) = (
                world_from_old.inverse().transpose(),
                new_from_world.inverse().transpose(),
            );
            new * turn.turn * old * (size(world_from_old) * size(new_from_world))
        }
        // Morph targets hold none of these.
        ShapeAttribute::SplatTurn | ShapeAttribute::SplatScale | ShapeAttribute::SplatHarmonic(_) => DMat3::IDENTITY,
    }
}

/// The displacements of a target as floats; `None` for what is stored in a way that only some extension knows.
pub(super) fn read_displacements(doc: &GltfDocument<'_>, accessor: usize) -> Result<Option<Vec<f32>>, Error> {
    let layout = doc.layout(accessor);
    let layout = layout.filter(|l| l.lanes == 3 && l.component != ComponentType::U32);
    layout.map(|layout| doc.read_values(accessor, layout)).transpose()
}

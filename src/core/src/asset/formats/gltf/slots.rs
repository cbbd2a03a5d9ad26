//! The places of a primitive that follow a deformation: its own attributes, and those of its morph targets.

use super::accessors::ShapeAttribute;
use super::schema::MeshPrimitive;

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

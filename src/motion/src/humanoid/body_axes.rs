//! Which way a figure stands and faces in the space of its file.

use crate::signed_axis::SignedAxis;
use glam::{DMat3, DVec3};

/// How a figure stands: its vertical, and where it faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BodyAxes {
    /// From feet to head.
    pub up: SignedAxis,
    /// Where the chest and the toes point; another axis than `up`.
    pub front: SignedAxis,
}

impl BodyAxes {
    /// How figures stand in most files: y up, facing along z.
    pub const USUAL: Self = Self {
        up: SignedAxis::Y,
        front: SignedAxis::new(2, false),
    };

    /// From model space to a space where the figure's left is x, its head y, and its face z.
    pub fn upright_from_model(self) -> DMat3 {
        let [up, front] = [self.up.direction(), self.front.direction()];
        DMat3::from_cols(up.cross(front), up, front).transpose()
    }

    pub(super) fn reversed(self) -> Self {
        Self {
            front: self.front.reversed(),
            ..self
        }
    }

    /// All that agree with what is given, one for each vertical and each axis along which the figure faces: the likeliest first.
    /// Of the two directions along an axis, the one that is usual in files with that vertical stands for both.
    pub(super) fn candidates(up: Option<SignedAxis>, front: Option<SignedAxis>) -> Vec<Self> {
        let verticals = [(1, false), (2, false), (0, false), (1, true), (2, true), (0, true)];
        let mut all = Vec::new();
        for own in verticals.map(|(axis, is_negative)| SignedAxis::new(axis, is_negative)) {
            if up.is_some_and(|up| up != own) {
                continue;
            }
            // With z up, figures face along -y in most programs.
            let usual = match own.axis {
                1 => [(2, false), (0, false)],
                2 => [(1, true), (0, false)],
                _ => [(2, false), (1, true)],
            };
            let usual = usual.map(|(axis, is_negative)| SignedAxis::new(axis, is_negative));
            match front {
                Some(front) if front.axis == own.axis => {}
                Some(front) => all.push(Self { up: own, front }),
                None => all.extend(usual.map(|front| Self { up: own, front })),
            }
        }
        all
    }

    /// What joints say whose left and right, top and bottom are known; `None` where they say nothing.
    pub(super) fn of_directions(up: DVec3, left: DVec3) -> Option<Self> {
        let up = SignedAxis::nearest(up.try_normalize()?);
        let front = left.try_normalize()?.cross(up.direction());
        let front = front - up.direction() * front.dot(up.direction());
        (front.length() > 0.1).then(|| Self {
            up,
            front: SignedAxis::nearest(front),
        })
    }
}

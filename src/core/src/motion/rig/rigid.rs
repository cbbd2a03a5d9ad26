//! Rigid motions as a turn about a point that goes somewhere.

use glam::{DQuat, DVec3};

/// Takes a point x to R (x − from) + to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidMotion {
    /// R, of unit length.
    pub rotation: DQuat,
    /// The point about which it turns, before.
    pub from: DVec3,
    /// Where that point goes.
    pub to: DVec3,
}

impl RigidMotion {
    /// Leaves everything where it is.
    pub const IDENTITY: Self = Self {
        rotation: DQuat::IDENTITY,
        from: DVec3::ZERO,
        to: DVec3::ZERO,
    };

    /// Where a point goes.
    pub fn place(&self, point: DVec3) -> DVec3 {
        self.rotation * (point - self.from) + self.to
    }

    /// Where a point comes from.
    pub fn place_back(&self, point: DVec3) -> DVec3 {
        self.rotation.inverse() * (point - self.to) + self.from
    }

    /// This motion, and then another.
    #[must_use]
    pub fn followed_by(&self, next: &Self) -> Self {
        Self {
            rotation: (next.rotation * self.rotation).normalize(),
            from: self.from,
            to: next.place(self.to),
        }
    }

    /// The motion as a point moved along with `frame` sees it: first this one, then back what `frame` did.
    ///
    /// ```
    /// use glam::{DQuat, DVec3};
    /// use pliant_core::motion::rig::RigidMotion;
    /// let turn = RigidMotion { rotation: DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0), from: DVec3::X, to: DVec3::Y };
    /// let seen = turn.seen_from(&turn);
    /// assert!(seen.place(DVec3::Z).distance(DVec3::Z) < 1e-15);
    /// ```
    #[must_use]
    pub fn seen_from(&self, frame: &Self) -> Self {
        let back = frame.rotation.inverse();
        Self {
            rotation: (back * self.rotation).normalize(),
            from: self.from,
            to: back * (self.to - frame.to) + frame.from,
        }
    }
}

//! Axes of model space with their signs.

use glam::DVec3;

/// An axis of model space with its sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SignedAxis {
    pub(crate) axis: usize,
    is_negative: bool,
}

impl Default for SignedAxis {
    fn default() -> Self {
        Self::Y
    }
}

impl SignedAxis {
    /// The names of all.
    pub const NAMES: [&str; 6] = ["x", "-x", "y", "-y", "z", "-z"];

    /// The vertical of most files.
    pub const Y: Self = Self::new(1, false);

    pub(crate) const fn new(axis: usize, is_negative: bool) -> Self {
        Self { axis, is_negative }
    }

    /// The axis of a name: `x`, `-x`, `y`, `-y`, `z` or `-z`; `None` for another one.
    pub fn named(name: &str) -> Option<Self> {
        let number = Self::NAMES.iter().position(|own| *own == name)?;
        Some(Self::new(number / 2, number % 2 == 1))
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::NAMES[2 * self.axis + usize::from(self.is_negative)]
    }

    /// The unit vector along it.
    pub fn direction(self) -> DVec3 {
        let sign = if self.is_negative { -1.0 } else { 1.0 };
        DVec3::AXES[self.axis] * sign
    }

    /// The axis nearest to a direction.
    pub(crate) fn nearest(way: DVec3) -> Self {
        let axis = way.abs().max_position();
        Self::new(axis, way[axis] < 0.0)
    }

    /// Whether it points against its axis.
    pub(crate) fn is_negative(self) -> bool {
        self.is_negative
    }

    pub(crate) fn reversed(self) -> Self {
        Self::new(self.axis, !self.is_negative)
    }
}

//! What a cut does with the two sides that it makes.

/// What stays after a cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum KeptSide {
    /// Both sides, parted.
    #[default]
    Both,
    /// The side that the normal points to; left of a curve, seen from outside.
    Above,
    /// The other side; right of a curve.
    Below,
}

/// What a cut does with the two sides that it makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CutOptions<'a> {
    /// What stays.
    pub keep: KeptSide,
    /// Whether the openings of the sides that stay are closed by caps.
    pub fill: bool,
    /// For each primitive, whether the vertices of its caps are their own (a primitive with normals); no beyond the end.
    pub hard_caps: &'a [bool],
}

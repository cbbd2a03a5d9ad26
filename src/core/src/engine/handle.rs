//! Handles as a program asks for them: which vertices they hold, what they fix, and how hard.

use super::pose::HandlePose;
use super::region::{Plane, Region};

/// A region that the user holds.
///
/// ```
/// use pliant_core::engine::{Handle, Region};
/// let head = Handle::new("head", Region::sphere([0.0, 1.6, 0.0], 0.2)).soft(2.0);
/// assert_eq!((head.id.as_str(), head.stiffness), ("head", Some(2.0)));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Handle {
    /// The name, unique among the handles.
    pub id: String,
    /// The vertices.
    pub region: Region,
    /// What the handle fixes.
    pub constrains: HandleConstrains,
    /// `None`: hard, vertices are exactly where the pose says. Else a soft weight above 0, in units of edge weights.
    pub stiffness: Option<f64>,
    /// Whether the region keeps its shape whatever moves it.
    pub rigid: bool,
    /// Where the handle is when it is set; `None`: its rest pose.
    pub pose: Option<HandlePose>,
    /// How a soft handle fades out around its region.
    pub falloff: Option<Falloff>,
}

/// What a handle fixes of its vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HandleConstrains {
    /// Where they are (second pass).
    pub position: bool,
    /// How they are turned (first pass).
    pub rotation: bool,
    /// How they are scaled (first pass).
    pub scale: bool,
}

/// How the weight of a soft handle falls around its region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Falloff {
    /// The distance from the region at which the weight is 0, in model units.
    pub radius: f64,
    /// The curve of the weight.
    pub curve: FalloffCurve,
}

/// The curve of a falloff.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FalloffCurve {
    /// Straight down to 0 at the radius.
    Linear,
    /// Smoothly down to 0 at the radius.
    Smooth,
}

/// All handles of a deformer, and what holds for all of them. Where regions overlap, the later handle holds the vertices.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HandleSet {
    /// The handles.
    pub handles: Vec<Handle>,
    /// A plane that mirrors every handle.
    pub symmetry_plane: Option<Plane>,
    /// A region outside of which all positions keep their bits.
    pub region_of_interest: Option<Region>,
}

impl HandleConstrains {
    /// Everything is fixed: position, rotation and scale.
    pub const ALL: Self = Self {
        position: true,
        rotation: true,
        scale: true,
    };
}

impl Handle {
    /// Makes a hard handle in its rest pose that fixes position, rotation and scale.
    pub fn new(id: impl Into<String>, region: Region) -> Self {
        Self {
            id: id.into(),
            region,
            constrains: HandleConstrains::ALL,
            stiffness: None,
            rigid: false,
            pose: None,
            falloff: None,
        }
    }

    /// Makes the handle soft: it pulls its vertices with a weight of `stiffness` edges.
    #[must_use]
    pub fn soft(self, stiffness: f64) -> Self {
        let stiffness = Some(stiffness);
        Self { stiffness, ..self }
    }

    /// Sets where the handle is when it is set.
    #[must_use]
    pub fn posed(self, pose: HandlePose) -> Self {
        let pose = Some(pose);
        Self { pose, ..self }
    }
}

impl HandleSet {
    /// Bytes held, about.
    pub fn byte_size(&self) -> usize {
        let handles = self.handles.iter();
        let regions: usize = handles
            .map(|h| size_of::<Handle>() + h.id.len() + h.region.byte_size())
            .sum();
        regions + self.region_of_interest.as_ref().map_or(0, Region::byte_size)
    }
}

impl HandleSet {
    /// About how many points are looked at when the handles are set on a model with so many vertices and nodes: what decides
    /// whether that is a moment's work.
    pub fn cost(&self, points: u64) -> u64 {
        let of_region = |region: &Region| match region {
            Region::Tube { points, .. } => 1 + (points.len() as u64 / 16).min(4),
            _ => 1,
        };
        // A falloff goes from node to node, nearest first.
        let of_handle = |h: &Handle| of_region(&h.region) + if h.falloff.is_some() { 8 } else { 0 };
        let each: u64 = self.handles.iter().map(of_handle).sum();
        let mirrored = if self.symmetry_plane.is_some() { 2 } else { 1 };
        let interest = self.region_of_interest.as_ref().map_or(0, of_region);
        (mirrored * each + interest).saturating_mul(points)
    }
}

impl<const N: usize> From<[Handle; N]> for HandleSet {
    fn from(handles: [Handle; N]) -> Self {
        Vec::from(handles).into()
    }
}

impl From<Vec<Handle>> for HandleSet {
    fn from(handles: Vec<Handle>) -> Self {
        Self {
            handles,
            ..Self::default()
        }
    }
}

impl From<&HandleSet> for HandleSet {
    fn from(set: &HandleSet) -> Self {
        set.clone()
    }
}

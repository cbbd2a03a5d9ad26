//! Handles as a program asks for them: which region they hold, what they fix of it and how hard, and where they are.

use super::region::{Plane, Region};
use super::vertex_targets::{StiffnessPer, VertexTargets};
use crate::deform::{Guide, GuidePose, Transform, log_rotation};
use glam::{DMat3, DQuat, DVec3};
use std::sync::Arc;

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
    /// How a soft handle fades out around its region, and a hard one inside of it.
    pub falloff: Option<Falloff>,
    /// Whether each vertex has a target of its own, which poses give ([`HandlePose::targets`]), and what the stiffness is for then.
    /// Such a handle is soft and constrains positions alone.
    pub targets: Option<StiffnessPer>,
    /// Of a handle with targets, what part of the pull along the surface is left out, 0 to 1: at 1 a vertex is wanted anywhere in the
    /// plane through its target across [`VertexTargets::normals`].
    pub tangential: f64,
    /// Of a handle with targets, what gives their places for each pose of it ([`HandlePose::guide`]); `None`: poses list them.
    pub guide: Option<Arc<Guide>>,
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

/// How a handle fades. A soft one does around its region: its weight falls to 0 at the radius. A hard one does inside: what is nearer to
/// the border of the region than the radius is pulled instead of held, loosely at the border and stiffer and stiffer towards
/// what stays hard, in proportion to f / (1 − f) for the curve's f from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Falloff {
    /// The width of the band, in model units: outwards from the region's border, or inwards.
    pub radius: f64,
    /// The curve of the weight.
    pub curve: FalloffCurve,
}

/// The curve of a falloff.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FalloffCurve {
    /// Straight over the radius.
    Linear,
    /// Smoothly at both ends.
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
    /// Parts that move as rigid bodies, with no handle each.
    pub stiff: Option<Stiff>,
    /// What handles turn about whose poses name no pivot.
    pub default_pivot: DefaultPivot,
}

/// What a handle turns about whose pose names no pivot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DefaultPivot {
    /// The joint between its region and what is free; the middle of the region where there is none.
    #[default]
    Joint,
    /// The middle of its region. Records of the time before joints mean this.
    Middle,
}

/// Parts that move as rigid bodies. What hangs together of a primitive, a component or a region is one part; where they overlap,
/// the later one has the vertices, regions after components and these after primitives.
#[derive(Debug, Clone, PartialEq)]
pub struct Stiff {
    /// Primitives, by their numbers in the model.
    pub primitives: Vec<u32>,
    /// Connected components, by their numbers.
    pub components: Vec<u32>,
    /// Regions.
    pub regions: Vec<Region>,
    /// All components.
    pub all: bool,
    /// Those components that [`find_hard_parts`](crate::engine::find_hard_parts) finds.
    pub auto: bool,
    /// How rigid they are, above 0 to 1.
    pub strength: f64,
}

impl Default for Stiff {
    fn default() -> Self {
        Self {
            primitives: Vec::new(),
            components: Vec::new(),
            regions: Vec::new(),
            all: false,
            auto: false,
            strength: 1.0,
        }
    }
}

impl Stiff {
    /// Bytes held, about.
    pub fn byte_size(&self) -> usize {
        let regions: usize = self.regions.iter().map(Region::byte_size).sum();
        4 * (self.primitives.len() + self.components.len()) + regions
    }

    /// What is listed, in the order in which the later one has the vertices, each with its field.
    pub(super) fn listed(&self) -> Vec<(String, Region)> {
        let number = |kind: &'static str| move |k: usize| format!("stiff.{kind}[{k}]");
        let of = |numbers: &[u32], field: &dyn Fn(usize) -> String, region: fn(u32) -> Region| {
            let each = numbers.iter().enumerate().map(|(k, &n)| (field(k), region(n)));
            each.collect::<Vec<_>>()
        };
        let mut listed = of(&self.primitives, &number("primitives"), Region::Primitive);
        listed.extend(of(&self.components, &number("components"), Region::Component));
        let regions = self.regions.iter().cloned().enumerate();
        listed.extend(regions.map(|(k, region)| (number("regions")(k), region)));
        listed
    }
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
            targets: None,
            tangential: 0.0,
            guide: None,
        }
    }

    /// Makes a handle whose vertices have targets, each pulled with a weight of `stiffness` edges.
    pub fn with_targets(id: impl Into<String>, region: Region, stiffness: f64) -> Self {
        Self {
            constrains: HandleConstrains {
                rotation: false,
                scale: false,
                ..HandleConstrains::ALL
            },
            targets: Some(StiffnessPer::Vertex),
            ..Self::new(id, region).soft(stiffness)
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
            .map(|h| {
                let targets = h.pose.as_ref().map_or(0, HandlePose::target_bytes);
                let guide = h.guide.as_ref().map_or(0, |guide| guide.byte_size());
                size_of::<Handle>() + h.id.len() + h.region.byte_size() + targets + guide
            })
            .sum();
        let stiff = self.stiff.as_ref().map_or(0, Stiff::byte_size);
        regions + stiff + self.region_of_interest.as_ref().map_or(0, Region::byte_size)
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
        let of_handle = |h: &Handle| {
            let guide = h.guide.as_ref().map_or(0, |guide| guide.cost());
            of_region(&h.region) + if h.falloff.is_some() { 8 } else { 0 } + guide
        };
        let each: u64 = self.handles.iter().map(of_handle).sum();
        let mirrored = if self.symmetry_plane.is_some() { 2 } else { 1 };
        let interest = self.region_of_interest.as_ref().map_or(0, of_region);
        let stiff: u64 = self.stiff.as_ref().map_or(0, |stiff| {
            let listed = stiff.primitives.len() + stiff.components.len();
            listed as u64 + stiff.regions.iter().map(of_region).sum::<u64>() + 4
        });
        (mirrored * each + interest + stiff).saturating_mul(points)
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

/// Where a handle is: scaled, then rotated about the pivot, then translated. `None` leaves it as in the rest pose.
///
/// ```
/// use pliant_core::engine::HandlePose;
/// let pose = HandlePose::translation([0.0, 1.0, 0.0]).rotated([0.0, 0.0, 1.57]);
/// assert!(pose.moves() && !HandlePose::default().moves());
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HandlePose {
    /// The way that the handle has moved, in model units.
    pub translation: Option<DVec3>,
    /// How the handle is turned; of a free rotation, where the search for it begins.
    pub rotation: Option<HandleRotation>,
    /// Whether the rotation is found by the solve, so that what the handle hangs on is bent least. The pivot is then the centroid where
    /// none is named.
    pub free_rotation: bool,
    /// How the handle is scaled.
    pub scale: Option<HandleScale>,
    /// The point that it is turned and scaled about; `None`: [`HandleFacts::pivot`](super::HandleFacts::pivot), the joint between
    /// the region and what is free.
    pub pivot: Option<DVec3>,
    /// Of a handle with targets, and all that it takes: where its vertices are wanted. `None`: in the rest pose, with weights of 1.
    pub targets: Option<Arc<VertexTargets>>,
    /// Of a handle with a guide, its shape, which gives the places; `None`: its rest shape.
    pub guide: Option<Arc<GuidePose>>,
}

/// How a handle is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HandleRotation {
    /// A quaternion of about unit length.
    Quaternion(DQuat),
    /// Axis times angle in radians; any number of turns counts.
    Vector(DVec3),
}

/// How a handle is scaled; factors are above 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HandleScale {
    /// By one factor in all directions.
    Uniform(f64),
    /// By a factor along each axis.
    PerAxis(DVec3),
}

/// The pose of every handle in force, in the order of the handles. Cheap to clone.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HandlePoses(pub Arc<Vec<HandlePose>>);

impl HandlePose {
    /// Makes the pose of a handle that has moved, and is neither turned nor scaled.
    pub fn translation(by: impl Into<DVec3>) -> Self {
        Self {
            translation: Some(by.into()),
            ..Self::default()
        }
    }

    /// Makes the pose of a handle that is turned by axis times angle in radians about its joint.
    pub fn rotation(vector: impl Into<DVec3>) -> Self {
        Self::default().rotated(vector)
    }

    /// Adds a rotation by axis times angle in radians.
    #[must_use]
    pub fn rotated(self, vector: impl Into<DVec3>) -> Self {
        Self {
            rotation: Some(HandleRotation::Vector(vector.into())),
            ..self
        }
    }

    /// Has the solve find the rotation.
    #[must_use]
    pub fn turning_freely(self) -> Self {
        Self {
            free_rotation: true,
            ..self
        }
    }

    /// Adds the point that the handle is turned and scaled about.
    #[must_use]
    pub fn about(self, pivot: impl Into<DVec3>) -> Self {
        Self {
            pivot: Some(pivot.into()),
            ..self
        }
    }

    /// Makes the pose of a handle with targets.
    pub fn targets(targets: VertexTargets) -> Self {
        Self {
            targets: Some(Arc::new(targets)),
            ..Self::default()
        }
    }

    /// Makes the pose of a handle with a guide.
    pub fn guide(shape: GuidePose) -> Self {
        Self {
            guide: Some(Arc::new(shape)),
            ..Self::default()
        }
    }

    /// Bytes of its targets, and of the shape of its guide.
    pub fn target_bytes(&self) -> usize {
        let targets = self.targets.as_ref().map_or(0, |targets| targets.byte_size());
        targets + self.guide.as_ref().map_or(0, |shape| shape.byte_size())
    }

    /// Returns whether the pose may move anything as a whole. A pivot alone does not.
    pub fn moves(&self) -> bool {
        self.translation.is_some() || self.rotation.is_some() || self.scale.is_some()
    }

    /// Returns the pose as a transform; `joint` is the pivot when the pose names none.
    pub(super) fn to_transform(&self, joint: DVec3) -> Transform {
        let rotation = match self.rotation {
            Some(HandleRotation::Quaternion(q)) => log_rotation(q.normalize()),
            Some(HandleRotation::Vector(v)) => v,
            None => DVec3::ZERO,
        };
        let log_scale = match self.scale {
            None => DMat3::ZERO,
            Some(HandleScale::Uniform(s)) => log_diagonal([s; 3]),
            Some(HandleScale::PerAxis(s)) => log_diagonal(s.to_array()),
        };
        Transform {
            translation: self.translation.unwrap_or(DVec3::ZERO),
            rotation,
            log_scale,
            pivot: self.pivot.unwrap_or(joint),
        }
    }
}

fn log_diagonal(factors: [f64; 3]) -> DMat3 {
    DMat3::from_diagonal(DVec3::from_array(factors.map(libm::log)))
}

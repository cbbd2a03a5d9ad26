//! Regions: sets of vertices as a program asks for them.

use crate::deform::{Transform, exp_rotation};
use glam::DVec3;

/// A set of vertices. Handles take it in the rest pose, an edit takes it in the shape that it works on; both in model space.
///
/// A program that knows its vertices better than these shapes do lists them:
///
/// ```
/// use pliant_core::engine::Region;
/// let rest = [[0.0, 0.1, 0.0], [0.0, 0.9, 0.0]];
/// let high = (0u32..).zip(&rest).filter(|(_, p)| p[1] > 0.5).map(|(vertex, _)| vertex);
/// assert_eq!(Region::vertices(high), Region::vertices([1]));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum Region {
    /// Listed render vertices: single ones and ranges.
    Vertices {
        /// Single vertices.
        indices: Vec<u32>,
        /// Ranges of vertices.
        ranges: Vec<VertexRange>,
    },
    /// The points on the side of a plane that its normal points to, and those on it.
    HalfSpace(Plane),
    /// The points within a distance of a centre.
    Sphere {
        /// The centre.
        center: DVec3,
        /// The distance.
        radius: f64,
    },
    /// The points in an axis-aligned box, borders included.
    Box {
        /// The lowest corner.
        min: DVec3,
        /// The highest corner.
        max: DVec3,
    },
    /// The points within a distance of a segment.
    Capsule {
        /// One end of the segment.
        from: DVec3,
        /// The other end.
        to: DVec3,
        /// The distance.
        radius: f64,
    },
    /// The points within a distance of a polyline.
    Tube {
        /// The points of the polyline.
        points: Vec<DVec3>,
        /// The distance.
        radius: f64,
    },
    /// A connected component; components are numbered by their smallest vertex.
    Component(u32),
    /// A primitive, by its number in the model.
    Primitive(u32),
    /// A weight from 0 to 1 for each render vertex. Vertices above 0 belong to the region; the weight scales the stiffness of
    /// a soft handle.
    Weights(Vec<f32>),
    /// Points of the surface, at most one a target of a handle with targets. To anything else they are the vertices around them.
    Anchors(Vec<Anchor>),
}

/// A point of the surface by its place between three vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    /// The vertices.
    pub corners: AnchorCorners,
    /// How near it is to each of them: 0 to 1, and together 1.
    pub weights: [f32; 3],
}

/// The vertices around a point of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AnchorCorners {
    /// Those of a triangle, by its number: as the model has them, primitive after primitive.
    Face(u32),
    /// These render vertices. In handles that are set they stand for faces, so that points outlive edits.
    Vertices([u32; 3]),
}

/// `count` vertices from `first` on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VertexRange {
    /// The first vertex.
    pub first: u32,
    /// How many vertices there are.
    pub count: u32,
}

/// A plane: the points whose product with the normal is the offset. The normal need not be of unit length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// The direction that the plane faces; not zero.
    pub normal: DVec3,
    /// The product of the normal with the plane's points.
    pub offset: f64,
}

impl Plane {
    /// Makes the plane of the points whose product with `normal` is `offset`.
    ///
    /// ```
    /// use pliant_core::engine::Plane;
    /// let plane = Plane::new([0.0, 2.0, 0.0], 1.0);
    /// assert_eq!(plane.unit_normal_and_point().1.y, 0.5);
    /// ```
    pub fn new(normal: impl Into<DVec3>, offset: f64) -> Self {
        let normal = normal.into();
        Self { normal, offset }
    }

    /// Returns the normal at unit length, and a point of the plane.
    pub fn unit_normal_and_point(&self) -> (DVec3, DVec3) {
        let length = self.normal.length();
        let unit = self.normal / length;
        (unit, unit * (self.offset / length))
    }
}

impl Region {
    /// Makes the region of the listed render vertices.
    pub fn vertices(indices: impl IntoIterator<Item = u32>) -> Self {
        let indices = indices.into_iter().collect();
        Self::Vertices {
            indices,
            ranges: Vec::new(),
        }
    }

    /// Makes the region of the points whose product with `normal` is at least `offset`.
    ///
    /// ```
    /// use pliant_core::engine::{Plane, Region};
    /// let above = Region::half_space([0.0, 1.0, 0.0], 0.5);
    /// assert_eq!(above, Region::HalfSpace(Plane::new([0.0, 1.0, 0.0], 0.5)));
    /// ```
    pub fn half_space(normal: impl Into<DVec3>, offset: f64) -> Self {
        Self::HalfSpace(Plane::new(normal, offset))
    }

    /// Makes the region of the points within `radius` of `center`.
    pub fn sphere(center: impl Into<DVec3>, radius: f64) -> Self {
        let center = center.into();
        Self::Sphere { center, radius }
    }

    /// Makes the region of the points in the axis-aligned box between two corners.
    pub fn axis_aligned_box(min: impl Into<DVec3>, max: impl Into<DVec3>) -> Self {
        let (min, max) = (min.into(), max.into());
        Self::Box { min, max }
    }

    /// Makes the region of the points within `radius` of a segment.
    pub fn capsule(from: impl Into<DVec3>, to: impl Into<DVec3>, radius: f64) -> Self {
        let (from, to) = (from.into(), to.into());
        Self::Capsule { from, to, radius }
    }

    /// Whether it is given by place, so that it may contain nodes inside a model and no vertex.
    pub fn is_solid(&self) -> bool {
        match self {
            Self::HalfSpace { .. }
            | Self::Sphere { .. }
            | Self::Box { .. }
            | Self::Capsule { .. }
            | Self::Tube { .. } => true,
            Self::Vertices { .. } | Self::Component(_) | Self::Primitive(_) | Self::Weights(_) | Self::Anchors(_) => {
                false
            }
        }
    }

    /// Returns the region moved with a handle. Spheres, capsules and tubes grow with it; a box stays along the axes and keeps
    /// its size. A region that is not given by place stays as it is.
    pub(super) fn moved(&self, by: &Transform) -> Self {
        let map = by.map();
        let grown = |radius: f64| {
            let logs = [0, 1, 2].map(|k| by.log_scale.col(k)[k]);
            radius * libm::exp(logs.iter().sum::<f64>() / 3.0)
        };
        match self {
            Self::HalfSpace(plane) => {
                let (normal, point) = plane.unit_normal_and_point();
                let normal = exp_rotation(by.rotation) * normal;
                Self::half_space(normal, normal.dot(map(point)))
            }
            Self::Sphere { center, radius } => Self::sphere(map(*center), grown(*radius)),
            &Self::Box { min, max } => {
                let middle = (min + max) * 0.5;
                let way = map(middle) - middle;
                Self::axis_aligned_box(min + way, max + way)
            }
            &Self::Capsule { from, to, radius } => Self::capsule(map(from), map(to), grown(radius)),
            Self::Tube { points, radius } => Self::Tube {
                points: points.iter().map(|p| map(*p)).collect(),
                radius: grown(*radius),
            },
            Self::Vertices { .. } | Self::Component(_) | Self::Primitive(_) | Self::Weights(_) | Self::Anchors(_) => {
                self.clone()
            }
        }
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        match self {
            Self::Vertices { indices, ranges } => size_of_val(&indices[..]) + size_of_val(&ranges[..]),
            Self::Tube { points, .. } => size_of_val(&points[..]),
            Self::Weights(values) => size_of_val(&values[..]),
            Self::Anchors(anchors) => size_of_val(&anchors[..]),
            Self::HalfSpace { .. }
            | Self::Sphere { .. }
            | Self::Box { .. }
            | Self::Capsule { .. }
            | Self::Component(_)
            | Self::Primitive(_) => 0,
        }
    }
}

//! Lengths, areas and volumes. Sums run in the order of the input.
//!
//! Numbers as people read them in warnings and summaries; programs get them whole beside the text.

use crate::adjacency::MeshEdge;
use glam::DVec3;

/// An axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundingBox {
    /// The corner with the smallest coordinates.
    pub min: DVec3,
    /// The corner with the largest coordinates.
    pub max: DVec3,
}

/// A box whose largest coordinate is more than so many of its diagonals is far from the origin: single precision rounds its places by
/// up to 2⁻²⁰ of the diagonal there, and by more beyond.
const FAR: f64 = 16.0;
/// Places of such a box that are moved to the origin are multiples of so many times the rounding of its largest coordinate.
const GRID: f64 = 64.0;

impl BoundingBox {
    /// The smallest box around `points`; the origin when there are none.
    pub fn of(points: &[DVec3]) -> Self {
        let Some(&first) = points.first() else {
            return Self {
                min: DVec3::ZERO,
                max: DVec3::ZERO,
            };
        };
        points.iter().fold(Self { min: first, max: first }, |b, &p| Self {
            min: b.min.min(p),
            max: b.max.max(p),
        })
    }

    /// Its middle.
    pub fn center(&self) -> DVec3 {
        self.min * 0.5 + self.max * 0.5
    }

    /// Its side lengths.
    pub fn size(&self) -> DVec3 {
        self.max - self.min
    }

    /// Length of its diagonal.
    pub fn diagonal(&self) -> f64 {
        self.size().length()
    }

    /// Whether it lies so far from the origin, for its size, that single precision rounds its places by more than a millionth of its
    /// diagonal: where its largest coordinate is more than 16 diagonals. Map coordinates are, and models in their own coordinates are not.
    pub fn is_far(&self) -> bool {
        self.is_far_for(self.diagonal())
    }

    /// Whether it lies so far from the origin for a model of that diagonal of which it is a part; see [`BoundingBox::is_far`].
    pub fn is_far_for(&self, diagonal: f64) -> bool {
        diagonal > 0.0 && self.min.abs().max(self.max.abs()).max_element() > FAR * diagonal
    }

    /// What its places are relative to where they become single precision: zero, or the middle of a box that [is far](Self::is_far).
    /// Its own numbers are single precision, so that every reader has the same.
    pub fn origin(&self) -> DVec3 {
        let middle = self.center().as_vec3();
        if self.is_far() && middle.is_finite() {
            middle.as_dvec3()
        } else {
            DVec3::ZERO
        }
    }

    /// [`BoundingBox::origin`], or `known` where that serves as well: a shape that moves keeps the one that it had in the rest pose.
    pub fn origin_like(&self, known: DVec3) -> DVec3 {
        let relative = Self {
            min: self.min - known,
            max: self.max - known,
        };
        match self.is_far() && !relative.is_far() {
            true => known,
            false => self.origin(),
        }
    }

    /// Places in the box relative to its middle, as they were before something moved them far from the origin, as far as that can be
    /// known: without what their numbers were rounded by there. A symmetric shape is symmetric again, and decisions between equal
    /// lengths are those of the same shape near the origin.
    pub fn near_origin(&self, positions: &[DVec3]) -> Vec<DVec3> {
        let largest = self.min.abs().max(self.max.abs()).max_element();
        let grid = libm::exp2(libm::floor(libm::log2(largest))) * f64::EPSILON * GRID;
        let middle = self.center();
        let relative = positions.iter().map(|p| *p - middle);
        match grid > 0.0 && grid.is_finite() {
            true => relative.map(|p| (p / grid).round() * grid).collect(),
            false => relative.collect(),
        }
    }

    /// Whether it overlaps or touches another box.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }
}

/// Area of all faces.
///
/// # Panics
/// When a triangle names a position that does not exist.
pub fn surface_area(positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    triangles.iter().map(|&t| triangle_area(positions, t)).sum()
}

/// Area of one face.
pub(super) fn triangle_area(positions: &[DVec3], triangle: [u32; 3]) -> f64 {
    let [a, b, c] = triangle.map(|v| positions[v as usize]);
    0.5 * (b - a).cross(c - a).length()
}

/// Volume enclosed by a closed surface whose faces are wound counter-clockwise seen from outside; negative when they
/// are wound the other way. For a surface with holes it is the volume of the cones from the centre of its box.
///
/// # Panics
/// When a triangle names a position that does not exist.
pub fn signed_volume(positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    let origin = BoundingBox::of(positions).center();
    triangles.iter().map(|&t| cone_volume(positions, t, origin)).sum()
}

/// Signed volume of the tetrahedron between `origin` and one face.
pub(super) fn cone_volume(positions: &[DVec3], triangle: [u32; 3], origin: DVec3) -> f64 {
    let [a, b, c] = triangle.map(|v| positions[v as usize] - origin);
    a.dot(b.cross(c)) / 6.0
}

/// Mean length of `edges`, each counted once; 0 without edges.
///
/// # Panics
/// When an edge names a position that does not exist.
pub fn mean_edge_length(positions: &[DVec3], edges: &[MeshEdge]) -> f64 {
    let length = |e: &MeshEdge| positions[e.vertices[0] as usize].distance(positions[e.vertices[1] as usize]);
    let total: f64 = edges.iter().map(length).sum();
    if edges.is_empty() {
        0.0
    } else {
        total / edges.len() as f64
    }
}

/// Writes a number with three significant digits, with thousands apart, and with an exponent where there would be many zeros.
///
/// ```
/// use pliant_mesh::brief_number;
///
/// let brief = [0.1565576, -203.39247, 0.0, 12345.6, 2.0, 1.5e-7].map(brief_number);
/// assert_eq!(brief, ["0.157", "-203", "0", "12,346", "2", "1.50e-7"]);
/// ```
#[must_use]
pub fn brief_number(x: f64) -> String {
    if x == 0.0 {
        return "0".into();
    }
    if !(1e-4..1e15).contains(&x.abs()) {
        return format!("{x:.2e}");
    }
    let magnitude = libm::floor(libm::log10(x.abs())) as i32;
    let digits = usize::try_from(2 - magnitude).unwrap_or(0);
    let plain = format!("{x:.digits$}");
    let short = match plain.contains('.') {
        true => plain.trim_end_matches('0').trim_end_matches('.'),
        false => &plain,
    };
    match (short.contains('.'), short.strip_prefix('-')) {
        (true, _) => short.to_owned(),
        (false, Some(size)) => format!("-{}", with_commas(size)),
        (false, None) => with_commas(short),
    }
}

/// Writes a count with thousands apart.
///
/// ```
/// assert_eq!(pliant_mesh::grouped_count(1_234_567), "1,234,567");
/// assert_eq!(pliant_mesh::grouped_count(999), "999");
/// ```
#[must_use]
pub fn grouped_count(n: u64) -> String {
    with_commas(&n.to_string())
}

/// Writes a place, each coordinate with three significant digits.
#[must_use]
pub fn brief_point(p: DVec3) -> String {
    let [x, y, z] = p.to_array().map(brief_number);
    format!("({x}, {y}, {z})")
}

/// Puts a comma before every three digits.
fn with_commas(digits: &str) -> String {
    let mut out = String::with_capacity(digits.len() * 4 / 3);
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjacency::Adjacency;

    #[test]
    fn a_corner_tetrahedron_has_the_textbook_measures_wherever_it_lies() {
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        for shift in [DVec3::ZERO, DVec3::new(1e6, -3e5, 2.0)] {
            let p: Vec<DVec3> = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]
                .iter()
                .map(|&p| p + shift)
                .collect();
            assert!((signed_volume(&p, &faces) - 1.0 / 6.0).abs() < 1e-9);
            assert!((surface_area(&p, &faces) - (1.5 + 0.75f64.sqrt())).abs() < 1e-9);
            let inside_out = faces.map(|[a, b, c]| [a, c, b]);
            assert!((signed_volume(&p, &inside_out) + 1.0 / 6.0).abs() < 1e-9);
            let mean = mean_edge_length(&p, &Adjacency::build(4, &faces).edges);
            assert!((mean - (3.0 + 3.0 * 2f64.sqrt()) / 6.0).abs() < 1e-9);
            assert_eq!(BoundingBox::of(&p).size(), DVec3::ONE);
        }
    }

    #[test]
    fn nothing_has_no_size() {
        assert_eq!(
            (
                BoundingBox::of(&[]).diagonal(),
                mean_edge_length(&[], &[]),
                surface_area(&[], &[])
            ),
            (0.0, 0.0, 0.0)
        );
    }
}

//! Edges that a subdivision leaves sharp, wholly or in part.
//!
//! The rules of Hoppe et al. ("Piecewise Smooth Surface Reconstruction", 1994): a new point on a crease is its middle, an old one
//! with two creases follows their cubic curve, one with more stays, one where a crease ends is smooth. A sharpness below 1
//! lies between these rules and the smooth ones (DeRose, Kass and Truong, "Subdivision Surfaces in Character Animation", 1998):
//! one of 2.5 is three subdivisions, with 2.5, 1.5 and 0.5.

use super::patch::EditWarning;
use super::region_mesh::{RegionMesh, edge_key};
use super::surface::SurfaceView;
use super::triangle;
use glam::DVec3;
use pliant_mesh::{Error, NONE};
use std::collections::BTreeMap;

/// Which edges stay sharp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CreaseOptions<'a> {
    /// Edges whose faces' normals differ by more, degrees above 0 and up to 180. `None`: no edge for its angle.
    pub degrees: Option<f64>,
    /// Edges between these pairs of points of the surface.
    pub edges: &'a [[u32; 2]],
    /// Edges between two primitives.
    pub between_primitives: bool,
    /// How sharp: 1 and more are wholly sharp, 0 is smooth.
    pub sharpness: f64,
}

impl Default for CreaseOptions<'_> {
    fn default() -> Self {
        Self {
            degrees: None,
            edges: &[],
            between_primitives: false,
            sharpness: 1.0,
        }
    }
}

/// The creases of a region.
pub(super) struct CreaseEdges {
    /// The other ends of the creases at each point that has some, rising.
    at: BTreeMap<u32, Vec<u32>>,
    sharpness: f64,
}

impl CreaseEdges {
    /// Finds those of `edges`, the sorted edges of the mesh, that are creases.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an angle or sharpness out of range, or a pair of points that no edge joins.
    pub fn find(
        surface: &SurfaceView<'_>,
        mesh: &RegionMesh,
        edges: &[(u32, u32)],
        options: &CreaseOptions<'_>,
    ) -> Result<Self, Error> {
        let refuse = |field: &str, problem: String| Err(Error::invalid(format!("subdivide.{field}"), problem));
        if !(options.sharpness >= 0.0 && options.sharpness.is_finite()) {
            return refuse("sharpness", format!("is {}, allowed is 0 and more", options.sharpness));
        }
        let cosine = match options.degrees {
            Some(degrees) if degrees > 0.0 && degrees <= 180.0 => Some(libm::cos(degrees.to_radians())),
            Some(degrees) => {
                return refuse(
                    "creaseDegrees",
                    format!("is {degrees}, allowed is above 0 and up to 180 degrees"),
                );
            }
            None => None,
        };
        let named = named_edges(surface, options.edges)?;
        let mut creases = Self {
            at: BTreeMap::new(),
            sharpness: options.sharpness.min(1.0),
        };
        if cosine.is_none() && named.is_empty() && !options.between_primitives {
            return Ok(creases);
        }
        for &(a, b) in edges {
            let edge = mesh.edge_faces(a, b);
            // A boundary is one anyway; where more faces meet nothing moves.
            if mesh.is_locked(edge) || edge.left == NONE || edge.right == NONE {
                continue;
            }
            let faces = [edge.left, edge.right].map(|f| &mesh.faces[f as usize]);
            let is_sharp = |least: f64| {
                let [n, m] = [edge.left, edge.right].map(|f| mesh.area_normal(f));
                triangle::cosine(n, m).is_some_and(|c| c < least)
            };
            let ends = [a, b].map(|p| mesh.points[p as usize].old);
            if named.binary_search(&edge_key(ends[0], ends[1])).is_ok()
                || (options.between_primitives && faces[0].primitive != faces[1].primitive)
                || cosine.is_some_and(is_sharp)
            {
                creases.at.entry(a).or_default().push(b);
                creases.at.entry(b).or_default().push(a);
            }
        }
        creases.at.values_mut().for_each(|ends| ends.sort_unstable());
        Ok(creases)
    }

    /// Says so where `options` ask for creases, or for how sharp they are, and there are none.
    pub fn warn_of_none(&self, options: &CreaseOptions<'_>) -> Option<EditWarning> {
        let unnamed = CreaseOptions {
            sharpness: options.sharpness,
            ..CreaseOptions::default()
        };
        let (message, at) = match *options == unnamed {
            _ if !self.at.is_empty() || *options == CreaseOptions::default() => return None,
            true => {
                let message = "it says how sharp creases are, and none are named: give creaseDegrees, creases or creasePrimitives";
                (message, "sharpness")
            }
            false => ("no edge inside the region is a crease", "region"),
        };
        Some(EditWarning::new("subdivide-no-creases", message, at))
    }

    /// The other ends of the creases at a point, rising.
    pub fn at(&self, p: u32) -> &[u32] {
        self.at.get(&p).map_or(&[], Vec::as_slice)
    }

    /// Whether an edge is a crease.
    pub fn contains(&self, a: u32, b: u32) -> bool {
        self.at(a).binary_search(&b).is_ok()
    }

    /// Between the places of a smooth and a wholly sharp rule.
    pub fn sharpened(&self, smooth: DVec3, sharp: DVec3) -> DVec3 {
        if self.sharpness < 1.0 {
            smooth.lerp(sharp, self.sharpness)
        } else {
            sharp
        }
    }

    /// The creases by their ends, rising, with their places among the sorted `edges`.
    pub fn divided<'a>(&'a self, edges: &'a [(u32, u32)]) -> impl Iterator<Item = (u32, u32, usize)> + 'a {
        let ends = self.at.iter().flat_map(|(&a, ends)| ends.iter().map(move |&b| (a, b)));
        ends.filter_map(|(a, b)| (a < b).then_some((a, b, edges.binary_search(&(a, b)).ok()?)))
    }
}

/// The pairs of points as edges, the smaller end first, sorted.
fn named_edges(surface: &SurfaceView<'_>, pairs: &[[u32; 2]]) -> Result<Vec<(u32, u32)>, Error> {
    let mut named: Vec<(u32, u32)> = pairs.iter().map(|&[a, b]| edge_key(a, b)).collect();
    named.sort_unstable();
    named.dedup();
    let mut found = vec![false; named.len()];
    if !named.is_empty() {
        for [a, b, c] in surface.proper_faces() {
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if let Ok(k) = named.binary_search(&edge_key(p, q)) {
                    found[k] = true;
                }
            }
        }
    }
    let is_missing = |&[a, b]: &[u32; 2]| named.binary_search(&edge_key(a, b)).is_ok_and(|k| !found[k]);
    match pairs.iter().position(is_missing) {
        None => Ok(named),
        Some(k) => Err(Error::invalid(
            format!("subdivide.creases[{}]", 2 * k),
            "and the vertex after it are not joined by an edge",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::patch::{PatchedSurface, apply_patch};
    use crate::subdivide::{SubdivisionScheme, subdivide_region};
    use crate::surface::TestSurface;
    use pliant_exec::progress::Silent;

    /// A cube of 12 triangles from −1 to 1.
    fn cube() -> TestSurface {
        let corner = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2 & 1)) * 2.0 - 1.0;
        let sides = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        let halves = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
        TestSurface::new(
            (0..8).map(corner).collect::<Vec<DVec3>>(),
            halves.collect::<Vec<[u32; 3]>>(),
        )
    }

    fn divided(surface: &SurfaceView<'_>, creases: &CreaseOptions<'_>) -> (PatchedSurface, Vec<[u32; 2]>) {
        let all: Vec<u32> = (0..surface.triangles.len() as u32).collect();
        let patch = subdivide_region(surface, &all, SubdivisionScheme::Loop, creases, &Silent).expect("divides");
        let now = apply_patch(surface, &patch, &[0]).expect("applies");
        (now, patch.creases)
    }

    #[test]
    fn a_cube_with_creases_stays_a_cube_and_soft_ones_lie_between() {
        let cube = cube();
        let by_angle = CreaseOptions {
            degrees: Some(30.0),
            ..CreaseOptions::default()
        };
        let (mut now, mut creases) = divided(&cube.view(), &by_angle);
        assert_eq!(creases.len(), 24, "each of twelve edges is two");
        for _ in 0..2 {
            // By the edges that the last division named.
            let named = CreaseOptions {
                edges: &creases,
                ..CreaseOptions::default()
            };
            let (next, left) = divided(&now.surface(), &named);
            (now, creases) = (next, left);
        }
        assert_eq!(creases.len(), 96);
        for x in &now.positions {
            assert!((x.abs().max_element() - 1.0).abs() < 1e-12, "{x}");
        }
        let size = |sharpness: f64| {
            let soft = CreaseOptions { sharpness, ..by_angle };
            divided(&cube.view(), &soft).0.positions[7].max_element()
        };
        let sizes = [0.0, 0.25, 0.5, 1.0, 3.0].map(size);
        assert!(
            sizes[..4].is_sorted_by(|a, b| a < b) && sizes[3] == 1.0 && sizes[4] == 1.0,
            "{sizes:?}"
        );
        let (plain, none) = divided(&cube.view(), &CreaseOptions::default());
        assert_eq!((plain.positions[7].max_element(), none.len()), (sizes[0], 0));
    }

    #[test]
    fn one_crease_ends_as_a_dart_and_pairs_without_an_edge_are_refused() {
        let cube = cube();
        let at = |edges: &[[u32; 2]]| {
            let named = CreaseOptions {
                edges,
                ..CreaseOptions::default()
            };
            divided(&cube.view(), &named).0.positions
        };
        let (smooth, dart, bent) = (at(&[]), at(&[[0, 1]]), at(&[[0, 1], [1, 3]]));
        assert_eq!(dart[..8], smooth[..8], "where a crease ends the old point is smooth");
        assert_ne!(dart, smooth);
        assert_eq!(bent[1], DVec3::new(0.75, -0.75, -1.0), "two creases: their cubic curve");
        let all: Vec<u32> = (0..12).collect();
        for (edges, field) in [
            (&[[0, 1], [0, 7]][..], "subdivide.creases[2]"),
            (&[[2, 2]], "subdivide.creases[0]"),
        ] {
            let named = CreaseOptions {
                edges,
                ..CreaseOptions::default()
            };
            let refused = subdivide_region(&cube.view(), &all, SubdivisionScheme::Loop, &named, &Silent);
            assert!(refused.expect_err("no edge").to_string().contains(field));
        }
    }
}

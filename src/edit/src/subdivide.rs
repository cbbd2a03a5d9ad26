//! Each triangle of a region into four.
//!
//! Neighbours of the region that share a divided edge are split to fit (red and green triangles, Bank et al. 1983), so
//! there is no T-junction; where an edge has several render vertices at an end, each side gets its own middle at the
//! same point. [`SubdivisionScheme::Midpoint`] keeps the shape, [`SubdivisionScheme::Loop`] smooths it.
//!
//! Edges split until what is given at their ends differs little enough, and until they are short enough for it to show.
//!
//! Loop's masks ("Smooth Subdivision Surfaces Based on Triangles", 1987; boundaries after Hoppe et al. 1994), with creases
//! that are sharp or soft (`creases`).

use super::creases::{CreaseEdges, CreaseOptions};
use super::patch::{EditWarning, NewTriangle, NewVertex, SurfacePatch};
use super::region_mesh::{RegionMesh, edge_key};
use super::remesh::MOST_TRIANGLES;
use super::surface::{SurfaceView, check_region};
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Error, NONE};
use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap};
use std::f64::consts::TAU;

/// Where new and old points come to lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SubdivisionScheme {
    /// New points in the middle of edges; old ones stay.
    Midpoint,
    /// The masks of Loop (1987): old points move as well, but for those on the rim of the region. Boundaries follow the
    /// cubic curve of their own points.
    Loop,
}

/// Divides `faces`, rising triangle numbers. Attributes of a new vertex are half and half those at the ends of its edge.
/// With [`SubdivisionScheme::Loop`] edges that are `creases` keep an edge; the patch names what became of them.
///
/// # Errors
/// [`Error::Invalid`] when `faces` is not a region or has no triangle with three points, and for creases that are none;
/// [`Error::TooLarge`] beyond what 32-bit numbers count; [`Error::Cancelled`].
pub fn subdivide_region(
    surface: &SurfaceView,
    faces: &[u32],
    scheme: SubdivisionScheme,
    creases: &CreaseOptions<'_>,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let mesh = RegionMesh::with_frozen_ring(surface, faces)?;
    let edges = mesh.edges();
    // Six list entries a triangle must be countable with 32 bits, see `mesh::Mesh::build`.
    let limit = u64::from(NONE / 6);
    let seen = surface.triangles.len() as u64 + 4 * faces.len() as u64;
    if seen > limit {
        return Err(Error::TooLarge {
            what: "triangles",
            seen,
            limit,
        });
    }
    if edges.is_empty() {
        let problem = "it holds no triangle with three different points";
        return Err(Error::invalid("region", problem));
    }
    let check_at = |k: usize| match k.is_multiple_of(4096) {
        true => check(progress),
        false => Ok(()),
    };
    let asked = creases;
    let creases = CreaseEdges::find(surface, &mesh, &edges, asked)?;
    let mut middles = Vec::with_capacity(edges.len());
    for (k, &(a, b)) in edges.iter().enumerate() {
        check_at(k)?;
        middles.push(match scheme {
            SubdivisionScheme::Midpoint => edge_middle(&mesh, a, b),
            SubdivisionScheme::Loop if creases.contains(a, b) => {
                creases.sharpened(place_new_point(&mesh, a, b), edge_middle(&mesh, a, b))
            }
            SubdivisionScheme::Loop => place_new_point(&mesh, a, b),
        });
    }
    let mut division = Subdivision {
        surface,
        mesh: &mesh,
        middles,
        edges: &edges,
        points: vec![NONE; edges.len()],
        vertices: BTreeMap::new(),
        patch: SurfacePatch::default(),
        next_point: surface.points,
    };
    for f in 0..mesh.faces.len() as u32 {
        check_at(f as usize)?;
        division.divide_face(f);
    }
    let mut patch = division.patch;
    patch.creases = (creases.divided(&edges))
        .flat_map(|(a, b, edge)| {
            let middle = division.points[edge];
            let halves = [a, b].map(|p| [mesh.points[p as usize].old, middle]);
            halves.into_iter().filter(move |_| middle != NONE)
        })
        .collect();
    patch.removed.sort_unstable();
    patch.warnings.extend(creases.warn_of_none(asked));
    if scheme == SubdivisionScheme::Loop {
        for (p, point) in (0u32..).zip(&mesh.points) {
            check_at(p as usize)?;
            let smooth = place_old_point(&mesh, p);
            let place = smooth.map(|smooth| match place_on_crease(&mesh, &creases, p) {
                Some(sharp) => creases.sharpened(smooth, sharp),
                None => smooth,
            });
            if let Some(to) = place.filter(|to| *to != point.position) {
                patch.moved.push((point.old, to));
            }
        }
        patch.moved.sort_unstable_by_key(|m| m.0);
    }
    Ok(patch)
}

struct Subdivision<'a> {
    surface: &'a SurfaceView<'a>,
    mesh: &'a RegionMesh,
    /// The divided edges, sorted, and where their new points are.
    edges: &'a [(u32, u32)],
    middles: Vec<DVec3>,
    /// The number of each edge's new point, once it has one.
    points: Vec<u32>,
    /// The new vertex between two render vertices, the smaller first.
    vertices: BTreeMap<(u32, u32), u32>,
    patch: SurfacePatch,
    next_point: u32,
}

impl Subdivision<'_> {
    /// Replaces face `f` when at least one of its edges is divided.
    fn divide_face(&mut self, f: u32) {
        let face = self.mesh.faces[f as usize];
        let p = face.points;
        let corners = face.wedges.map(|w| self.mesh.wedges[w as usize].vertex);
        // The new vertex opposite to each corner.
        let mut middle = [None; 3];
        for i in 0..3 {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let key = (p[j].min(p[k]), p[j].max(p[k]));
            if let Ok(edge) = self.edges.binary_search(&key) {
                middle[i] = Some(self.middle_vertex(edge, corners[j], corners[k], face.primitive));
            }
        }
        if middle == [None; 3] {
            return;
        }
        self.patch.removed.push(self.mesh.triangles[f as usize]);
        let made = self.cut_into_pieces(corners, middle);
        self.patch.triangles.extend(made.into_iter().map(|corners| NewTriangle {
            primitive: face.primitive,
            corners,
        }));
    }

    /// What a triangle falls into when some sides have a new vertex, named by the corner opposite to them.
    fn cut_into_pieces(&self, corners: [u32; 3], middle: [Option<u32>; 3]) -> Vec<[u32; 3]> {
        if let [Some(x), Some(y), Some(z)] = middle {
            let [a, b, c] = corners;
            return vec![[a, z, y], [b, x, z], [c, y, x], [x, y, z]];
        }
        // Turned so that the side opposite to the first corner is divided and that opposite to the second is not.
        let turn = (0..3).find(|&i| middle[i].is_some() && middle[(i + 1) % 3].is_none());
        let Some(i) = turn else { return Vec::new() };
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let [a, b, c] = [corners[i], corners[j], corners[k]];
        match (middle[i], middle[k]) {
            (Some(x), None) => vec![[a, b, x], [a, x, c]],
            // A triangle at b, and a quad by its shorter diagonal.
            (Some(x), Some(z)) => {
                let at = |v: u32| self.surface.positions[v as usize];
                let (ax, zc) = ((at(b) + at(c)) * 0.5 - at(a), (at(a) + at(b)) * 0.5 - at(c));
                if ax.length_squared() <= zc.length_squared() {
                    vec![[b, x, z], [a, z, x], [a, x, c]]
                } else {
                    vec![[b, x, z], [a, z, c], [z, x, c]]
                }
            }
            _ => Vec::new(),
        }
    }

    fn middle_vertex(&mut self, edge: usize, v: u32, w: u32, primitive: u32) -> u32 {
        let old = self.surface.positions.len() as u32;
        let key = (v.min(w), v.max(w));
        *self.vertices.entry(key).or_insert_with(|| {
            let point = &mut self.points[edge];
            if *point == NONE {
                *point = self.next_point;
                self.next_point += 1;
            }
            self.patch.vertices.push(NewVertex {
                primitive,
                point: *point,
                position: self.middles[edge],
                of: [key.0, key.1, key.0],
                weights: [0.5, 0.5, 0.0],
            });
            old + self.patch.vertices.len() as u32 - 1
        })
    }
}

/// Edges longer than this part of the longest are split together: more than half, so that halves wait until the edges beside
/// them are as short.
const LONGEST_PART: f64 = 0.6;

/// Faces that are looked at between two looks at the progress.
const CHECKED: usize = 4096;

/// Sparse values at a point: numbers of fields, rising, and their values.
pub type FieldSample = Vec<(u32, f32)>;

/// Up to where edges are split.
pub struct EvennessTarget<'a> {
    /// The fields at a point of the surface.
    pub sample: &'a dyn Fn(u32) -> FieldSample,
    /// How much two samples differ.
    pub difference: &'a dyn Fn(&FieldSample, &FieldSample) -> f64,
    /// Edges over which the fields differ by more are split in their middle, where the fields are taken as the mean.
    pub largest: f64,
    /// Edges up to this length are left as they are, model units.
    pub shortest: f64,
    /// How long edges may be in what becomes of a triangle of the surface that is divided for a difference, model units; or why
    /// that cannot be found out.
    pub longest: &'a dyn Fn(u32) -> Result<f64, Error>,
}

/// An edge that is to be split; those inside a triangle of the surface come last, since they may be exchanged for others by
/// then. The longest come first, which keeps triangles fair, then those with the largest difference, then the lowest number.
#[derive(PartialEq)]
struct OpenEdge {
    inside: bool,
    difference: f64,
    length: f64,
    ends: (u32, u32),
}

impl Eq for OpenEdge {}

impl PartialOrd for OpenEdge {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for OpenEdge {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_size = (other.inside.cmp(&self.inside))
            .then(self.length.total_cmp(&other.length))
            .then(self.difference.total_cmp(&other.difference));
        by_size.then(other.ends.cmp(&self.ends))
    }
}

/// Splits the edges of `faces`, rising triangle numbers, until the target is met. Only triangles with an edge over which
/// the fields differ too much are divided. Old points stay where they are, new ones lie on the old faces. A patch that
/// changes nothing comes with the warning `subdivide-nothing`.
///
/// # Errors
/// [`Error::Invalid`] when `faces` is not a region; [`Error::TooLarge`] for more than [`MOST_TRIANGLES`] triangles;
/// [`Error::Cancelled`]; those of the target.
pub fn subdivide_until_even(
    surface: &SurfaceView<'_>,
    faces: &[u32],
    target: &EvennessTarget<'_>,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    check_region(surface, faces)?;
    // All faces at an edge that is too long go beyond the target.
    let sizes = |t: &u32| {
        let corners = surface.triangles[*t as usize];
        let at = corners.map(|v| surface.positions[v as usize]);
        (0..3).any(|k| {
            let ends = [corners[k], corners[(k + 1) % 3]].map(|v| surface.point_of[v as usize]);
            at[k].distance(at[(k + 1) % 3]) > target.shortest
                && (target.difference)(&(target.sample)(ends[0]), &(target.sample)(ends[1])) > target.largest
        })
    };
    let mut uneven: Vec<u32> = Vec::new();
    for (k, &t) in faces.iter().enumerate() {
        if k.is_multiple_of(512) {
            check(progress)?;
        }
        if surface.proper_points(t).is_some() && sizes(&t) {
            uneven.push(t);
        }
    }
    if uneven.is_empty() {
        let message = "no triangle of the region reaches over more than its share of the way between handles";
        return Ok(SurfacePatch {
            warnings: vec![EditWarning::new("subdivide-nothing", message, "region")],
            ..SurfacePatch::default()
        });
    }
    // Triangles beside them are split to fit.
    let mesh = RegionMesh::with_ring(surface, &uneven);
    let mut longest = Vec::with_capacity(mesh.triangles.len());
    for &t in &mesh.triangles {
        check(progress)?;
        longest.push(match uneven.binary_search(&t) {
            Ok(_) => Some((target.longest)(t)?.max(target.shortest)),
            Err(_) => None,
        });
    }
    let samples = mesh.points.iter().map(|p| (target.sample)(p.old)).collect();
    let mut division = EvenDivision {
        mesh,
        longest,
        samples,
        target,
        open: BinaryHeap::new(),
        least: 0.0,
    };
    while division.halve_longest(progress)? {}
    division.mesh.improve_split_faces(|_, _| false, progress)?;
    let (patch, _) = division.mesh.into_finite_patch(surface, Vec::new())?;
    Ok(patch)
}

struct EvenDivision<'a> {
    mesh: RegionMesh,
    /// How long edges may be in what becomes of each gathered face; `None` in those that are only split to fit.
    longest: Vec<Option<f64>>,
    samples: Vec<FieldSample>,
    target: &'a EvennessTarget<'a>,
    open: BinaryHeap<OpenEdge>,
    /// Shorter edges wait for a later turn.
    least: f64,
}

impl EvenDivision<'_> {
    /// Splits the edges that are to be split and longer than [`LONGEST_PART`] of the longest of them. Says whether there was
    /// any.
    ///
    /// Edges inside a triangle of the surface are exchanged for others where that makes fairer triangles, before they are
    /// split: what splits leave along a narrow triangle is nearly as long as that, and would divide it lengthwise.
    fn halve_longest(&mut self, progress: &dyn Progress) -> Result<bool, Error> {
        check(progress)?;
        self.least = 0.0;
        for (k, (a, b)) in self.mesh.edges().into_iter().enumerate() {
            if k.is_multiple_of(512) {
                check(progress)?;
            }
            self.consider(a, b);
        }
        let longest = self.open.iter().fold(0.0f64, |most, edge| most.max(edge.length));
        if self.open.is_empty() {
            return Ok(false);
        }
        self.least = LONGEST_PART * longest;
        let mut looked_at = 0;
        while let Some(OpenEdge {
            ends: (a, b), length, ..
        }) = self.open.pop()
        {
            // Exchanged meanwhile, or for a later turn.
            if length <= self.least || !self.mesh.has_edge(a, b) {
                continue;
            }
            // A step looks at all faces around its points.
            looked_at += 1 + self.mesh.faces_around(a).len() + self.mesh.faces_around(b).len();
            if looked_at > CHECKED {
                looked_at = 0;
                check(progress)?;
            }
            if let Some((p, q)) = self.mesh.exchange_for_fairer(a, b) {
                self.consider(p, q);
                continue;
            }
            if self.mesh.faces.len() as u64 > MOST_TRIANGLES {
                return Err(Error::TooLarge {
                    what: "triangles in the divided region",
                    seen: self.mesh.faces.len() as u64,
                    limit: MOST_TRIANGLES,
                });
            }
            let middle = self.mesh.position(a).lerp(self.mesh.position(b), 0.5);
            let sample = mean_sample(&self.samples[a as usize], &self.samples[b as usize]);
            let m = self.mesh.split_edge(a, b, 0.5, middle);
            self.samples.push(sample);
            let around = self.mesh.neighbours(m).into_iter();
            around.for_each(|p| self.consider(p, m));
        }
        Ok(true)
    }

    /// Puts an edge on the list if it is to be split in this turn.
    fn consider(&mut self, a: u32, b: u32) {
        let sources = (self.mesh.faces_along(a, b)).map(|f| self.mesh.faces[f as usize].source as usize);
        let Some(longest) = sources.filter_map(|f| self.longest[f]).min_by(f64::total_cmp) else {
            return;
        };
        let length = self.mesh.edge_length(a, b);
        if length <= self.least {
            return;
        }
        let difference = (self.target.difference)(&self.samples[a as usize], &self.samples[b as usize]);
        if length > longest || (length > self.target.shortest && difference > self.target.largest) {
            let ends = edge_key(a, b);
            self.open.push(OpenEdge {
                inside: self.mesh.flippable_pair(a, b).is_some(),
                difference,
                length,
                ends,
            });
        }
    }
}

fn mean_sample(a: &FieldSample, b: &FieldSample) -> FieldSample {
    let mut all: FieldSample = a.iter().chain(b).copied().collect();
    all.sort_by_key(|s| s.0);
    let mut mean: FieldSample = Vec::with_capacity(all.len());
    for (field, value) in all {
        match mean.last_mut().filter(|last| last.0 == field) {
            Some(last) => last.1 += 0.5 * value,
            None => mean.push((field, 0.5 * value)),
        }
    }
    mean
}

/// The middle of an edge.
fn edge_middle(mesh: &RegionMesh, a: u32, b: u32) -> DVec3 {
    (mesh.position(a) + mesh.position(b)) * 0.5
}

/// The new point of an edge: between two faces of the region 3/8 of each end and 1/8 of each tip, else the middle.
fn place_new_point(mesh: &RegionMesh, a: u32, b: u32) -> DVec3 {
    let edge = mesh.edge_faces(a, b);
    let tip = |f| mesh.opposite_corner(f, a, b).map(|p| mesh.position(p));
    if mesh.is_locked(edge) || edge.faces().count() != 2 {
        return edge_middle(mesh, a, b);
    }
    match (tip(edge.left), tip(edge.right)) {
        (Some(c), Some(d)) => (mesh.position(a) + mesh.position(b)) * 0.375 + (c + d) * 0.125,
        _ => edge_middle(mesh, a, b),
    }
}

/// Where an old point goes; `None` for one that stays because the faces around it are not all in the region, or make no
/// single fan.
fn place_old_point(mesh: &RegionMesh, p: u32) -> Option<DVec3> {
    let point = &mesh.points[p as usize];
    if point.fixed {
        return None;
    }
    let around = mesh.neighbours(p);
    let rim: Vec<u32> = (around.iter().copied())
        .filter(|&q| mesh.edge_faces(p, q).faces().count() == 1)
        .collect();
    match (rim.as_slice(), around.len()) {
        ([], n @ 3..) => {
            let beta = neighbour_weight(n);
            let sum: DVec3 = around.iter().map(|&q| mesh.position(q)).sum();
            Some(point.position * (1.0 - n as f64 * beta) + sum * beta)
        }
        (&[a, b], _) => Some(point.position * 0.75 + (mesh.position(a) + mesh.position(b)) * 0.125),
        _ => None,
    }
}

/// Where a point goes that creases lead to, were they wholly sharp; `None` where less than two do. Boundaries are creases
/// as well: where another one meets them the point stays.
fn place_on_crease(mesh: &RegionMesh, creases: &CreaseEdges, p: u32) -> Option<DVec3> {
    let along = creases.at(p);
    if along.is_empty() {
        return None;
    }
    let rim = mesh
        .neighbours(p)
        .into_iter()
        .filter(|&q| mesh.edge_faces(p, q).faces().count() == 1);
    let sharp: Vec<u32> = rim.chain(along.iter().copied()).collect();
    match sharp[..] {
        [] | [_] => None,
        [a, b] => Some(mesh.position(p) * 0.75 + (mesh.position(a) + mesh.position(b)) * 0.125),
        _ => Some(mesh.position(p)),
    }
}

/// The weight of each of `n` neighbours.
fn neighbour_weight(n: usize) -> f64 {
    let n = n as f64;
    let c = 0.375 + 0.25 * libm::cos(TAU / n);
    (0.625 - c * c) / n
}

#[cfg(test)]
mod masks_tests {
    use super::*;

    #[test]
    fn the_weights_are_those_of_the_paper() {
        assert!((neighbour_weight(3) - 3.0 / 16.0).abs() < 1e-15);
        assert!((neighbour_weight(6) - 1.0 / 16.0).abs() < 1e-15);
    }
}

//! Edges split until what is given at their ends differs little enough.

use crate::edit::error::Error;
use crate::edit::patch::{EditWarning, SurfacePatch};
use crate::edit::region_mesh::{RegionMesh, edge_key};
use crate::edit::remesh::MOST_TRIANGLES;
use crate::edit::surface::{SurfaceView, check_region};
use crate::progress::{Progress, check};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

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
}

/// An edge that is to be split; those with the largest difference come first, then the longest, then the lowest number.
#[derive(PartialEq)]
struct OpenEdge {
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
        let by_size = self
            .difference
            .total_cmp(&other.difference)
            .then(self.length.total_cmp(&other.length));
        by_size.then(other.ends.cmp(&self.ends))
    }
}

/// Splits the edges of `faces`, rising triangle numbers, until the target is met. Old points stay where they are, new ones
/// lie on the old faces. A patch that changes nothing comes with the warning `subdivide-nothing`.
///
/// # Errors
/// [`Error::Invalid`] when `faces` is no region; [`Error::TooLarge`] when more than [`MOST_TRIANGLES`] would come;
/// [`Error::Cancelled`].
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
    let uneven: Vec<u32> = faces
        .iter()
        .copied()
        .filter(|t| surface.proper_points(*t).is_some() && sizes(t))
        .collect();
    if uneven.is_empty() {
        let message = "no triangle of the region reaches over more than its share of the way between handles";
        return Ok(SurfacePatch {
            warnings: vec![EditWarning::new("subdivide-nothing", message, "region")],
            ..SurfacePatch::default()
        });
    }
    let mesh = RegionMesh::from_triangles(surface, uneven);
    let samples = mesh.points.iter().map(|p| (target.sample)(p.old)).collect();
    let mut division = EvenDivision {
        mesh,
        samples,
        target,
        open: BinaryHeap::new(),
    };
    division.run(progress)?;
    division.mesh.improve_split_faces(|_, _| false);
    let (patch, _) = division.mesh.into_finite_patch(surface, Vec::new())?;
    Ok(patch)
}

struct EvenDivision<'a> {
    mesh: RegionMesh,
    samples: Vec<FieldSample>,
    target: &'a EvennessTarget<'a>,
    open: BinaryHeap<OpenEdge>,
}

impl EvenDivision<'_> {
    fn run(&mut self, progress: &dyn Progress) -> Result<(), Error> {
        for (a, b) in self.mesh.edges() {
            self.consider(a, b);
        }
        let mut splits = 0u64;
        while let Some(OpenEdge { ends: (a, b), .. }) = self.open.pop() {
            splits += 1;
            if splits.is_multiple_of(4096) {
                check(progress)?;
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
            let mut around: Vec<u32> = Vec::new();
            for &f in self.mesh.faces_around(m) {
                around.extend(self.mesh.points_of(f).into_iter().filter(|&p| p != m));
            }
            around.sort_unstable();
            around.dedup();
            around.into_iter().for_each(|p| self.consider(p, m));
        }
        Ok(())
    }

    /// Puts an edge on the list if it is to be split. Each edge is considered once, when it comes to be.
    fn consider(&mut self, a: u32, b: u32) {
        let length = self.mesh.position(a).distance(self.mesh.position(b));
        let difference = (self.target.difference)(&self.samples[a as usize], &self.samples[b as usize]);
        if length > self.target.shortest && difference > self.target.largest {
            let ends = edge_key(a, b);
            self.open.push(OpenEdge {
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

//! What is wrong with a shape where handles leave it free: faces folded onto their neighbours, and faces that cross others.

use crate::folds::FaceSurroundings;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Cancelled;
use pliant_mesh::{Mesh, is_crossing, visit_crossings_within};
use rayon::prelude::*;
use std::sync::{Mutex, OnceLock, PoisonError};

/// Neighbours are folded onto each other where the cosine of the angle between their normals is below this (120°), and was above 0
/// in the rest pose.
const FOLDED: f64 = -0.5;
/// An edge is sharp where the cosine is below this (60°),
const SHARP: f64 = 0.5;
/// and by this less than in the rest pose.
const SHARPER: f64 = 0.25;
/// What a fold weighs against a crossing: two faces folded onto each other mostly cross a few others.
const FOLD: usize = 4;
/// How far around known faults those of another shape are looked for at first, in faces.
const RINGS: usize = 8;
/// Pairs of overlapping boxes that a search looks at, at most, for each face and beside them. Bent surfaces have some 30 for each face;
/// where a shape has collapsed all may overlap all, and nothing is found that would cure it.
const OVERLAPS_PER_FACE: u64 = 1024;
const LEAST_OVERLAPS: u64 = 1 << 20;
/// Faces that one piece of work handles at least.
const PIECE: usize = 4096;

/// The part of a surface that handles leave free, in the rest pose.
pub struct FreeSurface<'a> {
    mesh: &'a Mesh,
    /// By face: whether it has a free corner.
    is_free: Vec<bool>,
    /// Neighbours across an edge, one of them free at least, with the cosine of the angle between their normals in the rest pose.
    pairs: Vec<([u32; 2], f64)>,
}

/// What is wrong with a shape.
#[derive(Debug, Clone, Default)]
pub struct SurfaceFaults {
    /// Pairs of faces that cross and did not in the rest pose, one of them free at least.
    pub crossings: Vec<[u32; 2]>,
    /// Pairs of neighbours that are folded onto each other and were not in the rest pose.
    pub folds: Vec<[u32; 2]>,
}

impl SurfaceFaults {
    /// What they weigh together.
    pub fn weight(&self) -> usize {
        self.crossings.len() + FOLD * self.folds.len()
    }

    /// The faces that have a part in them; some more than once.
    pub fn faces(&self) -> impl Iterator<Item = u32> {
        self.crossings.iter().chain(&self.folds).flatten().copied()
    }
}

impl<'a> FreeSurface<'a> {
    /// The faces of which a corner is not `given`.
    pub fn of(mesh: &'a Mesh, surroundings: &OnceLock<FaceSurroundings>, given: &[bool], pool: &Pool) -> Self {
        pool.install(|| {
            let around = surroundings.get_or_init(|| FaceSurroundings::of(mesh));
            let is_free: Vec<bool> = (mesh.triangles.par_iter().with_min_len(PIECE))
                .map(|t| t.iter().any(|&v| !given[v as usize]))
                .collect();
            let at_rest = unit_normals(mesh, &mesh.positions);
            let (of, at_rest) = (&is_free, &at_rest);
            let neighbours = |t: u32| {
                let corners = mesh.triangles[t as usize];
                (0..3).flat_map(move |k| {
                    let [a, b] = [corners[k], corners[(k + 1) % 3]];
                    let others = around.faces_of(a).iter().copied();
                    others.filter(move |&o| {
                        (o > t || (o < t && !of[o as usize])) && mesh.triangles[o as usize].contains(&b)
                    })
                })
            };
            let free = (0..of.len() as u32)
                .into_par_iter()
                .with_min_len(PIECE)
                .filter(|&t| of[t as usize]);
            let pairs = free
                .flat_map_iter(|t| neighbours(t).map(move |o| ([t, o], cosine(at_rest, [t, o]))))
                .collect();
            Self { mesh, is_free, pairs }
        })
    }

    /// Whether neighbours are folded onto each other, or faces cross others where the surface is bent sharply: a quick look, for the
    /// exact one takes longer. Parts that pass through each other without a bend, as an arm through a chest, are not looked for. A shape
    /// of which nearly all faces overlap is none that can be cured.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn is_suspect(&self, now: &[DVec3], exec: &Exec<'_>) -> Result<bool, Cancelled> {
        let normals = exec.pool.install(|| unit_normals(self.mesh, now));
        let mut is_sharp = vec![false; self.is_free.len()];
        for &(pair, before) in &self.pairs {
            let after = cosine(&normals, pair);
            if is_fold(before, after) {
                return Ok(true);
            }
            if after < SHARP.min(before - SHARPER) {
                pair.iter().for_each(|&t| is_sharp[t as usize] = true);
            }
        }
        let crossings = self.crossings(now, &is_sharp, exec)?;
        Ok(crossings.is_some_and(|crossings| !crossings.is_empty()))
    }

    /// Counts the faults of a shape; `None` where nearly all of its faces overlap.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn faults(&self, now: &[DVec3], exec: &Exec<'_>) -> Result<Option<SurfaceFaults>, Cancelled> {
        let crossings = self.crossings(now, &self.is_free, exec)?;
        Ok(crossings.map(|crossings| SurfaceFaults {
            folds: self.folds(now, exec),
            crossings,
        }))
    }

    /// As [`FreeSurface::faults`] where they weigh less than those `before`, of another shape of the same pose; `None` where they do not,
    /// which mostly shows around the faces that these have.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn fewer_faults(
        &self,
        now: &[DVec3],
        before: &SurfaceFaults,
        exec: &Exec<'_>,
    ) -> Result<Option<SurfaceFaults>, Cancelled> {
        let mut faults = SurfaceFaults {
            crossings: Vec::new(),
            folds: self.folds(now, exec),
        };
        for is_asked in [&self.free_around(before), &self.is_free] {
            if faults.weight() >= before.weight() {
                return Ok(None);
            }
            match self.crossings(now, is_asked, exec)? {
                Some(crossings) => faults.crossings = crossings,
                None => return Ok(None),
            }
        }
        Ok((faults.weight() < before.weight()).then_some(faults))
    }

    /// By face: whether it is free and has a part in faults, or is near one that has.
    fn free_around(&self, faults: &SurfaceFaults) -> Vec<bool> {
        let mut is_near = vec![false; self.is_free.len()];
        faults.faces().for_each(|t| is_near[t as usize] = true);
        for _ring in 0..RINGS {
            let one_is_near = |([t, o], _): &&([u32; 2], f64)| is_near[*t as usize] != is_near[*o as usize];
            let met: Vec<[u32; 2]> = self.pairs.iter().filter(one_is_near).map(|(pair, _)| *pair).collect();
            met.as_flattened().iter().for_each(|&t| is_near[t as usize] = true);
        }
        is_near
            .iter()
            .zip(&self.is_free)
            .map(|(near, free)| *near && *free)
            .collect()
    }

    /// Pairs of neighbours that are folded onto each other and were not in the rest pose.
    fn folds(&self, now: &[DVec3], exec: &Exec<'_>) -> Vec<[u32; 2]> {
        let normals = exec.pool.install(|| unit_normals(self.mesh, now));
        let folded = |(pair, before): &&([u32; 2], f64)| is_fold(*before, cosine(&normals, *pair));
        self.pairs.iter().filter(folded).map(|(pair, _)| *pair).collect()
    }

    /// Pairs that cross and did not in the rest pose, one of them asked for at least; `None` where too many overlap.
    fn crossings(&self, now: &[DVec3], is_asked: &[bool], exec: &Exec<'_>) -> Result<Option<Vec<[u32; 2]>>, Cancelled> {
        let Mesh {
            positions, triangles, ..
        } = self.mesh;
        let origin = self.mesh.bounds().origin();
        let found = Mutex::new(Vec::new());
        let keep_new = |pair| {
            if !is_crossing(positions, origin, triangles, pair) {
                found.lock().unwrap_or_else(PoisonError::into_inner).push(pair);
            }
        };
        if !visit_crossings_within(
            most_overlaps(triangles),
            now,
            triangles,
            Some(is_asked),
            &keep_new,
            exec,
        )? {
            return Ok(None);
        }
        let mut found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
        found.sort_unstable();
        Ok(Some(found))
    }
}

/// Pairs of overlapping boxes that a search for crossings looks at in a surface that is to be mended.
pub(crate) fn most_overlaps(triangles: &[[u32; 3]]) -> u64 {
    LEAST_OVERLAPS + OVERLAPS_PER_FACE * triangles.len() as u64
}

fn is_fold(before: f64, after: f64) -> bool {
    after < FOLDED && before > 0.0
}

fn cosine(normals: &[DVec3], [t, o]: [u32; 2]) -> f64 {
    normals[t as usize].dot(normals[o as usize])
}

/// Unit normals of all faces; 0 for one without area. Runs on the pool of the caller.
fn unit_normals(mesh: &Mesh, at: &[DVec3]) -> Vec<DVec3> {
    let normal = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| at[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    mesh.triangles.par_iter().with_min_len(PIECE).map(normal).collect()
}

//! Colours that stand for numbers, and for what crosses what.

use crate::exec::Exec;
use crate::mesh::brief_number;
use crate::mesh::{Crossing, CrossingPair, Mesh, PairKind, Weld};
use crate::pool::Pool;
use crate::progress::Silent;
use crate::render::{ColourRamp, Error};
use glam::{DVec3, Vec3};

/// The colours of numbers; `unit` is the one at the end of the ramp.
pub(in crate::cli) fn heat_colours(values: &[f64], ramp: ColourRamp, unit: f64) -> Vec<Vec3> {
    values.iter().map(|x| ramp.linear_colour(x / unit)).collect()
}

/// For each of the triangles what it crosses, by the test of `output.selfIntersections`. With positions in the rest pose, pairs that
/// cross there too are not new.
pub(in crate::cli) fn crossings_by_triangle(
    positions: &[DVec3],
    rest: Option<&[DVec3]>,
    triangles: &[[u32; 3]],
    pool: &Pool,
) -> Result<Vec<Crossing>, Error> {
    // Seams are closed as the deformer closes them: in the rest pose.
    let mesh = Mesh::build(rest.unwrap_or(positions), triangles, Weld::Exact)?;
    let found = mesh.crossing_triangles(positions, rest, triangles.len(), &Exec::new(pool, &Silent));
    Ok(found.unwrap_or_else(|_| vec![Crossing::None; triangles.len()]))
}

/// Pairs of triangles that are looked at for depths.
const MOST_PAIRS: usize = 1_000_000;

/// Pairs of triangles that cross, each with how deep. With positions in the rest pose those alone that do not cross there.
pub(in crate::cli) struct Contacts(Vec<CrossingPair>);

impl Contacts {
    /// Finds them, by the test of `output.selfIntersections`.
    pub fn of(positions: &[DVec3], rest: Option<&[DVec3]>, triangles: &[[u32; 3]], pool: &Pool) -> Result<Self, Error> {
        let before = rest.unwrap_or(positions);
        let mesh = Mesh::build(before, triangles, Weld::Exact)?;
        let exec = Exec::new(pool, &Silent);
        let found = mesh.crossing_pairs(positions, before, &|_| false, MOST_PAIRS, &exec);
        let mut pairs = found.unwrap_or_default().pairs;
        pairs.retain(|pair| rest.is_none() || pair.kind == PairKind::New);
        Ok(Self(pairs))
    }

    /// For each of so many vertices the depth of the deepest pair that it is a corner of, model units; 0 without one.
    pub fn depths(&self, vertices: usize, triangles: &[[u32; 3]]) -> Vec<f64> {
        let mut depths = vec![0.0f64; vertices];
        for pair in &self.0 {
            for &v in pair.triangles.iter().flat_map(|t| &triangles[*t as usize]) {
                depths[v as usize] = pair.depth.max(depths[v as usize]);
            }
        }
        depths
    }

    /// Says how many there are, and how deep.
    pub fn words(&self) -> String {
        let deepest = self.0.iter().fold(0.0, |most: f64, pair| most.max(pair.depth));
        match self.0.len() {
            0 => "0 pairs cross".into(),
            count => format!("{count} pairs cross, up to {} deep", brief_number(deepest)),
        }
    }
}

/// Says how many triangles cross others.
pub(in crate::cli) fn crossing_words(crossings: &[Crossing], has_rest: bool) -> String {
    let count = |kind: Crossing| crossings.iter().filter(|c| **c == kind).count();
    let new = count(Crossing::New);
    match has_rest {
        true => format!("{new} cross, {} crossed before", count(Crossing::AtRest)),
        false => format!("{new} triangles cross"),
    }
}

//! From a pose in which nothing crosses to one in which surfaces do, in small steps.
//!
//! What is near before a step stays on the side on which it is: a vertex before a face, an edge beside an edge, along the way between
//! their closest places. The displacement that keeps it so is as smooth as these conditions allow ([`super::displace`]). A step after
//! which more crosses than before is taken again in two halves, down to a smallest one. The prevention of contact by such conditions, and the
//! search for the largest step without it, are those of Li et al., *Incremental potential contact* (2020); here no forces are solved for.

use super::displace::DisplacementProblem;
use super::find::Condition;
use super::nearness::NearSearch;
use super::pose_path::PosePath;
use super::{
    CONTOUR_STYLE, ContactFaults, ContactSurface, Knowledge, MOST_PARTED, PartedShape, Parting, RestCrossings,
    displaced,
};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;

/// Parts of the pose that are solved, the last first, until one of them does not cross.
const PARTS: [f64; 3] = [0.7, 0.4, 0.0];
/// The first step, of the way between two of them,
const FIRST_STEP: f64 = 0.25;
/// and the smallest.
const LEAST_STEP: f64 = 0.25;
/// What surfaces keep from each other on the way, clearances.
const WIDE: f64 = 2.0;
/// How often the displacement of a step is solved for,
const SOLVES: usize = 2;
/// how often in each of them it is chosen which conditions hold with equality,
const CHOICES: usize = 2;
/// and by what part of what is missing a condition asks for more after each.
const RATE: f64 = 0.7;
/// Steps that stay in the last shape, so that what the way has left goes.
const LAST_STEPS: usize = 2;
/// What part of what they lack to their rest lengths edges are given back in a step,
const LENGTHS: f64 = 0.5;
/// and in one that stays in the last shape.
const LAST_LENGTHS: f64 = 1.0;
/// A shape without crossings is relaxed where edges are further from their rest lengths than so many times as far as before,
const STRAINED: f64 = 1.05;
/// so often at most,
const RELAXED: usize = 3;
/// each time by the first of these parts of a step after which nothing crosses.
const RELAXED_BY: [f64; 3] = [1.0, 0.5, 0.25];

/// A shape on the way, with its displacement.
#[derive(Clone)]
struct PathShape {
    at: Vec<DVec3>,
    /// By free node.
    moved: Vec<DVec3>,
    /// Pairs of faces that cross.
    crossings: usize,
}

impl ContactSurface<'_> {
    /// Goes from the last part of a pose without crossings to the `end`, all of it. `None` where there is no such part, or the surface is
    /// so crumpled that nothing can be said.
    pub(super) fn follow<P: PosePath>(
        &self,
        end: &[DVec3],
        path: &mut P,
        exec: &Exec<'_>,
    ) -> Result<Option<Vec<DVec3>>, P::Error> {
        let mut shapes = vec![end.to_vec()];
        let mut seen = self.crossings(end, None, exec)?.unwrap_or_default();
        for part in PARTS {
            let shape = path.shape_at(part)?;
            let found = self.crossings(&shape, None, exec)?;
            shapes.push(shape);
            match found {
                Some(found) if found.is_empty() => {
                    shapes.reverse();
                    seen.sort_unstable();
                    seen.dedup();
                    let places = ContactFaults {
                        crossings: seen,
                        misplaced: Vec::new(),
                    };
                    return Ok(Parting::of(self, end, &places).walk(&shapes, exec)?);
                }
                Some(found) if seen.len() + found.len() <= MOST_PARTED => seen.extend(found),
                _ => return Ok(None),
            }
        }
        Ok(None)
    }
}

impl Parting<'_> {
    /// Goes from the first to the last of some shapes. `None` where too much is near to be looked at.
    fn walk(&self, shapes: &[Vec<DVec3>], exec: &Exec<'_>) -> Result<Option<Vec<DVec3>>, Cancelled> {
        let search = NearSearch::new(self.surface.mesh, &self.region, self.surface.layers);
        let mut now = PathShape {
            at: shapes[0].clone(),
            moved: vec![DVec3::ZERO; self.region.free],
            crossings: 0,
        };
        let mut step = FIRST_STEP;
        for pair in shapes.windows(2) {
            let mut done = 0.0;
            let Some(mut conditions) = search.conditions(&now.at, WIDE * self.clearance, exec)? else {
                return Ok(None);
            };
            while done < 1.0 {
                let next = f64::min(done + step, 1.0);
                let base: Vec<DVec3> = pair[0].iter().zip(&pair[1]).map(|(a, b)| a.lerp(*b, next)).collect();
                let Some(there) = self.step(&now, &base, conditions.clone(), LENGTHS, exec)? else {
                    return Ok(None);
                };
                if there.crossings > now.crossings && step > LEAST_STEP {
                    step /= 2.0;
                    continue;
                }
                (now, done, step) = (there, next, f64::min(step * 2.0, 1.0));
                match search.conditions(&now.at, WIDE * self.clearance, exec)? {
                    Some(found) => conditions = found,
                    None => return Ok(None),
                }
            }
        }
        for _ in 0..LAST_STEPS {
            let end = shapes.last().map_or(self.base, Vec::as_slice);
            let Some(conditions) = search.conditions(&now.at, WIDE * self.clearance, exec)? else {
                return Ok(None);
            };
            match self.step(&now, end, conditions, LAST_LENGTHS, exec)? {
                Some(there) if there.crossings <= now.crossings => now = there,
                _ => break,
            }
        }
        Ok(Some(now.at))
    }

    /// Takes back of the `best` shape, in which nothing crosses, what its edges do not need.
    pub(super) fn relax(&self, best: &mut PartedShape, exec: &Exec<'_>) -> Result<(), Cancelled> {
        let search = NearSearch::new(self.surface.mesh, &self.region, self.surface.layers);
        // Vertices around the region stay where they are in the best shape.
        let (mut base, mut moved) = (best.at.clone(), Vec::new());
        for v in self.region.nodes[..self.region.free].iter().map(|v| *v as usize) {
            base[v] = self.base[v];
            moved.push(best.at[v] - base[v]);
        }
        for _ in 0..RELAXED {
            let is_posed = self.surface.at_rest == RestCrossings::Stay;
            if !is_posed || best.faults > 0 || best.strain <= STRAINED * self.before.strain {
                break;
            }
            let Some(conditions) = search.conditions(&best.at, self.clearance, exec)? else {
                break;
            };
            let now = PathShape {
                at: best.at.clone(),
                moved: moved.clone(),
                crossings: 0,
            };
            let Some(there) = self.step(&now, &base, conditions, LAST_LENGTHS, exec)? else {
                break;
            };
            for part in RELAXED_BY {
                moved = (now.moved.iter().zip(&there.moved))
                    .map(|(a, b)| a.lerp(*b, part))
                    .collect();
                self.weigh(displaced(&base, &self.region, &moved), best, exec)?;
                if best.at != now.at {
                    break;
                }
            }
            if best.at == now.at {
                break;
            }
        }
        Ok(())
    }

    /// Goes to the shape beside `base` in which conditions hold, and edges have a part of what they lack to their rest lengths. `None`
    /// where nearly all faces overlap.
    fn step(
        &self,
        from: &PathShape,
        base: &[DVec3],
        mut conditions: Vec<Condition>,
        lengths: f64,
        exec: &Exec<'_>,
    ) -> Result<Option<PathShape>, Cancelled> {
        exec.check()?;
        let region = &self.region;
        let finder = self.finder(CONTOUR_STYLE, Vec::new(), Knowledge::default());
        let now = displaced(base, region, &from.moved);
        let problem = DisplacementProblem::new(&finder, base, &self.rest_bend)
            .keeping_volume(base, &now, &from.moved)
            .restoring_lengths(&now, lengths);
        let mut moved = from.moved.clone();
        let mut at = Vec::new();
        for _ in 0..SOLVES {
            problem.improve(conditions.clone(), CHOICES, &mut moved, exec)?;
            at = displaced(base, region, &moved);
            for condition in &mut conditions {
                let gap = condition.between(&at).dot(condition.direction);
                condition.shift = (condition.shift + RATE * (condition.least - gap)).clamp(0.0, region.edge);
            }
        }
        let found = self.surface.crossings(&at, Some(&region.is_near), exec)?;
        Ok(found.map(|found| PathShape {
            at,
            moved,
            crossings: found.len(),
        }))
    }
}

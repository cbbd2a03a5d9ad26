//! The state of a drag in the order of the solver's rows: the last solution, and what finds a node in it.

use crate::deform::body::DeformableBody;
use crate::deform::handles::ownership::NOBODY;
use crate::deform::handles::system::HandleSystem;
use crate::deform::transform::Transform;
use crate::pool::Pool;
use crate::solver::PoseRows;
use glam::DVec3;

/// A row without a node.
pub(super) const NO_NODE: u32 = u32::MAX;

/// Given nodes that one hold has.
#[derive(Debug, Clone, Copy)]
struct HeldNodes {
    hold: usize,
    count: f64,
    /// Their mean rest position, model space.
    mean: DVec3,
}

/// The last solution of a drag, row by row.
#[derive(Debug, Default)]
pub(in crate::deform) struct DragRows {
    pub(super) pose: PoseRows,
    /// The row of each node.
    pub(super) row_of: Vec<u32>,
    /// What `pose.x` is relative to, solving coordinates.
    pub(super) center: DVec3,
    held: Vec<HeldNodes>,
    /// Given nodes that no hold moves: how many, and the sum of their rest positions, solving coordinates.
    unmoved: (f64, DVec3),
    /// The last solution is here, and not in the order of nodes.
    is_newest: bool,
}

impl DragRows {
    /// Takes over the last solution, `x` in the order of nodes, which is given up; where that is empty, the rest shape.
    pub(super) fn take_over(&mut self, body: &DeformableBody, rig: &HandleSystem, x: &mut Vec<f64>, pool: &Pool) {
        if self.is_newest {
            return;
        }
        let vertices = body.hierarchy.row_vertices();
        let Self { pose, row_of, .. } = self;
        let rest = |node: usize| body.rest(node).to_array();
        let start = |node: usize| match x.get(3 * node..3 * node + 3) {
            Some(at) => [at[0], at[1], at[2]],
            None => rest(node),
        };
        let find_rows = || {
            row_of.clear();
            row_of.resize(body.nodes(), 0);
            for (row, &node) in vertices.iter().enumerate().filter(|(_, v)| **v != NO_NODE) {
                row_of[node as usize] = row as u32;
            }
        };
        // Finding rows takes one thread; poses have work for the others.
        pool.install(|| rayon::join(|| pose.begin(&body.hierarchy, rest, start, pool), find_rows));
        self.center = DVec3::ZERO;
        self.find_held(body, rig);
        *x = Vec::new();
        self.is_newest = true;
    }

    /// Gives the last solution back in the order of nodes, if it is here.
    pub(in crate::deform) fn hand_over(&mut self, body: &DeformableBody, x: &mut Vec<f64>) {
        if !self.is_newest {
            return;
        }
        self.is_newest = false;
        x.clear();
        x.extend(self.row_of.iter().flat_map(|&row| {
            let here = &self.pose.x[row as usize];
            [
                here[0] + self.center.x,
                here[1] + self.center.y,
                here[2] + self.center.z,
            ]
        }));
        debug_assert!(x.len() == body.nodes() * 3);
    }

    /// Whether the last solution is here.
    pub(super) fn is_newest(&self) -> bool {
        self.is_newest
    }

    /// Gives memory back that does not hold the last solution.
    pub(super) fn release(&mut self) {
        if !self.is_newest {
            (self.pose, self.row_of) = (PoseRows::default(), Vec::new());
        }
    }

    /// Forgets the last solution.
    pub(in crate::deform) fn let_go(&mut self) {
        self.is_newest = false;
    }

    fn find_held(&mut self, body: &DeformableBody, rig: &HandleSystem) {
        let holds = rig.handle_count();
        let mut held = vec![(0.0, DVec3::ZERO); holds];
        self.unmoved = (0.0, DVec3::ZERO);
        for (node, _) in rig.given().iter().enumerate().filter(|(_, given)| **given) {
            let k = rig.position.hard[node];
            match held.get_mut(k as usize).filter(|_| k != NOBODY) {
                Some((count, sum)) => {
                    *count += 1.0;
                    *sum += body.graph.positions[node];
                }
                None => {
                    self.unmoved.0 += 1.0;
                    self.unmoved.1 += body.rest(node);
                }
            }
        }
        self.held.clear();
        let some = held.into_iter().enumerate().filter(|(_, (count, _))| *count > 0.0);
        self.held.extend(some.map(|(hold, (count, sum))| HeldNodes {
            hold,
            count,
            mean: sum / count,
        }));
    }

    /// The mean of what is held, solving coordinates; the origin where nothing is.
    pub(super) fn mean_of_held(&self, body: &DeformableBody, transforms: &[Transform]) -> DVec3 {
        let (mut count, mut sum) = self.unmoved;
        for held in &self.held {
            let place = transforms.get(held.hold).map_or(held.mean, |t| t.map()(held.mean));
            count += held.count;
            sum += body.solving_from_model(place) * held.count;
        }
        if count > 0.0 { sum / count } else { DVec3::ZERO }
    }

    /// Bytes held on the heap.
    pub(super) fn byte_size(&self) -> usize {
        self.pose.byte_size() + 4 * self.row_of.capacity() + size_of::<HeldNodes>() * self.held.capacity()
    }
}

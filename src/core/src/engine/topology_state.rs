//! How the bodies of edited models came about: from a model on, edit after edit.
//!
//! A body after an edit is that before, repaired; so it depends on all edits since a body was last built from nothing.
//! For each edit the change of the mesh is stored, and the graph's nodes where a deformation had moved them. Repeating
//! the edits gives the same bits, without solving.
//!
//! What an edit changed of the solver's mesh, small enough to be kept: enough to make the mesh after it from that before.

use crate::deform::{BodyOptions, DeformableBody, TieOptions};
use crate::edit::PatchedSurface;
use crate::engine::error::Error;
use crate::engine::model_topology::ModelTopology;
use crate::engine::settings::OpenOptions;
use crate::engine::shape::TopologyId;
use crate::exec::Exec;
use crate::graph::MeshChange;
use crate::mesh::{Mesh, NONE};
use glam::DVec3;
use std::sync::Arc;

/// After so many edits a body is built from nothing.
const LONGEST: u32 = 64;

/// The state of a deformer but for its handles and its shape, to go back to.
#[derive(Debug, Clone)]
pub struct TopologyState(pub(super) Arc<TopologyLineage>);

/// A model topology, and how its body came about.
#[derive(Debug)]
pub(super) struct TopologyLineage {
    /// Which state of the deformer it is.
    pub id: TopologyId,
    pub topology: Arc<ModelTopology>,
    pub past: LineageOrigin,
}

/// Where a body comes from.
#[derive(Debug, Clone)]
pub(super) enum LineageOrigin {
    /// It is built from this.
    Built(Arc<ModelTopology>),
    /// It follows another one.
    Edited(Arc<LineageEdit>),
}

/// An edit of a mesh whose body followed.
#[derive(Debug)]
pub(super) struct LineageEdit {
    before: LineageOrigin,
    delta: MeshDelta,
    /// All nodes where a deformation, which is the rest shape now, left them.
    nodes: Option<Arc<Vec<DVec3>>>,
    /// How parts are tied after it.
    ties: Option<TieOptions>,
    length: u32,
    /// Bytes of this step and those before it.
    bytes: u64,
}

impl TopologyState {
    /// Returns the name of the state, unique within one deformer.
    pub fn id(&self) -> TopologyId {
        self.0.id
    }

    /// Whether two are the same state.
    pub fn is_same(&self, other: &Self) -> bool {
        self.id() == other.id()
    }

    /// Bytes that only this state holds, about.
    pub fn byte_size(&self) -> u64 {
        let step = match &self.0.past {
            LineageOrigin::Built(_) => 0,
            LineageOrigin::Edited(step) => step.own_bytes(),
        };
        let topology = &self.0.topology;
        step + topology.edited.as_ref().map_or(0, |_| topology.byte_size())
    }
}

impl TopologyLineage {
    /// Of a model whose body is built.
    pub fn from_built(id: TopologyId, topology: Arc<ModelTopology>) -> Self {
        Self {
            id,
            past: LineageOrigin::Built(Arc::clone(&topology)),
            topology,
        }
    }
}

impl LineageOrigin {
    /// One edit more; `None` when there have been so many that a body is to be built from nothing. The bytes of all of them
    /// stay below `most`.
    pub fn followed_by(
        &self,
        delta: MeshDelta,
        nodes: Option<Arc<Vec<DVec3>>>,
        ties: Option<TieOptions>,
        most: u64,
    ) -> Option<Arc<LineageEdit>> {
        let (length, bytes) = match self {
            Self::Built(_) => (0, 0),
            Self::Edited(step) => (step.length, step.bytes),
        };
        let mut step = LineageEdit {
            before: self.clone(),
            delta,
            nodes,
            ties,
            length: length + 1,
            bytes: 0,
        };
        step.bytes = bytes + step.own_bytes();
        (step.length <= LONGEST && step.bytes <= most).then(|| Arc::new(step))
    }

    /// Makes the body again, with the points and triangles of its mesh. `None` when an edit could not be followed, which
    /// cannot be where it once was.
    pub fn retrace(
        &self,
        options: &OpenOptions,
        fit: &dyn Fn(&ModelTopology, &Mesh) -> Result<BodyOptions, Error>,
        exec: &Exec<'_>,
    ) -> Result<Option<RetracedBody>, Error> {
        let mut steps = Vec::new();
        let mut at = self;
        let start = loop {
            match at {
                Self::Built(topology) => break topology,
                Self::Edited(step) => {
                    steps.push(step);
                    at = &step.before;
                }
            }
        };
        let mesh = start.mesh(options.weld)?;
        let body = DeformableBody::build(&mesh, &fit(start, &mesh)?, exec)?;
        let mut now = RetracedBody {
            body,
            positions: mesh.positions,
            triangles: mesh.triangles,
        };
        for step in steps.into_iter().rev() {
            let nodes = step.nodes.as_ref().map(|n| n.as_slice());
            let at = nodes.map_or(&now.positions[..], |n| &n[..now.positions.len()]);
            let lists = step.delta.change_lists(&now.triangles);
            let (positions, triangles) = step.delta.apply(at, &now.triangles);
            let change = lists.as_mesh_change(&positions, &triangles);
            let Some(body) = now.body.follow(&change, nodes, step.ties.as_ref(), exec)? else {
                return Ok(None);
            };
            now = RetracedBody {
                body,
                positions,
                triangles,
            };
        }
        Ok(Some(now))
    }
}

/// A body made again.
pub(super) struct RetracedBody {
    pub body: DeformableBody,
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

impl LineageEdit {
    /// Bytes of this step and those before it.
    pub fn byte_size(&self) -> u64 {
        self.bytes
    }

    fn own_bytes(&self) -> u64 {
        let nodes = self.nodes.as_ref().map_or(0, |n| size_of_val(n.as_slice()));
        (self.delta.byte_size() + nodes) as u64
    }
}

/// Numbers in order of which most follow each other: `count` from `first` on, or as many that are new.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct NumberRun {
    /// The first old number, or [`NONE`] for new ones.
    first: u32,
    count: u32,
}

/// For each new number its old one, or [`NONE`].
#[derive(Debug, Clone, PartialEq, Eq, Default)]
struct NumberRuns(Vec<NumberRun>);

impl NumberRuns {
    fn from_numbers(old_from_new: impl Iterator<Item = u32>) -> Self {
        let mut runs: Vec<NumberRun> = Vec::new();
        for old in old_from_new {
            match runs.last_mut() {
                Some(run) if run.first == NONE && old == NONE => run.count += 1,
                Some(run) if run.first != NONE && run.first + run.count == old => run.count += 1,
                _ => runs.push(NumberRun { first: old, count: 1 }),
            }
        }
        Self(runs)
    }

    fn len(&self) -> usize {
        self.0.iter().map(|r| r.count as usize).sum()
    }

    fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.0.iter().flat_map(|r| {
            let old = move |k| if r.first == NONE { NONE } else { r.first + k };
            (0..r.count).map(old)
        })
    }

    fn byte_size(&self) -> usize {
        self.0.capacity() * size_of::<NumberRun>()
    }
}

/// What an edit changed of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MeshDelta {
    points: NumberRuns,
    triangles: NumberRuns,
    /// Positions of new points, and of old ones that the edit moved, by new number, rising.
    placed: Vec<(u32, DVec3)>,
    /// Corners of new triangles, in order.
    fresh: Vec<[u32; 3]>,
}

/// A delta with the lists that following it takes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MeshChangeLists {
    old_from_new: Vec<u32>,
    removed: Vec<[u32; 3]>,
    added: Vec<u32>,
    moved: Vec<u32>,
}

impl MeshDelta {
    /// The change from `old` (its triangles, and where its points are by now) to `mesh`, which `applied` has led to.
    pub fn between_meshes(triangles: &[[u32; 3]], at: &[DVec3], mesh: &Mesh, applied: &PatchedSurface) -> Self {
        // What was merged in has numbers after those that were there.
        let known = |o: &u32| (*o as usize) < at.len();
        let was = |p: u32| {
            applied
                .old_from_point
                .get(p as usize)
                .copied()
                .filter(known)
                .unwrap_or(NONE)
        };
        let mut placed = Vec::new();
        for (p, position) in (0u32..).zip(&mesh.positions) {
            if at.get(was(p) as usize) != Some(position) {
                placed.push((p, *position));
            }
        }
        // A triangle that kept its place but not its corners, as where points were joined, is a new one.
        let mut fresh = Vec::new();
        let old_triangle = |(k, t): (usize, &[u32; 3])| {
            let old = applied.old_from_triangle.get(k).copied().unwrap_or(NONE);
            let same = triangles.get(old as usize).is_some_and(|o| t.map(was) == *o);
            if same {
                return old;
            }
            fresh.push(*t);
            NONE
        };
        Self {
            points: NumberRuns::from_numbers((0..mesh.positions.len() as u32).map(was)),
            triangles: NumberRuns::from_numbers(mesh.triangles.iter().enumerate().map(old_triangle)),
            placed,
            fresh,
        }
    }

    /// The lists of the change, for a mesh with `triangles` before.
    pub fn change_lists(&self, triangles: &[[u32; 3]]) -> MeshChangeLists {
        let old_from_new: Vec<u32> = self.points.iter().collect();
        let mut stays = vec![false; triangles.len()];
        let mut added = Vec::with_capacity(self.fresh.len());
        let mut next = 0;
        for run in &self.triangles.0 {
            match run.first {
                NONE => added.extend(next..next + run.count),
                first => stays[first as usize..][..run.count as usize].fill(true),
            }
            next += run.count;
        }
        let gone = triangles.iter().zip(&stays).filter(|(_, stays)| !**stays);
        let moved = self.placed.iter().map(|p| p.0);
        MeshChangeLists {
            removed: gone.map(|(t, _)| *t).collect(),
            moved: moved.filter(|&p| old_from_new[p as usize] != NONE).collect(),
            old_from_new,
            added,
        }
    }

    /// The points and triangles after the change, from where the points are by now and the triangles before.
    pub fn apply(&self, at: &[DVec3], triangles: &[[u32; 3]]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let was = |old: u32| at.get(old as usize).copied().unwrap_or_default();
        let mut positions: Vec<DVec3> = self.points.iter().map(was).collect();
        self.placed
            .iter()
            .for_each(|&(p, position)| positions[p as usize] = position);
        let mut new_from_old = vec![NONE; at.len()];
        for (new, old) in (0u32..).zip(self.points.iter()).filter(|n| n.1 != NONE) {
            new_from_old[old as usize] = new;
        }
        let mut fresh = self.fresh.iter();
        let mut after = Vec::with_capacity(self.triangles.len());
        for old in self.triangles.iter() {
            after.extend(match old {
                NONE => fresh.next().copied(),
                old => Some(triangles[old as usize].map(|p| new_from_old[p as usize])),
            });
        }
        (positions, after)
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.points.byte_size()
            + self.triangles.byte_size()
            + self.placed.capacity() * size_of::<(u32, DVec3)>()
            + self.fresh.capacity() * size_of::<[u32; 3]>()
    }
}

impl MeshChangeLists {
    /// The change, with the points and triangles after it.
    pub fn as_mesh_change<'a>(&'a self, positions: &'a [DVec3], triangles: &'a [[u32; 3]]) -> MeshChange<'a> {
        MeshChange {
            positions,
            triangles,
            old_from_new: &self.old_from_new,
            removed: &self.removed,
            added: &self.added,
            moved: &self.moved,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_is_made_again_from_what_changed() {
        // A square of two triangles; the second one goes, a point comes, one moves.
        let old = [[0, 1, 2], [0, 2, 3]];
        let at = [DVec3::ZERO, DVec3::X, DVec3::ONE, DVec3::Y];
        let positions = vec![DVec3::ZERO, DVec3::X * 2.0, DVec3::ONE, DVec3::Z];
        let triangles = [[0, 1, 2], [2, 1, 3]];
        let mesh = Mesh::of_points(&positions, &triangles, vec![0, 1, 2, 3], 4).expect("a mesh");
        let applied = PatchedSurface {
            old_from_point: vec![0, 1, 2, NONE],
            old_from_triangle: vec![0, NONE],
            ..Default::default()
        };
        let delta = MeshDelta::between_meshes(&old, &at, &mesh, &applied);
        assert_eq!(delta.apply(&at, &old), (positions, triangles.to_vec()));
        let lists = delta.change_lists(&old);
        assert_eq!(
            (lists.removed, lists.added, lists.moved),
            (vec![[0, 2, 3]], vec![1], vec![1])
        );
        assert_eq!(lists.old_from_new, [0, 1, 2, NONE]);
    }
}

//! How the bodies of edited models came about: from a model on, edit after edit.
//!
//! A body after an edit is that before, repaired; so it depends on all edits since a body was last built from nothing.
//! For each edit the change of the mesh is stored, and the graph's nodes where a deformation had moved them. Repeating
//! the edits gives the same bits, without solving.

use super::error::Error;
use super::mesh_delta::MeshDelta;
use super::model_topology::ModelTopology;
use super::settings::OpenOptions;
use super::topology_id::TopologyId;
use crate::deform::{BodyOptions, DeformableBody, TieOptions};
use crate::exec::Exec;
use crate::mesh::Mesh;
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

//! A session as tools see it: its rest shape with words for its regions, read on the compute threads.

use crate::kept::{Kept, NamedRegion, Notes};
use crate::picture::BYTES_PER_VERTEX;
use crate::words::{Found, Resolver, RestFigure, VertexSet};
use glam::DVec3;
use pliant_core::engine::{self, TopologyId};
use pliant_core::mesh::BoundingBox;
use pliant_session::{Error, Manager, Tenant};
use serde_json::{Value, json};
use std::sync::Arc;

/// Bytes of scratch for each vertex: a picture, and what hangs together.
const BYTES: u64 = BYTES_PER_VERTEX + 256;

/// Whose session it is, and how to reach it.
#[derive(Clone)]
pub(crate) struct SessionCaller {
    pub manager: Manager,
    pub tenant: Tenant,
    pub kept: Arc<Kept>,
}

/// A model while tools look at it.
pub(crate) struct Scene<'a> {
    pub figure: &'a RestFigure<'a>,
    pub resolver: &'a Resolver<'a>,
    /// The current shape.
    pub positions: &'a [DVec3],
    /// The state of the model that vertices belong to.
    pub topology: TopologyId,
}

/// A region in the numbers that an answer has.
pub(crate) struct RegionFacts {
    pub center: DVec3,
    pub value: Value,
}

impl Scene<'_> {
    /// A region, where it is now.
    pub fn facts(&self, found: &Found) -> RegionFacts {
        let list = found.set.list();
        let places: Vec<DVec3> = list.iter().map(|v| self.positions[*v as usize]).collect();
        let bounds = BoundingBox::of(&places);
        let center = self.figure.center(&found.set, self.positions).unwrap_or_default();
        let mut value = json!({
            "vertices": list.len(),
            "center": center.to_array(),
            "box": {"min": bounds.min.to_array(), "max": bounds.max.to_array()},
            "how": found.how,
        });
        if let Some(pivot) = found.pivot {
            value["pivot"] = json!(pivot.to_array());
        }
        if !found.others.is_empty() {
            value["others"] = json!(found.others);
        }
        RegionFacts { center, value }
    }
}

impl SessionCaller {
    /// Runs `work` on a session's model.
    ///
    /// # Errors
    /// `NOT_FOUND`; what `work` fails with.
    pub async fn see<T: Send + 'static>(
        &self,
        id: &str,
        work: impl FnOnce(&Scene<'_>) -> Result<T, engine::Error> + Send + 'static,
    ) -> Result<T, Error> {
        let notes = self.kept.notes(&self.tenant, id);
        let (axes, regions, joints) = (notes.axes, notes.regions, notes.joints);
        let seen = self
            .manager
            .look(&self.tenant, id, BYTES, move |deformer, positions, exec| {
                let topology = deformer.topology_state().id();
                let figure = RestFigure::new(deformer, axes, exec);
                let known = joints.filter(|known| known.0 == topology).map(|known| known.1);
                let mut resolver = Resolver::new(&figure, known);
                let mut renewed: Vec<(String, NamedRegion)> = Vec::new();
                for (name, mut region) in regions {
                    if region.topology != topology {
                        // What was named before an edit is what its words mean now; what they mean no more is forgotten.
                        let Ok(found) = resolver.resolve(&region.words, "words") else {
                            continue;
                        };
                        region.vertices = Arc::new(found.set.list());
                        (region.pivot, region.topology) = (found.pivot, topology);
                        renewed.push((name.clone(), region.clone()));
                    }
                    let set = VertexSet::of_list(figure.count(), &region.vertices);
                    resolver.named.insert(name, (set, region.pivot));
                }
                let scene = Scene {
                    figure: &figure,
                    resolver: &resolver,
                    positions,
                    topology,
                };
                let done = work(&scene)?;
                Ok((done, topology, resolver.joints.get().cloned(), renewed))
            });
        let (done, topology, joints, renewed) = seen.await.inspect_err(|e| {
            if e.code == pliant_session::ErrorCode::NotFound {
                self.kept.forget(&self.tenant, id);
            }
        })?;
        if joints.is_some() || !renewed.is_empty() {
            // Without room for them they are found again.
            let _ = self.remember(id, |notes| {
                if let Some(joints) = joints {
                    notes.joints = Some((topology, joints));
                }
                notes.regions.extend(renewed);
            });
        }
        Ok(done)
    }

    /// Changes what is remembered of a session.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` where there is no room.
    pub fn remember(&self, id: &str, change: impl FnOnce(&mut Notes)) -> Result<(), Error> {
        let mut notes = self.kept.notes(&self.tenant, id);
        change(&mut notes);
        self.kept.keep(&self.manager, &self.tenant, id, notes)
    }
}

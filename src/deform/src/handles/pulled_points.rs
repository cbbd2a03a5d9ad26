//! Points of the surface that a hold pulls along with the nodes around them, or towards a plane.
//!
//! What such a point asks for couples coordinates of nodes, which the system does not know: it has one number per node on its
//! diagonal, the same for x, y and z. So the diagonal takes the whole weight of a point, shared out to its corners, and each solve
//! asks every corner to move from where it is now by what the point lacks. By Jensen's inequality that lies above the point's own
//! energy and touches it where the nodes are (majorization): every solve lowers the energy, and where nothing moves any more the
//! point pulls as it should.

use crate::body::DeformableBody;
use glam::DVec3;

/// A point of the surface, and where it is wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PulledPoint {
    /// The nodes of the corners around it.
    pub nodes: [u32; 3],
    /// Its barycentric weights, which sum to 1.
    pub corners: [f64; 3],
    /// Where it is wanted, model space.
    pub place: DVec3,
    /// How much, 0 or more: a factor of the hold's stiffness. The weights of the hold's pulls have their shares of it.
    pub weight: f64,
    /// Of unit length: across the plane that it is wanted in. Zero: it is wanted at the place.
    pub normal: DVec3,
    /// What part of the pull along the plane is left out, 0 to 1.
    pub tangential: f64,
}

impl PulledPoint {
    /// Where it is for places of the nodes.
    pub fn now(&self, of_node: impl Fn(usize) -> DVec3) -> DVec3 {
        let corners = self.nodes.iter().zip(self.corners);
        corners.map(|(&node, weight)| of_node(node as usize) * weight).sum()
    }

    /// Where it is in the rest pose, model space.
    pub fn at_rest(&self, body: &DeformableBody) -> DVec3 {
        self.now(|node| body.graph.positions[node])
    }

    /// Of a way to its place, what it asks for.
    pub(crate) fn lack(&self, way: DVec3) -> DVec3 {
        match self.normal == DVec3::ZERO {
            true => way,
            false => way - (way - self.normal * way.dot(self.normal)) * self.tangential,
        }
    }
}

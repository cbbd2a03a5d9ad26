//! What rides along with a model: values, as they are asked for.

use crate::asset::{FileSet, Format};
use glam::{DQuat, DVec3};

/// Something in the rest space of a model that is not solved, but follows the surface and volume around it.
#[derive(Debug, Clone)]
pub struct Passenger {
    /// What reports call it.
    pub name: String,
    /// What it is.
    pub kind: PassengerKind,
}

/// The kinds of passengers. The deformer carries primitives and nodes of the model itself. The caller carries points
/// and other models, with [`crate::engine::Deformer::carry_points`] and [`crate::engine::Deformer::carry_model`].
#[derive(Debug, Clone)]
pub enum PassengerKind {
    /// The primitive with this index.
    Primitive(u32),
    /// All primitives of this name: of a glTF those under the node of this name.
    PrimitivesNamed(String),
    /// The node of the model's file with this index.
    Node(u32),
    /// All nodes of this name.
    NodesNamed(String),
    /// Points with axes.
    Points {
        /// Their rest positions.
        positions: Vec<DVec3>,
        /// The rest rotation of the axes, one for each.
        rotations: Vec<DQuat>,
    },
    /// Another model that stands in the rest space.
    Model(CarriedModel),
}

/// Another model that rides along.
#[derive(Debug, Clone)]
pub struct CarriedModel {
    /// Its files.
    pub files: FileSet,
    /// The format that they are in; `None`: detected by their first bytes.
    pub format: Option<Format>,
    /// The format to write it in; `None`: its own.
    pub output: Option<Format>,
    /// Where it is to be written; empty where the caller has no use for a path.
    pub path: String,
}

//! Which meshes a scene places, and where: the node tree walked depth first in document order.

use super::document::GltfDocument;
use super::schema::GltfNode;
use crate::Error;
use glam::{DAffine3, DMat3, DQuat, DVec3};

/// One mesh under one node.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MeshPlacement {
    pub(super) node: usize,
    pub(super) mesh: usize,
    /// Where the node puts its mesh; the identity for a skinned mesh, which its joints place.
    pub(super) world_from_mesh: DAffine3,
    /// The skin whose joints place it.
    pub(super) skin: Option<usize>,
}

/// The node tree of a document, and what it places.
pub(super) struct PlacedScene {
    /// The meshes, in the order in which the scene draws them.
    pub(super) placements: Vec<MeshPlacement>,
    /// For each node of the document the transform from its space to the world's.
    pub(super) world_from_node: Vec<DAffine3>,
    /// For each node the one that it is a child of.
    pub(super) parents: Vec<Option<usize>>,
    /// Whether the scene reaches each node.
    pub(super) is_reached: Vec<bool>,
}

/// (code, message, where)
pub(super) type Warnings = Vec<(String, String, String)>;

/// The meshes of the default scene, or of all scenes when none is named, or of all nodes when there is no scene.
/// No recursion: a chain of nodes may be as long as the file likes.
pub(super) fn place_meshes(doc: &GltfDocument<'_>, warnings: &mut Warnings) -> Result<PlacedScene, Error> {
    let nodes = &doc.nodes.values;
    let parents = find_parents(doc)?;
    let world_from_node = world_transforms(doc, &parents)?;

    let roots: Vec<usize> = match (doc.scene, &doc.scenes.values[..]) {
        (Some(scene), scenes) => scenes[scene].nodes.iter().map(|n| n.index()).collect(),
        (None, []) => {
            if nodes.iter().any(|n| n.mesh.is_some()) {
                warnings.push((
                    "no-scene".into(),
                    "there is no scene; all nodes are taken".into(),
                    "scenes".into(),
                ));
            }
            (0..nodes.len()).filter(|&n| parents[n].is_none()).collect()
        }
        (None, scenes) => scenes.iter().flat_map(|s| &s.nodes).map(|n| n.index()).collect(),
    };
    if let Some(&node) = roots.iter().find(|&&n| parents[n].is_some()) {
        let message = "a scene lists a node that is another node's child; its parents' transforms hold all the same";
        warnings.push(("scene-lists-child".into(), message.into(), format!("nodes/{node}")));
    }

    let mut placements = Vec::new();
    let mut visited = vec![false; nodes.len()];
    let mut open: Vec<usize> = roots.into_iter().rev().collect();
    while let Some(index) = open.pop() {
        if std::mem::replace(&mut visited[index], true) {
            continue;
        }
        let node = &nodes[index];
        open.extend(node.children.iter().rev().map(|c| c.index()));
        let Some(mesh) = node.mesh else { continue };
        if node.has_gpu_instances() {
            let message = "EXT_mesh_gpu_instancing: the mesh is deformed once, every instance follows";
            warnings.push(("gpu-instances".into(), message.into(), format!("nodes/{index}")));
        }
        // A skinned mesh goes where its joints go, whatever its node says.
        let world_from_mesh = if node.skin.is_some() {
            DAffine3::IDENTITY
        } else {
            world_from_node[index]
        };
        placements.push(MeshPlacement {
            node: index,
            mesh: mesh.index(),
            world_from_mesh,
            skin: node.skin.map(|s| s.index()),
        });
    }
    Ok(PlacedScene {
        placements,
        world_from_node,
        parents,
        is_reached: visited,
    })
}

fn find_parents(doc: &GltfDocument<'_>) -> Result<Vec<Option<usize>>, Error> {
    let mut parents = vec![None; doc.nodes.len()];
    for (i, node) in doc.nodes.values.iter().enumerate() {
        for child in &node.children {
            match parents[child.index()].replace(i) {
                None => {}
                Some(other) => {
                    let problem = format!("is a child of node {other} and of node {i}; a node has one parent at most");
                    return Err(doc.fault.malformed(format!("nodes/{}", child.0), problem));
                }
            }
        }
    }
    Ok(parents)
}

/// Transforms from each node's space to the world's. Roots first, then level by level; what is not reached is in a cycle.
fn world_transforms(doc: &GltfDocument<'_>, parents: &[Option<usize>]) -> Result<Vec<DAffine3>, Error> {
    let nodes = &doc.nodes.values;
    let mut world_from_node: Vec<Option<DAffine3>> = vec![None; nodes.len()];
    let mut open: Vec<usize> = (0..nodes.len()).filter(|&n| parents[n].is_none()).collect();
    while let Some(index) = open.pop() {
        let parent_from_node = local_transform(doc, index, &nodes[index])?;
        let world_from_parent = parents[index]
            .and_then(|p| world_from_node[p])
            .unwrap_or(DAffine3::IDENTITY);
        let world = if world_from_parent == DAffine3::IDENTITY {
            parent_from_node
        } else {
            world_from_parent * parent_from_node
        };
        if !world.is_finite() {
            return Err(doc
                .fault
                .malformed(format!("nodes/{index}"), "the transform of the node is not finite"));
        }
        world_from_node[index] = Some(world);
        open.extend(nodes[index].children.iter().map(|c| c.index()));
    }
    world_from_node
        .into_iter()
        .enumerate()
        .map(|(i, t)| t.ok_or_else(|| doc.fault.malformed(format!("nodes/{i}"), "is its own ancestor")))
        .collect()
}

/// The transform from a node's space to its parent's.
pub(super) fn local_transform(doc: &GltfDocument<'_>, index: usize, node: &GltfNode) -> Result<DAffine3, Error> {
    let place = || format!("nodes/{index}");
    if let Some(m) = node.matrix {
        if node.translation.is_some() || node.rotation.is_some() || node.scale.is_some() {
            let problem = "has a matrix and also a translation, rotation or scale; only one kind is allowed";
            return Err(doc.fault.malformed(place(), problem));
        }
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            let problem = format!("last row is {} {} {} {}, it must be 0 0 0 1", m[3], m[7], m[11], m[15]);
            return Err(doc.fault.malformed(place() + "/matrix", problem));
        }
        let axes = [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]].map(DVec3::from_array);
        let matrix3 = DMat3::from_cols(axes[0], axes[1], axes[2]);
        return Ok(DAffine3 {
            matrix3,
            translation: DVec3::new(m[12], m[13], m[14]),
        });
    }
    let rotation = match node.rotation {
        None => DQuat::IDENTITY,
        Some(r) => {
            // Writers round quaternions; only one without a direction means nothing.
            let q = DQuat::from_array(r);
            let length = q.length();
            if !(length.is_normal()) {
                return Err(doc
                    .fault
                    .malformed(place() + "/rotation", format!("{r:?} is not a rotation")));
            }
            q / length
        }
    };
    let scale = DVec3::from_array(node.scale.unwrap_or([1.0; 3]));
    let translation = DVec3::from_array(node.translation.unwrap_or_default());
    Ok(joined_transform(translation, rotation, scale))
}

/// First a scale, then a rotation (a unit quaternion), then a translation.
pub(super) fn joined_transform(translation: DVec3, rotation: DQuat, scale: DVec3) -> DAffine3 {
    let rotation = if rotation == DQuat::IDENTITY {
        DMat3::IDENTITY
    } else {
        DMat3::from_quat(rotation)
    };
    let matrix3 = DMat3::from_cols(
        rotation.x_axis * scale.x,
        rotation.y_axis * scale.y,
        rotation.z_axis * scale.z,
    );
    DAffine3 { matrix3, translation }
}

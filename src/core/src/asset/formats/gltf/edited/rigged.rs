//! Which joints hold the vertices of an edited model.

use super::super::buffers::BufferBytes;
use super::super::document::GltfDocument;
use super::super::influences::{VertexInfluences, influence_accessors};
use super::super::read::GltfNotes;
use super::super::rig::{JointHeldVertices, SkinnedShape, joint_count};
use super::channels::AttributeBlender;
use super::skins::BlendedSkin;
use crate::asset::Error;
use crate::asset::codec::EditedOutput;
use crate::asset::edited::{CarriedAttributes, EditedModel};
use glam::DVec3;
use std::collections::BTreeSet;

/// Where the blends put all vertices.
pub(super) fn positions_before(edited: &EditedModel<'_>) -> Vec<DVec3> {
    let runs = edited.runs.iter();
    runs.flat_map(|run| CarriedAttributes::before(edited, run)).collect()
}

/// The vertices of an edited model, and which joints of its first base hold them.
pub(super) fn shape_of_runs<'a>(
    (doc, buffers): (&GltfDocument<'_>, &mut BufferBytes),
    notes: &GltfNotes,
    output: &EditedOutput<'a>,
    before: &'a [DVec3],
) -> Result<SkinnedShape<'a>, Error> {
    let edited = output.edited;
    let mut shape = SkinnedShape {
        before,
        now: output.positions,
        held: Vec::new(),
        fixed: Vec::new(),
    };
    for run in edited.runs.iter().filter(|run| run.base == 0) {
        let row = &notes.rows[run.primitive as usize];
        let Some(skin) = row.skin else {
            shape.fixed.push((row.node, run.vertices()));
            continue;
        };
        if !row.follows_joints {
            continue;
        }
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let used = influence_accessors(primitive).into_iter().flat_map(|(j, w)| [j, w]);
        buffers.decode_for(doc, &used.collect::<BTreeSet<usize>>())?;
        let joints = joint_count(doc, skin);
        let old = &edited.base(run).model.geometry.triangles[row.triangles.clone()];
        let influences = if edited.is_untouched(run, old) {
            let stored = VertexInfluences::read(doc, buffers, primitive, joints);
            stored.map_err(|problem| doc.fault.unwritable(problem))?
        } else {
            let mixer = AttributeBlender::new(edited, run);
            match BlendedSkin::read(doc, buffers, primitive, &mixer, &row.placement)? {
                Some(skin) => skin.influences(joints, doc.fault)?,
                None => continue,
            }
        };
        shape.held.push(JointHeldVertices {
            skin,
            first: run.first_vertex as usize,
            influences,
            placement: row.placement.clone(),
        });
    }
    Ok(shape)
}

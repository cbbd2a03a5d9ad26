//! What an edited glTF gives to other formats.

use super::super::read::GltfNotes;
use super::super::text::{list_of, parse_index, value_of};
use super::channels::{AttributeBlender, read};
use super::looks::read_looks;
use crate::asset::Error;
use crate::asset::edited::{EditedModel, PrimitiveRun};
use crate::asset::neutral::RunAttributes;
use std::collections::BTreeSet;
use std::sync::Arc;

/// The texture coordinates of the base colour, the first colours and the material of runs of one base.
pub(in super::super) fn run_attributes(
    edited: &EditedModel<'_>,
    runs: &[&PrimitiveRun],
) -> Result<Vec<RunAttributes>, Error> {
    let model = runs.first().map(|run| edited.base(run).model);
    let Some((model, notes)) = model.and_then(|model| Some((model, model.notes::<GltfNotes>()?))) else {
        return Ok(Vec::new());
    };
    let (doc, mut buffers) = notes.document_and_bytes(model)?;
    let materials = read_looks(&doc, notes.files(model), &buffers)?;
    let mut all = Vec::with_capacity(runs.len());
    for run in runs {
        let row = &notes.rows[run.primitive as usize];
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let mixer = AttributeBlender::new(edited, run);
        let mut extras = RunAttributes::default();
        let stored = list_of(doc.meshes.items[row.mesh], "primitives");
        let material = stored
            .get(row.primitive)
            .and_then(|p| value_of(p, "material"))
            .and_then(parse_index)
            .and_then(|m| materials.get(m));
        extras.material = material.map(|(material, _)| Arc::clone(material));
        // The coordinates that the picture of the base colour uses.
        let own_set = material.map(|(_, set)| format!("TEXCOORD_{set}"));
        let set = own_set.filter(|set| primitive.attribute(set).is_some());
        let set = set.as_deref().unwrap_or("TEXCOORD_0");
        let used: BTreeSet<usize> = [set, "COLOR_0"].iter().filter_map(|n| primitive.attribute(n)).collect();
        buffers.decode_for(&doc, &used)?;
        if let Some(accessor) = primitive.attribute(set) {
            let channel = read(&doc, &buffers, accessor)?;
            if channel.lanes == 2 {
                extras.uv = mixer.blend_linearly(&channel).as_chunks::<2>().0.to_vec();
            }
        }
        if let Some(accessor) = primitive.attribute("COLOR_0") {
            let channel = read(&doc, &buffers, accessor)?;
            let values = mixer.blend_linearly(&channel);
            extras.colours = match channel.lanes {
                3 => values
                    .as_chunks::<3>()
                    .0
                    .iter()
                    .map(|&[r, g, b]| [r, g, b, 1.0])
                    .collect(),
                4 => values.as_chunks::<4>().0.to_vec(),
                _ => Vec::new(),
            };
        }
        all.push(extras);
    }
    Ok(all)
}

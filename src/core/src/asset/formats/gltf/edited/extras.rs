//! What an edited glTF gives to other formats.

use super::super::read::{GltfNotes, reopen};
use super::super::text::{items, value_of};
use super::channels::{AttributeBlender, read};
use super::kept::unparsed_items;
use super::places;
use crate::asset::Error;
use crate::asset::edited::{EditedModel, PrimitiveRun};
use crate::asset::neutral::RunAttributes;
use std::collections::BTreeSet;

/// The first texture coordinates, the first colours and the name of the material of runs of one base.
pub(in super::super) fn run_attributes(
    edited: &EditedModel<'_>,
    runs: &[&PrimitiveRun],
) -> Result<Vec<RunAttributes>, Error> {
    let model = runs.first().map(|run| edited.base(run).model);
    let Some((model, notes)) = model.and_then(|model| Some((model, model.notes::<GltfNotes>()?))) else {
        return Ok(Vec::new());
    };
    let (doc, mut buffers) = reopen(model, notes)?;
    let materials: Vec<Option<String>> = unparsed_items(&doc, "materials").into_iter().map(name_of).collect();
    let mut all = Vec::with_capacity(runs.len());
    for run in runs {
        let row = &notes.rows[run.primitive as usize];
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let mixer = AttributeBlender::new(edited, run);
        let mut extras = RunAttributes::default();
        let used: BTreeSet<usize> = ["TEXCOORD_0", "COLOR_0"]
            .iter()
            .filter_map(|n| primitive.attribute(n))
            .collect();
        buffers.decode_for(&doc, &used)?;
        if let Some(accessor) = primitive.attribute("TEXCOORD_0") {
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
        let stored = value_of(doc.meshes.items[row.mesh], "primitives")
            .and_then(|p| items(p).ok())
            .unwrap_or_default();
        let material = stored
            .get(row.primitive)
            .and_then(|p| value_of(p, "material"))
            .and_then(places::index);
        extras.material = material.and_then(|m| {
            let name = materials.get(m)?.clone();
            Some(name.unwrap_or_else(|| format!("material_{m}")))
        });
        all.push(extras);
    }
    Ok(all)
}

fn name_of(material: &str) -> Option<String> {
    let name: String = serde_json::from_str(value_of(material, "name")?).ok()?;
    (!name.is_empty()).then_some(name)
}

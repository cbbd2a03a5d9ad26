//! An FBX file becomes the files of a GLB.

use super::super::gltf::{self, GlbWriter};
use super::nodes::{self, SceneNodes};
use super::scene::{self, FORMAT, MaterialTable, TranslationNotes};
use crate::codec::Translation;
use crate::files::ReadWatch;
use crate::{Error, FileSet};
use serde_json::{Value, json};

/// Translates a file in this process.
pub(super) fn translate_here(files: &FileSet, watch: &ReadWatch<'_>) -> Result<Translation, Error> {
    let opened = scene::open(files, watch)?;
    let mut notes = TranslationNotes::default();
    let version = opened.metadata.version;
    let message = format!("an FBX {version} file is read as the GLB that comes back, in metres and with Y up");
    notes.warn("fbx-as-glb", message, "file");
    scene::report_repairs(&opened, &mut notes);
    let mut buffer = GlbWriter::new(FORMAT, watch);
    let mut materials = MaterialTable::new(files);
    let nodes = SceneNodes::build(&opened, &mut buffer, &mut materials, &mut notes, watch)?;
    let clips = nodes::sample_clips(&opened, &nodes, &mut buffer, &mut notes, watch)?;
    let (looks, companions) = materials.finish(&mut buffer)?;
    let main = buffer.finish(document(nodes, clips, looks))?;
    Ok(Translation {
        files: FileSet {
            name: files.name.clone(),
            main: main.into(),
            companions,
        },
        format: gltf::GLB_FORMAT,
        warnings: notes.finish(),
    })
}

/// The document of the whole asset, without what its buffer adds.
fn document(nodes: SceneNodes, clips: Vec<Value>, looks: scene::AssetSections) -> Value {
    let mut root = json!({"scene": 0, "scenes": [{"nodes": nodes.roots}]});
    let sections = [("nodes", nodes.nodes), ("meshes", nodes.meshes), ("skins", nodes.skins)];
    let sections = sections.into_iter().chain(looks);
    for (key, list) in sections.chain([("animations", clips)]) {
        if !list.is_empty() {
            root[key] = Value::Array(list);
        }
    }
    root
}

//! Autodesk FBX, read and not written: a file becomes a GLB, which is a model like any other.
//!
//! Only [`gltf`](super::gltf) defines rest poses, morph targets and clips for other modules. So an FBX is translated to
//! an equivalent GLB, in metres and with Y up, and is written as GLB. `ufbx` (one C file, under limits of memory)
//! parses the bytes; this module checks all its output.
//!
//! [`scene`] opens the file and gathers warnings and materials, [`corners`] makes vertices of the corners of polygons and morph targets of
//! blend shapes, [`meshes`] primitives and skins, [`nodes`] places them and samples
//! animation stacks.

mod corners;
mod meshes;
mod nodes;
mod scene;

pub(super) use scene::FORMAT;

use super::gltf::{self, GlbWriter};
use crate::codec::{FormatTranslator, Translation};
use crate::files::ReadWatch;
use crate::{Error, FileSet};
use nodes::SceneNodes;
use scene::{MaterialTable, TranslationNotes};
use serde_json::{Value, json};

/// Reads FBX by way of GLB.
pub(super) struct FbxTranslator;

impl FormatTranslator for FbxTranslator {
    fn companion_names(&self, files: &FileSet) -> Vec<String> {
        scene::texture_names(files)
    }

    fn translate(&self, files: &FileSet, watch: &ReadWatch<'_>) -> Result<Translation, Error> {
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

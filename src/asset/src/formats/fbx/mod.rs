//! Autodesk FBX, read and not written: a file becomes a GLB, which is a model like any other.
//!
//! Only [`gltf`](super::gltf) defines rest poses, morph targets and clips for other modules. So an FBX is translated to
//! an equivalent GLB, in metres and with Y up, and is written as GLB. `ufbx` (one C file, under limits of memory)
//! parses the bytes; this module checks all its output.
//!
//! [`translation`] makes the GLB; [`apart`] has that done in another process where the caller wants it. [`scene`] opens the file and gathers
//! warnings and materials, [`corners`] makes vertices of the corners of polygons and morph targets of blend shapes, [`meshes`] primitives
//! and skins, [`nodes`] places them and samples animation stacks.

mod apart;
mod corners;
mod meshes;
mod nodes;
mod scene;
mod translation;

pub(super) use apart::{DECODER, answer};
pub(super) use scene::FORMAT;

use crate::codec::{FormatTranslator, Translation};
use crate::files::ReadWatch;
use crate::{Error, FileSet};

/// Reads FBX by way of GLB.
pub(super) struct FbxTranslator;

impl FormatTranslator for FbxTranslator {
    fn companion_names(&self, files: &FileSet) -> Vec<String> {
        scene::texture_names(files)
    }

    fn translate(&self, files: &FileSet, watch: &ReadWatch<'_>) -> Result<Translation, Error> {
        match watch.apart {
            Some(starter) => apart::translate(starter, files, watch),
            None => translation::translate_here(files, watch),
        }
    }
}

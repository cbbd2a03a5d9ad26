//! Animated models as USD text (usda): one mesh per primitive with its points over time, materials with base colours, and what
//! carries them all.
//!
//! Written frame by frame, so that a clip of any length needs no more memory than one of its frames. No crate for USD is used:
//! of the text format a few dozen lines are needed, and what reads and writes all of it keeps a whole stage in memory.
//!
//! Texture coordinates count from the lower left corner there. Pictures are not written along.

use super::format::Format;
use super::look::NamedMaterial;
use super::moving_scene::NodePlace;
use super::neutral::NeutralModel;
use super::write::neutral_model;
use super::{Error, Model};
use glam::{DQuat, Vec3};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::{self, Write};
use std::ops::Range;
use std::sync::Arc;

/// When the frames of a USD clip are, and what carries all of it.
#[derive(Debug, Clone, Copy)]
pub struct UsdClip<'a> {
    /// What the clip is called; the stage is documented with it.
    pub name: &'a str,
    /// Frames a second; frame k is at time code k.
    pub rate: f64,
    /// How many there are.
    pub frames: usize,
    /// For each frame what carries everything, where there is such a thing.
    pub root: Option<&'a [NodePlace]>,
}

/// A mesh on its way into USD.
struct UsdMesh {
    name: String,
    /// The name in the model, if not an identifier.
    shown: Option<String>,
    vertices: Range<usize>,
    /// Faces, texture coordinates and what else does not change with time.
    fixed: String,
}

/// A model on its way into USD.
pub struct UsdModel {
    meshes: Vec<UsdMesh>,
    materials: String,
    /// For each vertex of a mesh the render vertex of the model.
    vertex_of: Vec<u32>,
    rest: Vec<Vec3>,
}

impl Model {
    /// The model with all that does not change over time, for [`UsdModel::write`].
    ///
    /// # Errors
    /// [`Error`] when what the model has beside its mesh cannot be read.
    pub fn for_usd(&self) -> Result<UsdModel, Error> {
        // OBJ divides no vertices at seams either.
        let neutral = neutral_model(self, &self.positions, Format::OBJ)?;
        let mut names = UsdNames::default();
        names.unique("materials");
        let materials = MaterialNames::of(&neutral);
        let meshes = neutral.primitives().zip(&neutral.attributes).map(|(own, attributes)| {
            let shown = match own.primitive.name.as_str() {
                "" => "mesh",
                name => name,
            };
            let name = names.unique(shown);
            let mut fixed = faces_text(&neutral, &own);
            let material = attributes.material.as_ref().and_then(|m| materials.path_of(m));
            if let Some(path) = material {
                _ = writeln!(fixed, "            rel material:binding = <{path}>");
            }
            UsdMesh {
                shown: (name != shown).then(|| shown.to_owned()),
                name,
                vertices: own.vertices.clone(),
                fixed,
            }
        });
        Ok(UsdModel {
            meshes: meshes.collect(),
            materials: materials.text,
            rest: neutral.geometry.positions.iter().map(|p| p.as_vec3()).collect(),
            vertex_of: neutral.copy_of,
        })
    }
}

impl UsdModel {
    /// Writes the model with a clip: `positions` gives, for a frame, where a range of the model's render vertices is.
    ///
    /// # Errors
    /// Those of `positions` and of `out`.
    pub fn write(
        &self,
        clip: &UsdClip<'_>,
        positions: &mut dyn FnMut(usize, Range<usize>) -> io::Result<Vec<Vec3>>,
        out: &mut dyn Write,
    ) -> io::Result<()> {
        let last = clip.frames.saturating_sub(1);
        write!(
            out,
            "#usda 1.0\n(\n    defaultPrim = \"root\"\n    doc = {}\n    endTimeCode = {last}\n    framesPerSecond = {rate}\n    \
             metersPerUnit = 1\n    startTimeCode = 0\n    timeCodesPerSecond = {rate}\n    upAxis = \"Y\"\n)\n\n\
             def Xform \"root\" (\n    kind = \"component\"\n)\n{{\n",
            quoted(&format!("{} as pliant solved it", clip.name)),
            rate = number(clip.rate),
        )?;
        if let Some(places) = clip.root {
            write_root(places, out)?;
        }
        for mesh in &self.meshes {
            self.write_mesh(mesh, clip.frames, positions, out)?;
        }
        writeln!(out, "{}}}", self.materials)
    }

    fn write_mesh(
        &self,
        mesh: &UsdMesh,
        frames: usize,
        positions: &mut dyn FnMut(usize, Range<usize>) -> io::Result<Vec<Vec3>>,
        out: &mut dyn Write,
    ) -> io::Result<()> {
        let shown = mesh
            .shown
            .as_deref()
            .map(|name| format!("\n    displayName = {}", quoted(name)));
        write!(
            out,
            "    def Mesh \"{}\" (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]{}\n    )\n    {{\n{}",
            mesh.name,
            shown.unwrap_or_default().replace('\n', "\n    "),
            mesh.fixed
        )?;
        let rest = &self.rest[mesh.vertices.clone()];
        writeln!(out, "            float3[] extent = {}", extent(rest))?;
        writeln!(out, "            point3f[] points = {}", points(rest))?;
        let used = &self.vertex_of[mesh.vertices.clone()];
        let first = used.iter().min().map_or(0, |v| *v as usize);
        let end = used.iter().max().map_or(0, |v| *v as usize + 1);
        let mut extents = Vec::with_capacity(frames);
        writeln!(out, "            point3f[] points.timeSamples = {{")?;
        for frame in 0..frames {
            let all = positions(frame, first..end)?;
            let own: Vec<Vec3> = used.iter().map(|v| all[*v as usize - first]).collect();
            extents.push(extent(&own));
            writeln!(out, "                {frame}: {},", points(&own))?;
        }
        writeln!(out, "            }}\n            float3[] extent.timeSamples = {{")?;
        for (frame, extent) in extents.iter().enumerate() {
            writeln!(out, "                {frame}: {extent},")?;
        }
        writeln!(out, "            }}\n    }}\n")
    }
}

/// Writes what carries everything: shifts and turns over time.
fn write_root(places: &[NodePlace], out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "    double3 xformOp:translate.timeSamples = {{")?;
    for (frame, place) in places.iter().enumerate() {
        let [x, y, z] = place.translation.to_array().map(number);
        writeln!(out, "        {frame}: ({x}, {y}, {z}),")?;
    }
    writeln!(out, "    }}\n    quatd xformOp:orient.timeSamples = {{")?;
    let mut before = DQuat::IDENTITY;
    for (frame, place) in places.iter().enumerate() {
        // Both signs are one turn, but not every reader takes the short way between them.
        let turn = match before.dot(place.rotation) < 0.0 {
            true => -place.rotation,
            false => place.rotation,
        };
        before = turn;
        let [x, y, z, w] = turn.to_array().map(number);
        writeln!(out, "        {frame}: ({w}, {x}, {y}, {z}),")?;
    }
    writeln!(
        out,
        "    }}\n    uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:orient\"]\n"
    )
}

/// Faces, texture coordinates and colours of a primitive.
fn faces_text(neutral: &NeutralModel, own: &super::neutral::NeutralPrimitive<'_>) -> String {
    let first = own.vertices.start as u32;
    let (mut counts, mut corners, mut corner_uv) = (Vec::new(), Vec::new(), Vec::new());
    own.each_face(|face| {
        counts.push(face.len().to_string());
        for corner in face {
            corners.push((own.vertex_at(*corner) - first).to_string());
            if own.attributes.has_corner_uv {
                let at = 3 * own.first_triangle + *corner as usize;
                corner_uv.push(neutral.corner_uv.get(at).copied().unwrap_or_default());
            }
        }
    });
    let mut text = format!(
        "            int[] faceVertexCounts = [{}]\n            int[] faceVertexIndices = [{}]\n            \
         uniform token subdivisionScheme = \"none\"\n",
        counts.join(", "),
        corners.join(", ")
    );
    let uv = match own.attributes.has_uv {
        true => neutral.uv.get(own.vertices.clone()).unwrap_or_default(),
        false => &[],
    };
    for (values, interpolation) in [(&corner_uv[..], "faceVarying"), (uv, "vertex")] {
        if !values.is_empty() {
            let values: Vec<String> = values.iter().map(|[u, v]| format!("({u:?}, {:?})", 1.0 - v)).collect();
            _ = writeln!(
                text,
                "            texCoord2f[] primvars:st = [{}] (\n                interpolation = \"{interpolation}\"\n            )",
                values.join(", ")
            );
            break;
        }
    }
    let colours = match own.attributes.has_colours {
        true => neutral.colours.get(own.vertices.clone()).unwrap_or_default(),
        false => &[],
    };
    if !colours.is_empty() {
        let values: Vec<String> = colours
            .iter()
            .map(|[r, g, b, _]| format!("({r:?}, {g:?}, {b:?})"))
            .collect();
        _ = writeln!(
            text,
            "            color3f[] primvars:displayColor = [{}] (\n                interpolation = \"vertex\"\n            )",
            values.join(", ")
        );
    }
    text
}

/// Materials under names of their own.
struct MaterialNames {
    /// By where a material lies in memory, its path.
    paths: BTreeMap<usize, String>,
    text: String,
}

impl MaterialNames {
    fn of(neutral: &NeutralModel) -> Self {
        let mut all = Self {
            paths: BTreeMap::new(),
            text: String::new(),
        };
        let mut names = UsdNames::default();
        for attributes in &neutral.attributes {
            let Some(material) = &attributes.material else { continue };
            let Some(look) = &material.look else { continue };
            let key = Arc::as_ptr(material) as usize;
            if all.paths.contains_key(&key) {
                continue;
            }
            let name = names.unique(match material.name.as_str() {
                "" => "material",
                name => name,
            });
            let path = format!("/root/materials/{name}");
            let [r, g, b, a] = look.colour;
            _ = write!(
                all.text,
                "        def Material \"{name}\"\n        {{\n            token outputs:surface.connect = <{path}/surface.outputs:surface>\n\n            \
                 def Shader \"surface\"\n            {{\n                uniform token info:id = \"UsdPreviewSurface\"\n                \
                 color3f inputs:diffuseColor = ({r:?}, {g:?}, {b:?})\n                float inputs:opacity = {a:?}\n                \
                 float inputs:roughness = 0.8\n                token outputs:surface\n            }}\n        }}\n"
            );
            all.paths.insert(key, path);
        }
        if !all.text.is_empty() {
            all.text = format!("    def Scope \"materials\"\n    {{\n{}    }}\n", all.text);
        }
        all
    }

    fn path_of(&self, material: &Arc<NamedMaterial>) -> Option<&str> {
        self.paths.get(&(Arc::as_ptr(material) as usize)).map(String::as_str)
    }
}

/// Identifiers that are there already.
#[derive(Default)]
struct UsdNames(BTreeSet<String>);

impl UsdNames {
    /// An identifier like a name that no other has.
    fn unique(&mut self, name: &str) -> String {
        let mut plain: String = name
            .chars()
            .take(100)
            .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
            .collect();
        if plain.is_empty() || plain.starts_with(|c: char| c.is_ascii_digit()) {
            plain.insert(0, '_');
        }
        let mut found = plain.clone();
        let mut number = 1;
        while !self.0.insert(found.clone()) {
            number += 1;
            found = format!("{plain}_{number}");
        }
        found
    }
}

fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => quoted.push(' '),
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}

/// A number without a needless ".0".
fn number(value: f64) -> String {
    let text = format!("{value:?}");
    text.strip_suffix(".0").map(str::to_owned).unwrap_or(text)
}

fn push_point(text: &mut String, p: Vec3) {
    _ = write!(text, "({:?}, {:?}, {:?})", p.x, p.y, p.z);
}

fn points(all: &[Vec3]) -> String {
    let mut text = String::with_capacity(32 * all.len() + 2);
    text.push('[');
    for (i, p) in all.iter().enumerate() {
        if i > 0 {
            text.push_str(", ");
        }
        push_point(&mut text, *p);
    }
    text.push(']');
    text
}

fn extent(all: &[Vec3]) -> String {
    let first = all.first().copied().unwrap_or_default();
    let low = all.iter().fold(first, |low, p| low.min(*p));
    let high = all.iter().fold(first, |high, p| high.max(*p));
    points(&[low, high])
}

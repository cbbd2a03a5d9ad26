//! Materials as far as several formats know them: a base colour, its picture, a picture of normals, opacity, and whether both sides are drawn.

use bytes::Bytes;

/// A material on its way from one format to another.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NamedMaterial {
    /// Its name.
    pub name: String,
    /// What it looks like; `None` where only the name is known.
    pub look: Option<BaseLook>,
}

impl NamedMaterial {
    /// A material of which only the name is known.
    pub fn of_name(name: impl Into<String>) -> Self {
        let name = name.into();
        Self { name, look: None }
    }
}

/// What a material looks like.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BaseLook {
    /// Red, green, blue and opacity from 0 to 1, by which the picture is multiplied.
    pub colour: [f32; 4],
    /// The picture of its colours.
    pub picture: Option<MaterialPicture>,
    /// The picture of its normals in the frame of its texture coordinates, which are those of the other picture.
    pub normals: Option<MaterialPicture>,
    /// How its opacity is drawn.
    pub coverage: AlphaCoverage,
    /// Whether the backs of its triangles are drawn too.
    pub double_sided: bool,
}

impl Default for BaseLook {
    fn default() -> Self {
        Self {
            colour: [1.0; 4],
            picture: None,
            normals: None,
            coverage: AlphaCoverage::Opaque,
            double_sided: false,
        }
    }
}

/// A picture by the name of its file, relative to the model's folder and inside of it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MaterialPicture {
    /// The name.
    pub name: String,
    /// The file; `None` where it was not sent along with the model.
    pub bytes: Option<Bytes>,
}

/// What the opacity of a material does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum AlphaCoverage {
    /// Nothing.
    Opaque,
    /// Places whose opacity is below this are not drawn.
    Mask(f32),
    /// What lies behind shines through.
    Blend,
}

/// A file's reference to another as a relative path; `None` when it leads out of the model's folder or is not a path.
/// Backslashes, which some programs write, stand for slashes.
pub(super) fn inside_folder(name: &str) -> Option<String> {
    let name = name.trim().replace('\\', "/");
    let name = name.strip_prefix("./").unwrap_or(&name);
    let leads_out = name.starts_with('/') || name.contains(':') || name.split('/').any(|part| part == "..");
    (!name.is_empty() && !leads_out && !name.contains(char::is_control)).then(|| name.to_owned())
}

//! What the surface of a model looks like, and materials on their way from one format to another.

use super::Geometry;
use bytes::Bytes;
use std::sync::Arc;

/// How texture coordinates beyond 0 to 1 are taken back into the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TextureWrap {
    /// The picture stands beside itself.
    #[default]
    Repeat,
    /// Every other picture is mirrored.
    Mirror,
    /// The border goes on.
    Clamp,
}

/// What the opacity of a surface means.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum AlphaMode {
    /// Nothing: the surface is opaque.
    #[default]
    Opaque,
    /// Below this number there is no surface.
    Mask(f32),
    /// What lies behind shines through.
    Blend,
}

/// A picture on a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct TextureUse {
    /// Index in [`SurfaceLook::images`].
    pub image: usize,
    /// Along u and along v.
    pub wrap: [TextureWrap; 2],
    /// Whether texels are not blended into each other.
    pub nearest: bool,
}

/// What a material looks like without lamps: its base colour.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseMaterial {
    /// Its name, else its number.
    pub name: String,
    /// Red, green and blue as linear light, and opacity; each 0 to 1.
    pub factor: [f32; 4],
    /// The picture that the factor multiplies.
    pub texture: Option<TextureUse>,
    /// What opacity means.
    pub alpha: AlphaMode,
    /// Whether the back of a face is seen.
    pub double_sided: bool,
    /// Whether it is drawn without light and shade.
    pub unlit: bool,
}

impl Default for BaseMaterial {
    /// White, opaque, seen from the front: what glTF says of a primitive without a material.
    fn default() -> Self {
        Self {
            name: String::new(),
            factor: [1.0; 4],
            texture: None,
            alpha: AlphaMode::Opaque,
            double_sided: false,
            unlit: false,
        }
    }
}

impl BaseMaterial {
    /// Whether it says no more than no material does.
    fn is_bare(&self) -> bool {
        self.factor == [1.0; 4] && self.texture.is_none() && self.alpha == AlphaMode::Opaque
    }
}

/// What the surface of a model looks like.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SurfaceLook {
    /// The materials in use.
    pub materials: Vec<BaseMaterial>,
    /// For each primitive of the model the index of its material.
    pub material_of: Vec<u32>,
    /// For each render vertex where it lies on its material's picture, from the upper left corner; empty without pictures.
    pub uv: Vec<[f32; 2]>,
    /// For each render vertex linear red, green and blue, and opacity; empty when no primitive has any.
    pub colours: Vec<[f32; 4]>,
    /// The files of the pictures, undecoded, or why there is none.
    pub images: Vec<Result<Bytes, String>>,
    /// Whether a primitive without normals is flat, as glTF says; other formats say nothing of it.
    pub is_flat_without_normals: bool,
}

impl SurfaceLook {
    /// Whether the model says nothing of looks.
    pub fn is_bare(&self) -> bool {
        self.colours.is_empty() && self.materials.iter().all(BaseMaterial::is_bare)
    }
}

impl SurfaceLook {
    /// The look of primitives with these materials, from a format that knows no sides; where a face looks is often left to chance there.
    pub(super) fn of_materials<'a>(materials: impl IntoIterator<Item = Option<&'a NamedMaterial>>) -> Self {
        let mut look = Self::default();
        let mut known: Vec<Option<&NamedMaterial>> = Vec::new();
        let mut pictures: Vec<&MaterialPicture> = Vec::new();
        for material in materials {
            let number = known.iter().position(|k| *k == material).unwrap_or_else(|| {
                known.push(material);
                known.len() - 1
            });
            look.material_of.push(number as u32);
        }
        for material in known {
            let own = material.and_then(|m| m.look.as_ref());
            let texture = own.and_then(|own| own.picture.as_ref()).map(|picture| {
                let image = pictures.iter().position(|p| *p == picture).unwrap_or_else(|| {
                    pictures.push(picture);
                    pictures.len() - 1
                });
                TextureUse {
                    image,
                    wrap: [TextureWrap::Repeat; 2],
                    nearest: false,
                }
            });
            look.materials.push(BaseMaterial {
                name: material.map(|m| m.name.clone()).unwrap_or_default(),
                factor: own.map_or([1.0; 4], |own| own.colour),
                texture,
                alpha: own.map_or(AlphaMode::Opaque, |own| own.coverage),
                double_sided: true,
                unlit: false,
            });
        }
        let missing = |picture: &MaterialPicture| format!("the picture {:?} is missing", picture.name);
        let bytes = pictures.into_iter().map(|p| p.bytes.clone().ok_or_else(|| missing(p)));
        look.images = bytes.collect();
        look
    }
}

/// A drawn model is the surface of a model with its look: where its format has attributes by corner, vertices are copied until all corners
/// at one are alike, and triangles lie in the order of materials.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DrawnModel {
    /// Positions, normals, triangles and primitives.
    pub geometry: Geometry,
    /// What they look like.
    pub look: SurfaceLook,
    /// For each vertex the one of the model that it is or copies.
    pub vertices: Vec<u32>,
    /// For each triangle the one of the model that it is.
    pub triangles: Vec<u32>,
}

/// A material on its way from one format to another.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NamedMaterial {
    /// Its name.
    pub name: String,
    /// What it looks like; `None` where only the name is known.
    pub look: Option<BaseLook>,
}

impl NamedMaterial {
    /// The material for texture coordinates that have been placed.
    pub fn with_placed_coordinates(self: Arc<Self>) -> Arc<Self> {
        let is_plain = |look: &BaseLook| look.placing == PicturePlacing::PLAIN;
        if self.look.as_ref().is_none_or(is_plain) {
            return self;
        }
        let mut placed = (*self).clone();
        placed
            .look
            .iter_mut()
            .for_each(|look| look.placing = PicturePlacing::PLAIN);
        Arc::new(placed)
    }

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
    pub coverage: AlphaMode,
    /// Whether the backs of its triangles are drawn too.
    pub double_sided: bool,
    /// Where texture coordinates lie on its pictures. A neutral model has the coordinates placed, and materials that place none.
    pub placing: PicturePlacing,
}

/// Where a texture coordinate (u, v), counted from the upper left corner, lies on a picture:
/// u' = m0 u + m1 v + m2, v' = m3 u + m4 v + m5.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PicturePlacing(pub [f64; 6]);

impl PicturePlacing {
    /// Where the coordinates say.
    pub const PLAIN: Self = Self([1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);

    /// Puts a coordinate in its place.
    pub fn place(self, [u, v]: [f32; 2]) -> [f32; 2] {
        if self == Self::PLAIN {
            return [u, v];
        }
        let ([a, b, c, d, e, f], [u, v]) = (self.0, [u, v].map(f64::from));
        [a * u + b * v + c, d * u + e * v + f].map(|x| x as f32)
    }
}

impl Default for BaseLook {
    fn default() -> Self {
        Self {
            colour: [1.0; 4],
            picture: None,
            normals: None,
            coverage: AlphaMode::Opaque,
            double_sided: false,
            placing: PicturePlacing::PLAIN,
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

/// A file's reference to another as a relative path; `None` when it leads out of the model's folder or is not a path.
/// Backslashes, which some programs write, stand for slashes.
pub(super) fn inside_folder(name: &str) -> Option<String> {
    let name = name.trim().replace('\\', "/");
    let name = name.strip_prefix("./").unwrap_or(&name);
    let leads_out = name.starts_with('/') || name.contains(':') || name.split('/').any(|part| part == "..");
    (!name.is_empty() && !leads_out && !name.contains(char::is_control)).then(|| name.to_owned())
}

//! Base colours of a surface: for every triangle a material, and what its corners carry.

use super::error::Error;
use super::texture::{Texture, TextureLookup};
use crate::asset::{AlphaMode, Primitive, SurfaceLook};
use glam::{Vec3, Vec4};

/// Places of samples within three by three, in the order in which they become opaque.
const ORDER: [[u8; 3]; 3] = [[0, 7, 3], [5, 2, 8], [1, 6, 4]];

/// A material that can be drawn.
#[derive(Debug, Clone)]
struct DressMaterial {
    factor: Vec4,
    texture: Option<(usize, TextureLookup)>,
    alpha: AlphaMode,
    double_sided: bool,
    unlit: bool,
}

/// A dress is what a surface looks like: materials with their textures, and for each input triangle what it wears.
#[derive(Debug, Clone)]
pub struct SurfaceDress {
    materials: Vec<DressMaterial>,
    textures: Vec<Texture>,
    material_of: Vec<u32>,
    corners: Vec<[u32; 3]>,
    uv: Vec<[f32; 2]>,
    colours: Vec<[f32; 4]>,
}

/// One triangle of a dress as a picture's samples see it.
pub(super) struct DressedTriangle<'a> {
    dress: &'a SurfaceDress,
    material: &'a DressMaterial,
    corners: [u32; 3],
    level: usize,
}

impl SurfaceDress {
    /// Makes the dress of a model. Pictures that cannot be drawn are left out; for each a sentence is added to `faults`.
    ///
    /// # Errors
    /// [`Error::Count`] when the look is of another model.
    pub fn of_model(
        look: &SurfaceLook,
        primitives: &[Primitive],
        triangles: &[[u32; 3]],
        faults: &mut Vec<String>,
    ) -> Result<Self, Error> {
        let counts: Vec<usize> = primitives.iter().map(|p| p.index_count as usize / 3).collect();
        if counts.len() != look.material_of.len() || counts.iter().sum::<usize>() != triangles.len() {
            return Err(Error::Count {
                what: "materials",
                seen: look.material_of.len(),
                vertices: primitives.len(),
            });
        }
        let mut textures = Vec::new();
        let decoded: Vec<Result<usize, String>> = look
            .images
            .iter()
            .map(|image| {
                textures.push(Texture::decode(image.as_ref().map_err(Clone::clone)?)?);
                Ok(textures.len() - 1)
            })
            .collect();
        let mut materials = Vec::with_capacity(look.materials.len());
        for material in &look.materials {
            let texture = material.texture.as_ref().and_then(|used| {
                let found = decoded.get(used.image)?;
                if let Err(reason) = found {
                    faults.push(format!(
                        "{}: its picture is not drawn, {reason}; its plain colour is shown",
                        material.name
                    ));
                }
                let lookup = TextureLookup {
                    wrap: used.wrap,
                    nearest: used.nearest,
                    level: 0,
                };
                found.as_ref().ok().map(|&number| (number, lookup))
            });
            materials.push(DressMaterial {
                factor: Vec4::from_array(material.factor),
                texture,
                alpha: material.alpha,
                double_sided: material.double_sided,
                unlit: material.unlit,
            });
        }
        let material_of = counts
            .iter()
            .zip(&look.material_of)
            .flat_map(|(&count, &material)| std::iter::repeat_n(material, count));
        Ok(Self {
            materials,
            textures,
            material_of: material_of.collect(),
            corners: triangles.to_vec(),
            uv: look.uv.clone(),
            colours: look.colours.clone(),
        })
    }

    /// What an input triangle wears. `area` is that of the triangle in samples, signed as the rasteriser has it; `None`
    /// where its back is seen and it has none.
    pub(super) fn triangle(&self, source: usize, area: f64) -> Option<DressedTriangle<'_>> {
        let material = self.materials.get(*self.material_of.get(source)? as usize)?;
        // Rows go down, so a face that looks at the eye runs the other way round here.
        if area > 0.0 && !material.double_sided {
            return None;
        }
        let corners = *self.corners.get(source)?;
        let mut dressed = DressedTriangle {
            dress: self,
            material,
            corners,
            level: 0,
        };
        if let Some((number, _)) = material.texture {
            dressed.level = dressed.level_of(&self.textures[number], area);
        }
        Some(dressed)
    }
}

impl DressedTriangle<'_> {
    /// The size of the picture at which a texel is about as large as a sample; one for all of the triangle, which is seen
    /// without perspective.
    fn level_of(&self, texture: &Texture, area: f64) -> usize {
        let [a, b, c] = self
            .corners
            .map(|v| self.dress.uv.get(v as usize).copied().unwrap_or_default());
        let [ux, uy] = [f64::from(b[0] - a[0]), f64::from(b[1] - a[1])];
        let [vx, vy] = [f64::from(c[0] - a[0]), f64::from(c[1] - a[1])];
        let [width, height] = texture.size();
        let texels = (ux * vy - uy * vx).abs() * width as f64 * height as f64;
        let halvings = 0.5 * libm::log2(texels / area.abs()) + 0.25;
        // Casts saturate, and take what is no number as 0.
        (halvings.max(0.0) as usize).min(texture.last_level())
    }

    /// Whether light and shade are left out.
    pub fn is_unlit(&self) -> bool {
        self.material.unlit
    }

    /// Whether samples differ in whether there is anything.
    pub fn has_gaps(&self) -> bool {
        self.material.alpha != AlphaMode::Opaque
    }

    /// Whether the surface is seen at a sample. What shines through does so in a pattern of samples, so that the order of
    /// triangles does not matter.
    pub fn is_seen(&self, weights: [f64; 3], x: usize, y: usize) -> bool {
        match self.material.alpha {
            AlphaMode::Opaque => true,
            AlphaMode::Mask(cutoff) => self.colour(weights).w >= cutoff,
            AlphaMode::Blend => self.colour(weights).w > (f32::from(ORDER[y % 3][x % 3]) + 0.5) / 9.0,
        }
    }

    /// Linear red, green and blue at a sample.
    pub fn light(&self, weights: [f64; 3]) -> Vec3 {
        self.colour(weights).truncate()
    }

    fn colour(&self, weights: [f64; 3]) -> Vec4 {
        let mut colour = self.material.factor;
        if !self.dress.colours.is_empty() {
            let mut mixed = Vec4::ZERO;
            for (v, w) in self.corners.iter().zip(weights) {
                let own = self.dress.colours.get(*v as usize).copied().unwrap_or([1.0; 4]);
                mixed += Vec4::from_array(own) * w as f32;
            }
            colour *= mixed.clamp(Vec4::ZERO, Vec4::ONE);
        }
        if let Some((number, lookup)) = self.material.texture {
            let mut place = [0.0f64; 2];
            for (v, w) in self.corners.iter().zip(weights) {
                let own = self.dress.uv.get(*v as usize).copied().unwrap_or_default();
                place[0] += f64::from(own[0]) * w;
                place[1] += f64::from(own[1]) * w;
            }
            let lookup = TextureLookup {
                level: self.level,
                ..lookup
            };
            colour *= self.dress.textures[number].look_up(place.map(|x| x as f32), lookup);
        }
        colour
    }
}

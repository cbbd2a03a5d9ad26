//! Base colours of a surface: for every triangle a material, and what its corners carry.
//!
//! The numbers that a picture shows as colours, one for each vertex.

use super::Error;
use super::texture::{Texture, TextureLookup};
use glam::{DVec3, Vec3, Vec4};
use pliant_asset::{AlphaMode, Primitive, SurfaceLook};
use pliant_mesh::{Mesh, Weld};

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
        // Casts saturate, and take what is not a number as 0.
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

/// The factor by which an edge is longer (or shorter) where [`edge_stretch`] is 1 (or -1).
pub const STRETCH_RANGE: f64 = 1.5;

/// Computes how much longer the edges around each vertex have become: the mean of the logarithms of length over rest length, to
/// the base [`STRETCH_RANGE`], each edge counting by its rest length. 0 = rest length, 1 = half as long again, -1 = two
/// thirds. 0 too for a vertex without edges.
///
/// # Errors
/// [`Error::Empty`] or [`Error::Surface`] when rest shape and triangles are not a surface, [`Error::Count`] when there
/// are more or fewer deformed positions than rest positions.
pub fn edge_stretch(rest: &[DVec3], deformed: &[DVec3], triangles: &[[u32; 3]]) -> Result<Vec<f64>, Error> {
    same_count(rest, deformed)?;
    // Seams are closed, so that both sides of one get the same number.
    let mesh = Mesh::build(rest, triangles, Weld::Exact)?;
    let now = |s: u32| mesh.render_vertices_of(s).first().map(|&v| deformed[v as usize]);
    let mut sums = vec![[0.0f64; 2]; mesh.positions.len()];
    let base = libm::log(STRETCH_RANGE);
    for t in &mesh.triangles {
        for k in 0..3 {
            let [a, b] = [t[k], t[(k + 1) % 3]];
            let length = mesh.positions[a as usize].distance(mesh.positions[b as usize]);
            let (Some(p), Some(q)) = (now(a), now(b)) else { continue };
            let factor = p.distance(q) / length;
            if !(length > 0.0 && factor.is_finite()) {
                continue;
            }
            // An edge that has vanished is far below any colour's end, and must not drown its neighbours.
            let log = libm::log(factor.clamp(1e-3, 1e3)) / base;
            for v in [a, b] {
                let [sum, weight] = &mut sums[v as usize];
                *sum += log * length;
                *weight += length;
            }
        }
    }
    let value = |s: u32| match sums.get(s as usize) {
        Some(&[sum, weight]) if weight > 0.0 => sum / weight,
        _ => 0.0,
    };
    Ok(mesh.solver_from_render.iter().map(|&s| value(s)).collect())
}

/// Computes how far each vertex has moved.
///
/// ```
/// use glam::DVec3;
/// use pliant_render::vertex_displacements;
///
/// let moved = vertex_displacements(&[DVec3::ZERO, DVec3::X], &[DVec3::ZERO, DVec3::X * 3.0])?;
/// assert_eq!(moved, [0.0, 2.0]);
/// # Ok::<(), pliant_render::Error>(())
/// ```
///
/// # Errors
/// [`Error::Count`] when the shapes have different numbers of vertices.
pub fn vertex_displacements(before: &[DVec3], after: &[DVec3]) -> Result<Vec<f64>, Error> {
    same_count(before, after)?;
    Ok(before.iter().zip(after).map(|(p, q)| p.distance(*q)).collect())
}

fn same_count(before: &[DVec3], after: &[DVec3]) -> Result<(), Error> {
    if before.len() == after.len() {
        return Ok(());
    }
    Err(Error::Count {
        what: "positions before",
        seen: before.len(),
        vertices: after.len(),
    })
}

#[cfg(test)]
mod vertex_values_tests {
    use super::*;

    #[test]
    fn stretch_is_a_logarithm_and_seams_agree() {
        // A strip of two squares; the right one is twice as long afterwards. Vertices 1 and 4, 2 and 7 are seams.
        let p = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let rest = [
            p(0., 0.),
            p(1., 0.),
            p(1., 1.),
            p(0., 1.),
            p(1., 0.),
            p(2., 0.),
            p(2., 1.),
            p(1., 1.),
        ];
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let moved = rest.map(|q| if q.x > 1.0 { q + DVec3::X } else { q });
        let values = edge_stretch(&rest, &moved, &triangles).expect("a surface");
        assert_eq!(values[3], 0.0, "nothing around it has changed");
        assert!(values[5] > 0.5 && values[1] > 0.1 && values[1] < values[5]);
        assert_eq!((values[1], values[2]), (values[4], values[7]));
        let grown = rest.map(|q| q * STRETCH_RANGE);
        for value in edge_stretch(&rest, &grown, &triangles).expect("a surface") {
            assert!((value - 1.0).abs() < 1e-12);
        }
        let shrunk = rest.map(|q| q / STRETCH_RANGE);
        for value in edge_stretch(&rest, &shrunk, &triangles).expect("a surface") {
            assert!((value + 1.0).abs() < 1e-12);
        }
        let gone = [DVec3::ZERO; 8];
        assert!(
            edge_stretch(&rest, &gone, &triangles)
                .expect("a surface")
                .iter()
                .all(|v| v.is_finite() && *v < -1.0)
        );
    }

    #[test]
    fn counts_must_agree() {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y];
        assert_eq!(
            vertex_displacements(&p, &p.map(|q| q + DVec3::Z * 2.0)),
            Ok(vec![2.0; 3])
        );
        for e in [
            vertex_displacements(&p, &p[..2]).expect_err("too few"),
            edge_stretch(&p, &p[..2], &[[0, 1, 2]]).expect_err("too few"),
        ] {
            assert!(e.to_string().contains('2') && e.to_string().contains('3'), "{e}");
        }
    }
}

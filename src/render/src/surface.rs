//! A surface made ready to be drawn: welded, with a normal for every corner of every triangle and maybe colours.
//!
//! A model that is open towards the eye, with balls inside of it (figure 6 of the paper).
//!
//! What of the surface faces the eye is left out; what faces away stays, and is seen from inside. So nothing that lies in the model is
//! hidden, whatever limb it lies in.

use super::Error;
use super::colour::{Rgb, linear_from_hex};
use super::dress::SurfaceDress;
use glam::{DVec3, Vec3};
use pliant_exec::pool::Pool;
use pliant_mesh::{Lists, Mesh, Weld};
use rayon::prelude::*;
use std::sync::Arc;

/// Cosine of the angle between faces beyond which the edge between them is drawn sharp: 40°.
const CREASE: f64 = 0.766;
/// Faces around a vertex from which on they are not compared one by one.
const MANY: usize = 48;

/// A shaded surface is triangles made ready to be drawn.
#[derive(Debug, Clone)]
pub struct ShadedSurface {
    mesh: Mesh,
    vertices: usize,
    normals: Vec<[Vec3; 3]>,
    inside_out: bool,
    colours: Vec<Vec3>,
    /// For each triangle the colour that marks it; empty without.
    face_marks: Vec<Option<Vec3>>,
    dress: Option<Arc<SurfaceDress>>,
    wires: bool,
}

impl ShadedSurface {
    /// Takes triangles over positions. Vertices at the same place are one, so that seams of a model do not show.
    ///
    /// # Errors
    /// [`Error::Empty`] without triangles, [`Error::Surface`] when a position that is used is not finite.
    pub fn new(positions: &[DVec3], triangles: &[[u32; 3]], pool: &Pool) -> Result<Self, Error> {
        let mesh = Mesh::build(positions, triangles, Weld::Exact)?;
        // In units of the shape's size, so that tiny and huge models neither underflow nor overflow.
        let bounds = mesh.bounds();
        let size = bounds.diagonal();
        let unit = if size > 0.0 && size.is_finite() {
            1.0 / size
        } else {
            1.0
        };
        let corner = |v: u32| (mesh.positions[v as usize] - bounds.center()) * unit;
        let (normals, volume, area) = pool.install(|| {
            let faces: Vec<DVec3> = mesh
                .triangles
                .par_iter()
                .map(|t| {
                    let [a, b, c] = t.map(corner);
                    (b - a).cross(c - a)
                })
                .collect();
            let volume: f64 = faces
                .iter()
                .zip(&mesh.triangles)
                .map(|(n, t)| n.dot(corner(t[0])))
                .sum();
            let area: f64 = faces.iter().map(|n| n.length()).sum();
            (corner_normals(&mesh, &faces), volume / 6.0, area / 2.0)
        });
        Ok(Self {
            vertices: positions.len(),
            normals,
            // Of an open sheet the volume says little.
            inside_out: volume < -1e-3 * area * area.sqrt(),
            mesh,
            colours: Vec::new(),
            face_marks: Vec::new(),
            dress: None,
            wires: false,
        })
    }

    /// Colours the surface: linear light for every vertex that [`ShadedSurface::new`] was given.
    ///
    /// # Errors
    /// [`Error::Count`] when there are more or fewer.
    pub fn with_colours(mut self, colours: &[Vec3]) -> Result<Self, Error> {
        if colours.len() != self.vertices {
            return Err(Error::Count {
                what: "colours",
                seen: colours.len(),
                vertices: self.vertices,
            });
        }
        let first = |s: u32| self.mesh.render_vertices_of(s).first();
        self.colours = (0..self.mesh.positions.len() as u32)
            .map(|s| first(s).map_or(Vec3::ONE, |&v| colours[v as usize]))
            .collect();
        Ok(self)
    }

    /// Marks triangles: for every triangle that [`ShadedSurface::new`] was given its colour as linear light, `None` for one that is not
    /// marked. Those are light; marked ones shine through them a little, so that none is missed behind others.
    ///
    /// # Errors
    /// [`Error::Count`] when there are fewer than triangles.
    pub fn with_marked_faces(mut self, marks: &[Option<Vec3>]) -> Result<Self, Error> {
        let of = |&source: &u32| marks.get(source as usize).copied();
        let found: Option<Vec<Option<Vec3>>> = self.mesh.source_triangle.iter().map(of).collect();
        self.face_marks = found.ok_or(Error::Count {
            what: "marks of triangles",
            seen: marks.len(),
            vertices: self.vertices,
        })?;
        Ok(self)
    }

    /// Shades the surface by normals of the model: one for every vertex that [`ShadedSurface::new`] was given, zero where the model
    /// has none. `triangles` are those that it was given. Without a normal, a corner is flat if `is_flat`, else shaded by the
    /// faces around it.
    ///
    /// # Errors
    /// [`Error::Count`] when there are normals, but not one for each vertex.
    pub fn with_normals(mut self, normals: &[Vec3], triangles: &[[u32; 3]], is_flat: bool) -> Result<Self, Error> {
        if !normals.is_empty() && normals.len() != self.vertices {
            return Err(Error::Count {
                what: "normals",
                seen: normals.len(),
                vertices: self.vertices,
            });
        }
        let mesh = &self.mesh;
        for ((own, t), &source) in self.normals.iter_mut().zip(&mesh.triangles).zip(&mesh.source_triangle) {
            let Some(corners) = triangles.get(source as usize) else {
                continue;
            };
            let flat = if is_flat {
                face_normal(t.map(|v| mesh.positions[v as usize]))
            } else {
                None
            };
            for (normal, &v) in own.iter_mut().zip(corners) {
                let given = normals.get(v as usize).and_then(|n| n.try_normalize());
                *normal = given.or(flat).unwrap_or(*normal);
            }
        }
        Ok(self)
    }

    /// Shows the surface in base colours of its own. The dress must be that of the triangles that it was made of.
    #[must_use]
    pub fn with_dress(mut self, dress: Arc<SurfaceDress>) -> Self {
        self.dress = Some(dress);
        self
    }

    /// Draws the edges of the triangles too.
    #[must_use]
    pub fn with_wires(mut self) -> Self {
        self.wires = true;
        self
    }

    /// Positions of the welded vertices.
    pub fn positions(&self) -> &[DVec3] {
        &self.mesh.positions
    }

    /// Triangles over the welded vertices.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.mesh.triangles
    }

    pub(super) fn normals(&self) -> &[[Vec3; 3]] {
        &self.normals
    }

    /// Whether the faces of a closed surface look inwards.
    pub(super) fn is_inside_out(&self) -> bool {
        self.inside_out
    }

    pub(super) fn colours(&self) -> Option<&[Vec3]> {
        (!self.colours.is_empty()).then_some(self.colours.as_slice())
    }

    /// The colour that marks each triangle, where triangles are marked.
    pub(super) fn face_marks(&self) -> Option<&[Option<Vec3>]> {
        (!self.face_marks.is_empty()).then_some(self.face_marks.as_slice())
    }

    pub(super) fn dress(&self) -> Option<&SurfaceDress> {
        self.dress.as_deref()
    }

    /// Which of the triangles that the surface was made of a triangle is.
    pub(super) fn source_of(&self, triangle: usize) -> usize {
        self.mesh.source_triangle[triangle] as usize
    }

    pub(super) fn has_wires(&self) -> bool {
        self.wires
    }
}

/// The unit normal of a face; `None` where it has no area.
fn face_normal([a, b, c]: [DVec3; 3]) -> Option<Vec3> {
    let (p, q) = (b - a, c - a);
    let size = p.abs().max(q.abs()).max_element();
    (p / size).cross(q / size).try_normalize().map(|n| n.as_vec3())
}

/// Computes for every corner the mean normal of the faces around its vertex that are nearly parallel to its own; zero where a face has
/// no area.
fn corner_normals(mesh: &Mesh, faces: &[DVec3]) -> Vec<[Vec3; 3]> {
    let around = Lists::gather(mesh.positions.len(), || {
        mesh.triangles.iter().zip(0u32..).flat_map(|(t, i)| t.map(|v| (v, i)))
    });
    let sums: Vec<DVec3> = (0..mesh.positions.len() as u32)
        .into_par_iter()
        .map(|v| around.of(v).iter().map(|&f| faces[f as usize]).sum())
        .collect();
    mesh.triangles
        .par_iter()
        .zip(faces)
        .map(|(t, face)| {
            let own = face.normalize_or_zero();
            t.map(|v| {
                let row = around.of(v);
                let smooth = if own == DVec3::ZERO {
                    sums[v as usize]
                } else if row.len() > MANY {
                    let all = sums[v as usize].normalize_or_zero();
                    if all.dot(own) > CREASE { all } else { own }
                } else {
                    let parallel = |n: &DVec3| n.dot(own) > CREASE * n.length();
                    row.iter().map(|&f| faces[f as usize]).filter(parallel).sum()
                };
                smooth.normalize_or(own).as_vec3()
            })
        })
        .collect()
}

/// The surface, as linear light; it is seen from behind, where it is darker.
const SHELL: u32 = 0xf4_f1_ec;

/// A ball in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrawnBall {
    /// Its centre.
    pub center: DVec3,
    /// Its radius.
    pub radius: f64,
    /// Its colour.
    pub colour: Rgb,
}

/// Makes the surface of a model ready to be drawn from the side to which `towards_eye` points, with the balls in it.
///
/// # Errors
/// Those of [`ShadedSurface::new`].
pub fn open_surface(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    towards_eye: DVec3,
    balls: &[DrawnBall],
    pool: &Pool,
) -> Result<ShadedSurface, Error> {
    let is_inside_out = ShadedSurface::new(positions, triangles, pool)?.is_inside_out();
    let mut all = positions.to_vec();
    let mut colours = vec![linear_from_hex(SHELL); positions.len()];
    let mut kept: Vec<[u32; 3]> = Vec::new();
    for triangle in triangles {
        let [a, b, c] = if is_inside_out {
            [triangle[0], triangle[2], triangle[1]]
        } else {
            *triangle
        };
        let [p, q, r] = [a, b, c].map(|v| positions[v as usize]);
        if (q - p).cross(r - p).dot(towards_eye) < 0.0 {
            kept.push([a, b, c]);
        }
    }
    let (corners, faces) = unit_ball();
    for ball in balls {
        let first = all.len() as u32;
        all.extend(corners.iter().map(|corner| ball.center + *corner * ball.radius));
        let colour = linear_of_bytes(ball.colour);
        colours.extend(corners.iter().map(|_| colour));
        kept.extend(faces.iter().map(|face| face.map(|v| v + first)));
    }
    ShadedSurface::new(&all, &kept, pool)?.with_colours(&colours)
}

fn linear_of_bytes([red, green, blue]: Rgb) -> Vec3 {
    linear_from_hex(u32::from(red) << 16 | u32::from(green) << 8 | u32::from(blue))
}

/// An octahedron whose faces are divided into four twice, on the unit sphere: fine enough to be shaded as one round thing.
fn unit_ball() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut corners = vec![DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z];
    let mut faces: Vec<[u32; 3]> = Vec::new();
    for k in 0..8u32 {
        let [x, y, z] = [k & 1, k >> 1 & 1, k >> 2].map(|bit| 3 * bit);
        let face = [x, 1 + y, 2 + z];
        let is_even = (k.count_ones()).is_multiple_of(2);
        faces.push(if is_even { face } else { [face[0], face[2], face[1]] });
    }
    for _ in 0..2 {
        let mut finer = Vec::with_capacity(4 * faces.len());
        for [a, b, c] in faces {
            let first = corners.len() as u32;
            for [p, q] in [[a, b], [b, c], [c, a]] {
                corners.push((corners[p as usize] + corners[q as usize]).normalize());
            }
            let [ab, bc, ca] = [first, first + 1, first + 2];
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        faces = finer;
    }
    (corners, faces)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pool() -> Pool {
        Pool::new(2).expect("two threads")
    }

    /// Two unit squares that meet at an edge along y, the second one folded up by an angle; four vertices are seams.
    fn fold(degrees: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let (sin, cos) = libm::sincos(degrees.to_radians());
        let across = DVec3::new(cos, 0.0, sin);
        let p = vec![
            DVec3::NEG_X,
            DVec3::ZERO,
            DVec3::Y,
            DVec3::NEG_X + DVec3::Y,
            DVec3::ZERO,
            across,
            across + DVec3::Y,
            DVec3::Y,
        ];
        (p, vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    }

    #[test]
    fn seams_are_smooth_and_creases_are_sharp() {
        let normals = |degrees: f64| {
            let (p, t) = fold(degrees);
            ShadedSurface::new(&p, &t, &pool())
                .expect("a surface")
                .normals()
                .to_vec()
        };
        let gentle = normals(20.0);
        // Vertex 1 and vertex 4 lie at the same place and look the same way.
        assert!((gentle[0][1] - gentle[2][0]).length() < 1e-6 && gentle[0][1].x < -0.05);
        let sharp = normals(90.0);
        assert_eq!(sharp[0], [Vec3::Z; 3]);
        assert!((sharp[2][0] - Vec3::NEG_X).length() < 1e-6);
    }

    #[test]
    fn what_is_no_surface_is_refused() {
        let text = |p: &[DVec3], t: &[[u32; 3]]| ShadedSurface::new(p, t, &pool()).expect_err("refused").to_string();
        assert!(text(&[], &[]).contains("nothing to draw"));
        assert!(text(&[DVec3::ONE; 3], &[[0, 1, 2]]).contains("none of 1 triangles"));
        let p = [DVec3::ZERO, DVec3::X, DVec3::NAN];
        assert!(text(&p, &[[0, 1, 2]]).contains("vertex 2"));
        assert!(text(&p, &[[0, 1, 7]]).contains("vertex 7"));
        let (p, t) = fold(10.0);
        let surface = ShadedSurface::new(&p, &t, &pool()).expect("a surface");
        let count = surface.with_colours(&[Vec3::ONE; 3]).expect_err("too few").to_string();
        assert!(count.contains('3') && count.contains('8'), "{count}");
    }
}

#[cfg(test)]
mod cutaway_tests {
    use super::super::camera::{Camera, PictureSize, UpAxis, ViewDirection};
    use super::super::raster::draw_surface;
    use super::*;

    #[test]
    fn what_lies_in_a_model_is_seen_whichever_way_its_faces_look() {
        let pool = Pool::new(1).expect("a thread");
        let (corners, faces) = unit_ball();
        let ball = DrawnBall {
            center: DVec3::new(0.3, 0.2, 0.0),
            radius: 0.2,
            colour: [20, 200, 40],
        };
        let view = ViewDirection::new(0.0, 0.0, UpAxis::Y).expect("in range");
        let size = PictureSize::new(100, 100).expect("in range");
        let turned: Vec<[u32; 3]> = faces.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
        for triangles in [&faces, &turned] {
            let closed = ShadedSurface::new(&corners, triangles, &pool).expect("a surface");
            let camera = &Camera::around_surfaces(&[&closed], &[view], size)[0];
            let open = open_surface(&corners, triangles, camera.towards_eye(), &[ball], &pool).expect("a surface");
            let picture = draw_surface(&open, camera, &pool);
            let colour_at = |p: DVec3| {
                let seen = camera.project_point(p);
                picture.pixel(seen.x as u32, seen.y as u32).expect("inside")
            };
            let [red, green, blue] = colour_at(ball.center);
            assert!(
                green > 100 && red < 60 && blue < 80,
                "the ball, in the light: {red} {green} {blue}"
            );
            let [red, green, blue] = colour_at(DVec3::new(-0.4, -0.3, 0.0));
            assert!(
                red >= green && green >= blue && red > blue + 5,
                "the shell, from behind: {red} {green} {blue}"
            );
        }
    }
}

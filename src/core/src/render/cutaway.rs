//! A model that is open towards the eye, with balls inside of it (figure 6 of the paper).
//!
//! What of the surface faces the eye is left out; what faces away stays, and is seen from inside. So nothing that lies in the model is
//! hidden, whatever limb it lies in.

use super::colour::{Rgb, linear_from_hex};
use super::error::Error;
use super::surface::ShadedSurface;
use crate::pool::Pool;
use glam::{DVec3, Vec3};

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

//! Bones drawn over a picture of a model, as if the model were glass.

use super::camera::Camera;
use super::colour::Rgb;
use super::picture::Picture;
use glam::{DVec2, DVec3};

/// What is turned: bones, and what holds rotations (figure 6 of the paper).
pub const ROTATION_COLOUR: Rgb = [0x2f, 0x8f, 0x4e];
/// What is put in place: joints, and what holds positions.
pub const POSITION_COLOUR: Rgb = [0xe0, 0x7b, 0x18];
const OUTSIDE: Rgb = [0xc8, 0x1e, 0x2b];
const RIM: Rgb = [0xff, 0xff, 0xff];
/// How much of the picture below is left.
const GLASS: f64 = 0.45;

/// Bones and the joints between them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BoneMarks {
    /// Where bones begin and end: green lines, thinner at the end.
    pub bones: Vec<[DVec3; 2]>,
    /// Where joints are, and whether that is inside the model: orange discs, red ones outside.
    pub joints: Vec<(DVec3, bool)>,
}

impl BoneMarks {
    /// Draws the bones over a picture that `camera` took of the model.
    pub fn draw_on(&self, picture: &mut Picture, camera: &Camera) {
        let (width, height) = (picture.width(), picture.height());
        for y in 0..height {
            for x in 0..width {
                picture.blend_pixel(x, y, RIM, GLASS);
            }
        }
        let thick = (f64::from(width.min(height)) / 160.0).clamp(1.5, 6.0);
        let seen = |p: DVec3| camera.project_point(p).truncate();
        for [from, to] in &self.bones {
            stroke(picture, [seen(*from), seen(*to)], [thick + 1.5, 0.4 * thick + 1.5], RIM);
        }
        for [from, to] in &self.bones {
            stroke(picture, [seen(*from), seen(*to)], [thick, 0.4 * thick], ROTATION_COLOUR);
        }
        for (at, inside) in &self.joints {
            let at = seen(*at);
            stroke(picture, [at, at], [1.6 * thick + 1.0; 2], RIM);
            stroke(
                picture,
                [at, at],
                [1.6 * thick; 2],
                if *inside { POSITION_COLOUR } else { OUTSIDE },
            );
        }
    }
}

/// Fills what lies within a distance of a line that goes evenly from one end's to the other's.
fn stroke(picture: &mut Picture, [from, to]: [DVec2; 2], radii: [f64; 2], colour: Rgb) {
    let reach = radii[0].max(radii[1]) + 1.0;
    let size = DVec2::new(f64::from(picture.width()), f64::from(picture.height()));
    let low = (from.min(to) - reach).clamp(DVec2::ZERO, size);
    let high = (from.max(to) + reach).clamp(DVec2::ZERO, size);
    let way = to - from;
    for y in low.y as u32..high.y as u32 {
        for x in low.x as u32..high.x as u32 {
            let here = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let length = way.length_squared();
            let along = if length > 0.0 {
                ((here - from).dot(way) / length).clamp(0.0, 1.0)
            } else {
                0.0
            };
            let radius = radii[0] + (radii[1] - radii[0]) * along;
            let off = here.distance(from + way * along);
            picture.blend_pixel(x, y, colour, (radius + 0.5 - off).clamp(0.0, 1.0));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::camera::{PictureSize, UpAxis, ViewDirection};
    use super::super::raster::draw_surface;
    use super::super::surface::ShadedSurface;
    use super::*;
    use crate::pool::Pool;

    #[test]
    fn joints_lie_where_the_camera_sees_them_in_the_colour_of_where_they_are() {
        let pool = Pool::new(1).expect("a thread");
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let surface = ShadedSurface::new(&p, &[[0, 1, 2]], &pool).expect("a surface");
        let view = ViewDirection::new(0.0, 0.0, UpAxis::Y).expect("in range");
        let camera = &Camera::around_surfaces(&[&surface], &[view], PictureSize::new(200, 160).expect("in range"))[0];
        let mut picture = draw_surface(&surface, camera, &pool);
        let marks = BoneMarks {
            bones: vec![[DVec3::new(0.2, 0.2, 0.0), DVec3::new(0.7, 0.2, 0.0)]],
            joints: vec![(DVec3::new(0.2, 0.2, 0.0), true), (DVec3::new(0.9, 0.9, 0.0), false)],
        };
        marks.draw_on(&mut picture, camera);
        let colour_at = |p: DVec3| {
            let seen = camera.project_point(p);
            picture.pixel(seen.x as u32, seen.y as u32)
        };
        assert_eq!(colour_at(DVec3::new(0.2, 0.2, 0.0)), Some(POSITION_COLOUR));
        assert_eq!(colour_at(DVec3::new(0.9, 0.9, 0.0)), Some(OUTSIDE));
        assert_eq!(colour_at(DVec3::new(0.4, 0.2, 0.0)), Some(ROTATION_COLOUR));
    }
}

//! Rings with a number around places that someone should look at.
//!
//! Bones drawn over a picture of a model, as if the model were glass.

use super::camera::Camera;
use super::colour::Rgb;
use super::picture::Picture;
use glam::{DVec2, DVec3};

/// Colours of a ring and of the rim that sets it off from whatever lies under it.
const RING: Rgb = [16, 24, 40];
const RIM: Rgb = [255, 255, 255];

/// A mark is a ring with a label around a place that someone should look at.
#[derive(Debug, Clone, PartialEq)]
pub struct RingMark {
    /// Where it is, in model space.
    pub at: DVec3,
    /// What stands beside it, a character or two.
    pub label: String,
    /// Something lies before it: the ring is dashed.
    pub hidden: bool,
}

/// Dashes of a ring.
const DASHES: f64 = 10.0;

impl RingMark {
    /// Marks the vertices with the largest of `values`: at most `count`, none closer to another than `apart`. A value of 0
    /// marks nothing. Of equal values the first vertex comes first.
    pub fn at_largest_values(positions: &[DVec3], values: &[f64], count: usize, apart: f64) -> Vec<Self> {
        let mut order: Vec<usize> = (0..positions.len().min(values.len()))
            .filter(|&v| values[v] > 0.0)
            .collect();
        order.sort_by(|&a, &b| values[b].total_cmp(&values[a]).then(a.cmp(&b)));
        let mut marks: Vec<Self> = Vec::new();
        for v in order {
            if marks.len() == count {
                break;
            }
            let at = positions[v];
            if marks.iter().all(|m| m.at.distance(at) > apart) {
                let label = (marks.len() + 1).to_string();
                let hidden = false;
                marks.push(Self { at, label, hidden });
            }
        }
        marks
    }

    /// Draws the ring on a picture that `camera` took, which begins `left` and `top` pixels into this one.
    pub fn draw_on(&self, picture: &mut Picture, camera: &Camera, left: u32, top: u32) {
        let size = camera.size();
        let seen = camera.project_point(self.at).truncate();
        let small = f64::from(size.width().min(size.height()));
        let radius = (small / 32.0).clamp(4.0, 24.0);
        let width = (small / 300.0).clamp(1.0, 3.0);
        let inside =
            seen.cmpge(DVec2::ZERO).all() && seen.x <= f64::from(size.width()) && seen.y <= f64::from(size.height());
        if !inside {
            return;
        }
        let center = seen + DVec2::new(f64::from(left), f64::from(top));
        let reach = radius + 2.0 * width + 2.0;
        let low = (center - reach).max(DVec2::new(f64::from(left), f64::from(top)));
        let end = DVec2::new(f64::from(left + size.width()), f64::from(top + size.height()));
        let high = (center + reach).min(end);
        for y in low.y as u32..high.y as u32 {
            for x in low.x as u32..high.x as u32 {
                let here = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let off = (here.distance(center) - radius).abs();
                let turn = libm::atan2(here.y - center.y, here.x - center.x) / std::f64::consts::TAU;
                if self.hidden && (turn + 1.0) * DASHES % 1.0 > 0.5 {
                    continue;
                }
                // Covered shares of the pixel: the rim is wider and lies below.
                picture.blend_pixel(x, y, RIM, (1.2 * width + 0.5 - off).clamp(0.0, 1.0));
                picture.blend_pixel(x, y, RING, (0.5 * width + 0.5 - off).clamp(0.0, 1.0));
            }
        }
        let dot = (size.width().min(size.height()) / 240).clamp(1, 4);
        let (wide, high) = Picture::text_size(dot, &self.label);
        let room = radius + 3.0 * width;
        // Right of the ring, or left of it at the picture's edge.
        let x = match center.x + room + f64::from(wide) <= end.x {
            true => center.x + room,
            false => center.x - room - f64::from(wide),
        };
        let y = (center.y - f64::from(high) / 2.0).clamp(f64::from(top), end.y - f64::from(high).min(end.y));
        let (x, y) = (x.max(f64::from(left)) as u32, y as u32);
        picture.fill_rectangle(
            x.saturating_sub(dot),
            y.saturating_sub(dot),
            wide + 2 * dot,
            high + 2 * dot,
            RIM,
        );
        picture.write_text(x, y, dot, &self.label, RING);
    }
}

/// What is turned: bones, and what holds rotations (figure 6 of the paper).
pub const ROTATION_COLOUR: Rgb = [0x2f, 0x8f, 0x4e];
/// What is put in place: joints, and what holds positions.
pub const POSITION_COLOUR: Rgb = [0xe0, 0x7b, 0x18];
const WRONG: Rgb = [0xc8, 0x1e, 0x2b];
/// How much of the picture below is left.
const GLASS: f64 = 0.45;

/// Bones and the joints between them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BoneMarks {
    /// Where bones begin and end: green lines, thinner at the end.
    pub bones: Vec<[DVec3; 2]>,
    /// Where joints are, and whether they are right: orange discs, red ones where not.
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
        for (at, is_right) in &self.joints {
            let at = seen(*at);
            stroke(picture, [at, at], [1.6 * thick + 1.0; 2], RIM);
            stroke(
                picture,
                [at, at],
                [1.6 * thick; 2],
                if *is_right { POSITION_COLOUR } else { WRONG },
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
    use pliant_exec::pool::Pool;

    /// A triangle, and a camera that faces it.
    fn seen_triangle(width: u32, height: u32) -> (ShadedSurface, Camera) {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let surface = ShadedSurface::new(&p, &[[0, 1, 2]], &Pool::new(1).expect("a thread")).expect("a surface");
        let view = ViewDirection::new(0.0, 0.0, UpAxis::Y).expect("in range");
        let size = PictureSize::new(width, height).expect("in range");
        let camera = Camera::around_surfaces(&[&surface], &[view], size).swap_remove(0);
        (surface, camera)
    }

    #[test]
    fn the_largest_come_first_and_keep_apart() {
        let p = [0.0, 0.1, 5.0, 9.0].map(|x| DVec3::X * x);
        let marks = RingMark::at_largest_values(&p, &[2.0, 3.0, 0.0, 1.0], 9, 0.5);
        let reported: Vec<(f64, &str)> = marks.iter().map(|m| (m.at.x, m.label.as_str())).collect();
        assert_eq!(reported, [(0.1, "1"), (9.0, "2")]);
        assert_eq!(RingMark::at_largest_values(&p, &[1.0; 4], 1, 0.0).len(), 1);
        assert!(RingMark::at_largest_values(&p, &[0.0; 4], 3, 0.0).is_empty());
    }

    #[test]
    fn a_ring_lies_around_its_place_and_nothing_is_drawn_outside() {
        let camera = &seen_triangle(100, 80).1;
        let white = [200, 210, 220];
        let mut picture = Picture::new(140, 100, white).expect("small");
        for (at, label) in [(DVec3::X, "1"), (DVec3::X * 50.0, "2"), (DVec3::NEG_X * 50.0, "3")] {
            let mark = RingMark {
                at,
                label: label.into(),
                hidden: false,
            };
            mark.draw_on(&mut picture, camera, 20, 10);
        }
        let seen = camera.project_point(DVec3::X) + DVec3::new(20.0, 10.0, 0.0);
        let dark: Vec<DVec2> = (0..100u32)
            .flat_map(|y| (0..140u32).map(move |x| (x, y)))
            .filter(|&(x, y)| picture.pixel(x, y).is_some_and(|p| p[0] < 60))
            .map(|(x, y)| DVec2::new(f64::from(x), f64::from(y)))
            .collect();
        assert!(dark.len() > 10);
        assert!(
            dark.iter().all(|d| d.distance(seen.truncate()) < 22.0),
            "{dark:?} around {seen}"
        );
        assert_eq!(picture.pixel(0, 0), Some(white));
        // What is hidden has a part of the ring.
        let mut dashed = Picture::new(140, 100, white).expect("small");
        let hidden = RingMark {
            at: DVec3::X,
            label: String::new(),
            hidden: true,
        };
        hidden.draw_on(&mut dashed, camera, 20, 10);
        let inked = dashed.pixels().iter().filter(|p| p[0] < 60).count();
        let touched = dashed.pixels().iter().filter(|p| **p != white).count();
        assert!(
            inked < dark.len() && touched > 10,
            "{inked} and {touched} of {}",
            dark.len()
        );
    }

    #[test]
    fn joints_lie_where_the_camera_sees_them_in_the_colour_of_where_they_are() {
        let (surface, camera) = seen_triangle(200, 160);
        let mut picture = draw_surface(&surface, &camera, &Pool::new(1).expect("a thread"));
        let marks = BoneMarks {
            bones: vec![[DVec3::new(0.2, 0.2, 0.0), DVec3::new(0.7, 0.2, 0.0)]],
            joints: vec![(DVec3::new(0.2, 0.2, 0.0), true), (DVec3::new(0.9, 0.9, 0.0), false)],
        };
        marks.draw_on(&mut picture, &camera);
        let colour_at = |p: DVec3| {
            let seen = camera.project_point(p);
            picture.pixel(seen.x as u32, seen.y as u32)
        };
        assert_eq!(colour_at(DVec3::new(0.2, 0.2, 0.0)), Some(POSITION_COLOUR));
        assert_eq!(colour_at(DVec3::new(0.9, 0.9, 0.0)), Some(WRONG));
        assert_eq!(colour_at(DVec3::new(0.4, 0.2, 0.0)), Some(ROTATION_COLOUR));
    }
}

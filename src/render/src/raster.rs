//! From a surface and a camera to pixels: depth buffer, supersampling, light.
//!
//! The picture is made in bands of rows, each by one thread with buffers of its own; what a pixel shows does not depend
//! on the band that it lies in. Where two triangles are equally near, the earlier one is seen.

use super::camera::Camera;
use super::colour::{Rgb, SrgbTable, linear_from_hex};
use super::dress::DressedTriangle;
use super::picture::Picture;
use super::surface::ShadedSurface;
use glam::{DVec3, Vec3};
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Samples along each side of a pixel.
const SAMPLES: usize = 3;
/// Rows of pixels in a band.
const BAND: usize = 16;
/// In place of a triangle: nothing is seen there.
const NOTHING: u32 = u32::MAX;
/// How far outside a triangle, as a share of it, a sample still counts, so that no gap shows between two.
const SLACK: f64 = 1e-9;
/// Share of the colour of a marked triangle that is seen through what is before it.
const THROUGH: f32 = 0.35;
/// Width of a drawn edge in pixels.
const WIRE: f64 = 1.0;

/// sRGB of a surface without colours, and of the background from top to bottom.
const CLAY: u32 = 0xe6_df_d4;
const UNMARKED: u32 = 0xe4_e6_e9;
const SKY: [u32; 2] = [0xfa_fb_fc, 0xdc_e1_e7];

/// The colour of the background at its lower end.
pub fn background_end() -> Rgb {
    SrgbTable::new().to_srgb(linear_from_hex(SKY[1]))
}

/// Draws a surface as the camera sees it.
pub fn draw_surface(surface: &ShadedSurface, camera: &Camera, pool: &Pool) -> Picture {
    let size = camera.size();
    let (width, height) = (size.width() as usize, size.height() as usize);
    let pixels = pool.install(|| {
        let scene = RasterScene::new(surface, camera);
        let bands: Vec<Vec<Rgb>> = (0..height.div_ceil(BAND))
            .into_par_iter()
            .map(|band| scene.draw_band(band * BAND, BAND.min(height - band * BAND)))
            .collect();
        bands.concat()
    });
    Picture::from_pixels(width as u32, height as u32, pixels)
}

/// A surface projected by a camera, with what every band of pixels needs.
struct RasterScene<'a> {
    surface: &'a ShadedSurface,
    width: usize,
    height: usize,
    /// Welded vertices in samples, right and down, and towards the eye.
    projected: Vec<DVec3>,
    /// First row of samples of each triangle and the one after its last.
    rows: Vec<[i32; 2]>,
    axes: [Vec3; 3],
    screen: SrgbTable,
    sky: [Vec3; 2],
    clay: Vec3,
    /// The colour of triangles that are not marked, where others are.
    unmarked: Vec3,
}

/// The nearest of the triangles that are marked, in each sample of a band.
struct MarkedSamples<'a> {
    marks: &'a [Option<Vec3>],
    nearest: Vec<(f64, u32)>,
}

impl<'a> MarkedSamples<'a> {
    fn new(marks: Option<&'a [Option<Vec3>]>, samples: usize) -> Self {
        let count = if marks.is_some() { samples } else { 0 };
        Self {
            marks: marks.unwrap_or_default(),
            nearest: vec![(f64::NEG_INFINITY, NOTHING); count],
        }
    }

    fn note(&mut self, triangle: usize, sample: usize, depth: f64) {
        if let Some(Some(_)) = self.marks.get(triangle)
            && depth > self.nearest[sample].0
        {
            self.nearest[sample] = (depth, triangle as u32);
        }
    }

    /// The light of a sample in which a triangle is seen.
    fn shine_through(&self, sample: usize, seen: u32, light: Vec3) -> Vec3 {
        let behind = self.nearest.get(sample).filter(|(_, t)| *t != NOTHING);
        match behind.map(|(_, t)| self.marks[*t as usize]) {
            Some(Some(colour)) if self.marks[seen as usize].is_none() => light.lerp(colour, THROUGH),
            _ => light,
        }
    }
}

impl<'a> RasterScene<'a> {
    fn new(surface: &'a ShadedSurface, camera: &Camera) -> Self {
        let fine = SAMPLES as f64;
        let projected: Vec<DVec3> = surface
            .positions()
            .par_iter()
            .map(|&p| camera.project_point(p) * fine)
            .collect();
        let rows = surface
            .triangles()
            .par_iter()
            .map(|t| {
                let [low, high] = sample_range(t.map(|v| projected[v as usize].y));
                [low as i32, high as i32]
            })
            .collect();
        Self {
            surface,
            width: camera.size().width() as usize,
            height: camera.size().height() as usize,
            projected,
            rows,
            axes: camera.axes().map(|a| a.as_vec3()),
            screen: SrgbTable::new(),
            sky: SKY.map(linear_from_hex),
            clay: linear_from_hex(CLAY),
            unmarked: linear_from_hex(UNMARKED),
        }
    }

    /// Draws `rows` rows of pixels from row `first` on.
    fn draw_band(&self, first: usize, rows: usize) -> Vec<Rgb> {
        let wide = self.width * SAMPLES;
        let (top, bottom) = (first * SAMPLES, (first + rows) * SAMPLES);
        let mut depth = vec![f64::NEG_INFINITY; wide * (bottom - top)];
        let mut seen = vec![NOTHING; depth.len()];
        let mut marked = MarkedSamples::new(self.surface.face_marks(), depth.len());
        for (t, [low, high]) in self.rows.iter().enumerate() {
            if *high <= top as i32 || *low >= bottom as i32 {
                continue;
            }
            let corners = self.projected_corners(t);
            let Some(share) = CornerShares::from_corners(corners) else {
                continue;
            };
            let dressed = match self.dressed_triangle(t, share.whole) {
                // The back of a material that has none.
                Some(None) => continue,
                worn => worn.flatten(),
            };
            let gaps = dressed.filter(DressedTriangle::has_gaps);
            let [left, right] = sample_range(corners.map(|c| c.x)).map(|x| x.clamp(0.0, wide as f64) as usize);
            let y_range = (*low).max(top as i32) as usize..(*high).min(bottom as i32) as usize;
            for y in y_range {
                let row = (y - top) * wide;
                for x in left..right {
                    let weights = share.at_sample(x, y);
                    if weights.iter().any(|&w| w < -SLACK) {
                        continue;
                    }
                    let z = weights[0] * corners[0].z + weights[1] * corners[1].z + weights[2] * corners[2].z;
                    marked.note(t, row + x, z);
                    if z > depth[row + x] && gaps.as_ref().is_none_or(|d| d.is_seen(weights, x, y)) {
                        depth[row + x] = z;
                        seen[row + x] = t as u32;
                    }
                }
            }
        }
        let mut pixels = Vec::with_capacity(rows * self.width);
        for y in 0..rows {
            let sky = self.background_at(first + y);
            for x in 0..self.width {
                let mut sum = Vec3::ZERO;
                for down in 0..SAMPLES {
                    for across in 0..SAMPLES {
                        let (sx, sy) = (x * SAMPLES + across, y * SAMPLES + down);
                        sum += match seen[sy * wide + sx] {
                            NOTHING => sky,
                            t => marked.shine_through(sy * wide + sx, t, self.shade_sample(t as usize, sx, top + sy)),
                        };
                    }
                }
                pixels.push(self.screen.to_srgb(sum / (SAMPLES * SAMPLES) as f32));
            }
        }
        pixels
    }

    fn projected_corners(&self, t: usize) -> [DVec3; 3] {
        self.surface.triangles()[t].map(|v| self.projected[v as usize])
    }

    /// What a triangle wears: `None` for a surface without a dress, `Some(None)` where it is not seen at all.
    fn dressed_triangle(&self, t: usize, whole: f64) -> Option<Option<DressedTriangle<'_>>> {
        let dress = self.surface.dress()?;
        Some(dress.triangle(self.surface.source_of(t), whole))
    }

    fn background_at(&self, row: usize) -> Vec3 {
        let share = row as f32 / (self.height - 1).max(1) as f32;
        self.sky[0] + (self.sky[1] - self.sky[0]) * share
    }

    /// The light that comes from a triangle at a sample.
    fn shade_sample(&self, t: usize, x: usize, y: usize) -> Vec3 {
        let corners = self.projected_corners(t);
        let Some(share) = CornerShares::from_corners(corners) else {
            return self.clay;
        };
        let weights = share.at_sample(x, y);
        let [a, b, c] = weights.map(|w| w as f32);
        let normals = &self.surface.normals()[t];
        let mixed = normals[0] * a + normals[1] * b + normals[2] * c;
        let [right, up, towards] = self.axes;
        let normal = Vec3::new(mixed.dot(right), mixed.dot(up), mixed.dot(towards));
        // Rows go down, so a face that looks at the eye runs the other way round here.
        let faces_away = share.whole > 0.0;
        let normal = if faces_away { -normal } else { normal };
        let normal = Vec3::new(normal.x, normal.y, normal.z.max(0.0)).normalize_or(Vec3::Z);
        let behind = faces_away != self.surface.is_inside_out();
        if let Some(dressed) = self.dressed_triangle(t, share.whole).flatten() {
            let light = dressed.light(weights);
            let shade = if dressed.is_unlit() { 1.0 } else { shade_dressed(normal) };
            return self.with_wires(light * shade, &share, weights);
        }
        let mark = self.surface.face_marks().map(|marks| marks[t].unwrap_or(self.unmarked));
        let mut lit = match (mark, self.surface.colours()) {
            (Some(colour), _) => shade_matt(normal) * colour,
            (None, Some(colours)) => {
                let [p, q, r] = self.surface.triangles()[t].map(|v| colours[v as usize]);
                shade_matt(normal) * (p * a + q * b + r * c)
            }
            (None, None) => shade_clay(normal, self.clay),
        };
        if behind {
            lit *= Vec3::new(0.55, 0.47, 0.43);
        }
        self.with_wires(lit, &share, weights)
    }

    /// The light of a sample, darker where an edge is drawn.
    fn with_wires(&self, lit: Vec3, share: &CornerShares, weights: [f64; 3]) -> Vec3 {
        if !self.surface.has_wires() {
            return lit;
        }
        // How far the sample is from the nearest edge, in samples.
        let from_edge = (0..3)
            .map(|k| weights[k].max(0.0) * share.heights[k])
            .fold(f64::INFINITY, f64::min);
        let is_edge = from_edge < 0.5 * WIRE * SAMPLES as f64;
        if is_edge { lit * 0.15 } else { lit }
    }
}

/// The first row (or column) of samples whose middle is at or after the least number, and the one after the last.
fn sample_range(numbers: [f64; 3]) -> [f64; 2] {
    let [a, b, c] = numbers;
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    // Casts of the result saturate.
    [(low - 0.5 - SLACK).ceil(), (high - 0.5 + SLACK).floor() + 1.0]
}

/// The shares that the corners of a triangle have in each of its points (barycentric coordinates).
struct CornerShares {
    corners: [DVec3; 3],
    /// Twice the signed area in samples.
    whole: f64,
    /// Distance of each corner from the edge opposite to it, in samples.
    heights: [f64; 3],
}

impl CornerShares {
    /// `None` for a triangle seen edge-on.
    fn from_corners(corners: [DVec3; 3]) -> Option<Self> {
        let [a, b, c] = corners.map(|p| p.truncate());
        let whole = (b - a).perp_dot(c - a);
        let heights = [c - b, a - c, b - a].map(|edge| whole.abs() / edge.length());
        (whole != 0.0 && whole.is_finite()).then_some(Self {
            corners,
            whole,
            heights,
        })
    }

    fn at_sample(&self, x: usize, y: usize) -> [f64; 3] {
        let [a, b, c] = self.corners.map(|p| p.truncate());
        let p = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let first = (b - p).perp_dot(c - p) / self.whole;
        let second = (c - p).perp_dot(a - p) / self.whole;
        [first, second, 1.0 - first - second]
    }
}

/// The light that a place receives from a large lamp at the upper left, a small one at the right, and the sky. The normal is
/// right, up, towards the eye.
fn received_light(normal: Vec3) -> f32 {
    let key = normal.dot(Vec3::new(-0.424, 0.565, 0.707)).max(0.0);
    let fill = normal.dot(Vec3::new(0.842, 0.0, 0.539)).max(0.0);
    let sky = 0.5 + 0.5 * normal.y;
    0.78 * key + 0.16 * fill + 0.13 * sky + 0.06
}

/// Shades clay: full contrast, a soft highlight, darker towards the outline.
fn shade_clay(normal: Vec3, colour: Vec3) -> Vec3 {
    // Half-way between the lamp and the eye.
    let shine = normal.dot(Vec3::new(-0.229, 0.306, 0.924)).max(0.0);
    let shine = (0..5).fold(shine, |s, _| s * s);
    let outline = 0.72 + 0.28 * normal.z;
    colour * received_light(normal) * outline + Vec3::splat(0.10 * shine)
}

/// Shades colours that stand for numbers: little contrast, no highlight.
fn shade_matt(normal: Vec3) -> f32 {
    0.42 + 0.58 * received_light(normal)
}

/// Shades base colours: they are unchanged in full light, and shapes are still visible.
fn shade_dressed(normal: Vec3) -> f32 {
    (0.22 + 0.74 * received_light(normal)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::super::camera::{PictureSize, UpAxis, ViewDirection};
    use super::*;

    fn pool(threads: usize) -> Pool {
        Pool::new(threads).expect("threads")
    }

    fn picture(p: &[DVec3], t: &[[u32; 3]], size: [u32; 2], threads: usize) -> Picture {
        let surface = ShadedSurface::new(p, t, &pool(threads)).expect("a surface");
        let view = ViewDirection::new(0.0, 0.0, UpAxis::Y).expect("in range");
        let size = PictureSize::new(size[0], size[1]).expect("in range");
        let camera = &Camera::around_surfaces(&[&surface], &[view], size)[0];
        draw_surface(&surface, camera, &pool(threads))
    }

    fn square(z: f64, half: f64) -> [DVec3; 4] {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec3::new(x * half, y * half, z))
    }

    #[test]
    fn a_square_covers_exactly_its_pixels() {
        let picture = picture(&square(0.0, 1.0), &[[0, 1, 2], [0, 2, 3]], [100, 50], 1);
        let sky = |y: u32| picture.pixel(0, y).expect("inside");
        // 92 % of the height, in the middle: columns 27 to 72, rows 2 to 47.
        for y in 0..50 {
            for x in 0..100 {
                let inside = (27..73).contains(&x) && (2..48).contains(&y);
                assert_eq!(picture.pixel(x, y) != Some(sky(y)), inside, "{x} {y}");
            }
        }
        let middle = picture.pixel(50, 25);
        assert_eq!(
            picture.pixel(30, 5),
            middle,
            "a flat face has one colour, also along its diagonal"
        );
    }

    #[test]
    fn the_nearer_surface_is_seen_whatever_its_place_in_the_list() {
        let p: Vec<DVec3> = [square(-1.0, 1.0), square(1.0, 0.5)].concat();
        let (back, front) = ([[0, 1, 2], [0, 2, 3]], [[4, 5, 6], [4, 6, 7]]);
        let colours: Vec<Vec3> = (0..8).map(|v| if v < 4 { Vec3::X } else { Vec3::Z }).collect();
        for triangles in [[back, front].concat(), [front, back].concat()] {
            let surface = ShadedSurface::new(&p, &triangles, &pool(1)).expect("a surface");
            let surface = surface.with_colours(&colours).expect("one for each");
            let view = ViewDirection::new(0.0, 0.0, UpAxis::Y).expect("in range");
            let camera = &Camera::around_surfaces(&[&surface], &[view], PictureSize::new(64, 64).expect("in range"))[0];
            let picture = draw_surface(&surface, camera, &pool(1));
            let [middle, rim] = [picture.pixel(32, 32), picture.pixel(8, 32)].map(|p| p.expect("inside"));
            assert!(middle[2] > 100 && middle[0] == 0, "{middle:?}");
            assert!(rim[0] > 100 && rim[2] == 0, "{rim:?}");
        }
    }

    #[test]
    fn backs_are_darker_and_neighbours_leave_no_gap() {
        let p = square(0.0, 1.0);
        let front = picture(&p, &[[0, 1, 2], [0, 2, 3]], [64, 64], 1);
        let back = picture(&p, &[[0, 2, 1], [0, 3, 2]], [64, 64], 1);
        let sum = |p: &Picture| p.pixel(32, 32).expect("inside").map(u32::from).iter().sum::<u32>();
        assert!(sum(&back) + 60 < sum(&front));
        // A fan about a point off the grid: every sample inside belongs to some triangle.
        let mut fan = vec![DVec3::new(0.123, 0.077, 0.0)];
        fan.extend((0..37).map(|k| {
            let (sin, cos) = libm::sincos(f64::from(k) * std::f64::consts::TAU / 37.0);
            DVec3::new(cos, sin, 0.0)
        }));
        let triangles: Vec<[u32; 3]> = (0..37).map(|k| [0, 1 + k, 1 + (k + 1) % 37]).collect();
        let picture = picture(&fan, &triangles, [96, 96], 1);
        let middle = picture.pixel(48, 48);
        for y in 0..96u32 {
            for x in 0..96u32 {
                let off = [x, y].map(|k| (f64::from(k) - 47.5) / 44.0);
                if off[0].hypot(off[1]) < 0.95 {
                    assert_eq!(picture.pixel(x, y), middle, "{x} {y}");
                }
            }
        }
    }

    #[test]
    fn threads_and_huge_or_tiny_units_change_nothing() {
        let mut p = vec![DVec3::ZERO];
        let mut t = Vec::new();
        for k in 0..200u32 {
            let (sin, cos) = libm::sincos(f64::from(k) * 0.37);
            p.push(DVec3::new(cos, f64::from(k) * 0.01, sin) * f64::from(k % 7 + 1));
            if k > 1 {
                t.push([k - 1, k, k + 1]);
            }
        }
        let one = picture(&p, &t, [120, 90], 1);
        for threads in [2, 3] {
            assert!(one == picture(&p, &t, [120, 90], threads), "{threads} threads");
        }
        for scale in [1e-100, 1e36] {
            let scaled: Vec<DVec3> = p.iter().map(|p| *p * scale).collect();
            let other = picture(&scaled, &t, [120, 90], 1);
            let differ = one.pixels().iter().zip(other.pixels()).filter(|(a, b)| a != b).count();
            assert!(differ < 120, "{differ} pixels differ at scale {scale:e}");
        }
        // A heap of points has no pixel, and is not a reason to fail.
        let flat = picture(&[DVec3::ZERO, DVec3::Z, DVec3::Z * 2.0], &[[0, 1, 2]], [16, 16], 1);
        assert_eq!(flat.pixel(8, 8), flat.pixel(0, 8));
    }
}

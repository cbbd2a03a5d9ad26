//! A picture in memory: pixels, what is put on it, and its PNG bytes.
//!
//! Several views on one picture, by cameras that share a frame, with a key to the colours.

use super::camera::{Camera, PictureSize, ViewDirection};
use super::colour::{ColourKey, Rgb};
use super::raster::{background_end, draw_surface};
use super::ring_mark::RingMark;
use super::surface::ShadedSurface;
use super::{Error, font};
use crate::pool::Pool;

/// The colour of words and numbers on a picture.
pub(super) const INK: Rgb = [52, 58, 66];

/// A picture is rows of pixels, from the upper left corner.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    width: u32,
    height: u32,
    pixels: Vec<Rgb>,
}

impl Picture {
    /// Most pixels of one picture.
    pub const MOST: u64 = 1 << 27;

    /// A picture of one colour.
    ///
    /// # Errors
    /// [`Error::TooLarge`] for more than [`Picture::MOST`] pixels, or none.
    pub fn new(width: u64, height: u64, colour: Rgb) -> Result<Self, Error> {
        let too_large = Error::TooLarge {
            width,
            height,
            most: Self::MOST,
        };
        match (u32::try_from(width), u32::try_from(height), width.checked_mul(height)) {
            (Ok(w), Ok(h), Some(pixels @ 1..=Self::MOST)) => Ok(Self::from_pixels(w, h, vec![colour; pixels as usize])),
            _ => Err(too_large),
        }
    }

    pub(super) fn from_pixels(width: u32, height: u32, pixels: Vec<Rgb>) -> Self {
        Self { width, height, pixels }
    }

    /// Pixels across.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// The colour `x` pixels to the right of the upper left one and `y` below it; `None` outside.
    pub fn pixel(&self, x: u32, y: u32) -> Option<Rgb> {
        (x < self.width && y < self.height).then(|| self.pixels[y as usize * self.width as usize + x as usize])
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[Rgb] {
        &self.pixels
    }

    /// Colours a rectangle; what lies outside the picture is left out.
    pub fn fill_rectangle(&mut self, x: u32, y: u32, width: u32, height: u32, colour: Rgb) {
        let columns = x.min(self.width) as usize..x.saturating_add(width).min(self.width) as usize;
        for row in y.min(self.height)..y.saturating_add(height).min(self.height) {
            let start = row as usize * self.width as usize;
            self.pixels[start + columns.start..start + columns.end].fill(colour);
        }
    }

    /// Mixes a share (0 to 1) of a colour into a pixel; outside the picture nothing happens.
    pub(super) fn blend_pixel(&mut self, x: u32, y: u32, colour: Rgb, share: f64) {
        if x < self.width && y < self.height && share > 0.0 {
            let pixel = &mut self.pixels[y as usize * self.width as usize + x as usize];
            for (old, new) in pixel.iter_mut().zip(colour) {
                let mixed = f64::from(*old) + (f64::from(new) - f64::from(*old)) * share;
                *old = mixed.round() as u8;
            }
        }
    }

    /// Puts another picture on this one; what lies outside is left out.
    pub fn paste_picture(&mut self, other: &Self, x: u32, y: u32) {
        let columns = other.width.min(self.width.saturating_sub(x)) as usize;
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let from = row as usize * other.width as usize;
            let to = (y + row) as usize * self.width as usize + x as usize;
            if columns > 0 {
                self.pixels[to..to + columns].copy_from_slice(&other.pixels[from..from + columns]);
            }
        }
    }

    /// Writes one line of text, each of its dots a square of `dot` pixels, and returns where it ends. Characters without
    /// a shape are boxes.
    pub fn write_text(&mut self, x: u32, y: u32, dot: u32, text: &str, colour: Rgb) -> u32 {
        let mut left = x;
        for c in text.chars() {
            for (row, bits) in font::glyph(c).into_iter().enumerate() {
                for column in 0..font::WIDTH {
                    if bits >> (font::WIDTH - 1 - column) & 1 == 1 {
                        let at = |start: u32, k: u32| start.saturating_add(k.saturating_mul(dot));
                        self.fill_rectangle(at(left, column), at(y, row as u32), dot, dot, colour);
                    }
                }
            }
            left = left.saturating_add((font::WIDTH + 1).saturating_mul(dot));
        }
        left
    }

    /// Pixels that a line of text takes, right and down.
    pub fn text_size(dot: u32, text: &str) -> (u32, u32) {
        let letters = u32::try_from(text.chars().count()).unwrap_or(u32::MAX);
        let dots = letters.saturating_mul(font::WIDTH + 1).saturating_sub(1);
        (dots.saturating_mul(dot), font::HEIGHT.saturating_mul(dot))
    }

    /// The picture as a PNG file: 8 bits, sRGB.
    ///
    /// # Errors
    /// [`Error::Png`] when the encoder fails.
    pub fn encode_png(&self) -> Result<Vec<u8>, Error> {
        let failed = |e: png::EncodingError| Error::Png(e.to_string());
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Balanced);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header().map_err(failed)?;
        writer.write_image_data(self.pixels.as_flattened()).map_err(failed)?;
        writer.finish().map_err(failed)?;
        Ok(bytes)
    }
}

/// Pictures of one size as an animated PNG file that plays again and again, `rate` of them a second. What shows no animations
/// shows the first.
///
/// # Errors
/// [`Error::Empty`] without pictures, [`Error::Png`] when their sizes differ or the encoder fails.
pub fn encode_moving_png(pictures: &[Picture], rate: f64) -> Result<Vec<u8>, Error> {
    let failed = |e: png::EncodingError| Error::Png(e.to_string());
    let first = pictures.first().ok_or(Error::Empty { triangles: 0 })?;
    if pictures
        .iter()
        .any(|p| (p.width, p.height) != (first.width, first.height))
    {
        return Err(Error::Png("frames differ in size".into()));
    }
    let count = u32::try_from(pictures.len()).map_err(|e| Error::Png(e.to_string()))?;
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, first.width, first.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    encoder.set_animated(count, 0).map_err(failed)?;
    let millis = (1e3 / rate).round().clamp(1.0, 65535.0);
    encoder.set_frame_delay(millis as u16, 1000).map_err(failed)?;
    let mut writer = encoder.write_header().map_err(failed)?;
    for picture in pictures {
        writer.write_image_data(picture.pixels.as_flattened()).map_err(failed)?;
    }
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

/// Views smaller than this have no key and no words.
const WORDS: u32 = 96;

/// A sheet shows one shape from one side or several, and beside it, where it is given, what the shape was before.
///
/// One view puts before and after side by side. Several make a strip, with the shape before above the one after.
#[derive(Debug, Clone)]
pub struct ViewSheet<'a> {
    /// The shape before; it is left out when it is `None`.
    pub before: Option<&'a ShadedSurface>,
    /// The shape that is shown.
    pub shape: &'a ShadedSurface,
    /// The directions from which it is seen; at least one.
    pub views: &'a [ViewDirection],
    /// Pixels of each view.
    pub size: PictureSize,
    /// The key to the colours, drawn below the views where there is room.
    pub key: Option<ColourKey>,
    /// Rings around places, drawn on every view of the shape.
    pub marks: Vec<RingMark>,
}

impl ViewSheet<'_> {
    /// Draws all views with one scale.
    ///
    /// # Errors
    /// [`Error::TooLarge`] when all views together have more than [`Picture::MOST`] pixels.
    pub fn draw_views(&self, pool: &Pool) -> Result<Picture, Error> {
        let surfaces: Vec<&ShadedSurface> = self.before.into_iter().chain([self.shape]).collect();
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let (columns, rows) = match self.views.len() {
            0 | 1 => (count(surfaces.len()), 1),
            views => (count(views), count(surfaces.len())),
        };
        let (width, height) = (self.size.width(), self.size.height());
        let side = |n: u32, pixels: u32| u64::from(n) * u64::from(pixels);
        let mut picture = Picture::new(side(columns, width), side(rows, height), background_end())?;
        let words = height >= WORDS && width >= WORDS;
        let strip = match self.key {
            Some(_) if words => (height / 16).clamp(14, 48),
            _ => 0,
        };
        let view_height = height - strip.div_ceil(rows);
        let cameras = Camera::around_surfaces(&surfaces, self.views, PictureSize::new(width, view_height)?);
        let dot = (width.min(height) / 240).clamp(1, 4);
        for (k, surface) in surfaces.iter().enumerate() {
            for (v, camera) in cameras.iter().enumerate() {
                let (column, row) = if rows > 1 || cameras.len() > 1 { (v, k) } else { (k, v) };
                let (x, y) = (count(column) * width, count(row) * view_height);
                picture.paste_picture(&draw_surface(surface, camera, pool), x, y);
                if k + 1 == surfaces.len() {
                    self.marks.iter().for_each(|m| m.draw_on(&mut picture, camera, x, y));
                }
                if words && surfaces.len() > 1 && v == 0 {
                    let word = ["before", "after"][k.min(1)];
                    picture.write_text(x + 4 * dot, y + 4 * dot, dot, word, INK);
                }
            }
        }
        if let (Some(key), true) = (&self.key, strip > 0) {
            let top = rows * view_height;
            key.draw_on(&mut picture, top, rows * height - top);
        }
        Ok(picture)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_png_holds_the_pixels_that_were_drawn() {
        let mut picture = Picture::new(40, 20, [9, 8, 7]).expect("small");
        picture.fill_rectangle(30, 15, 100, 100, [1, 2, 3]);
        picture.write_text(2, 2, 1, "A", [255, 0, 0]);
        let png = picture.encode_png().expect("encoded");
        let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().expect("a PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("small")];
        let facts = reader.next_frame(&mut pixels).expect("an image");
        assert_eq!((facts.width, facts.height), (40, 20));
        assert_eq!(pixels, picture.pixels().as_flattened());
        assert_eq!(picture.pixel(39, 19), Some([1, 2, 3]));
        assert_eq!(picture.pixel(29, 19), Some([9, 8, 7]));
        assert!(picture.pixels().contains(&[255, 0, 0]));
    }

    #[test]
    fn nothing_is_drawn_outside_and_nothing_too_large_is_made() {
        let mut picture = Picture::new(4, 4, [0; 3]).expect("small");
        let other = Picture::new(3, 3, [5; 3]).expect("small");
        picture.paste_picture(&other, 3, 3);
        picture.paste_picture(&other, 9, 9);
        picture.fill_rectangle(u32::MAX, u32::MAX, u32::MAX, u32::MAX, [1; 3]);
        picture.write_text(u32::MAX, 0, u32::MAX, "gone", [1; 3]);
        assert_eq!(picture.pixels().iter().filter(|p| **p == [5; 3]).count(), 1);
        assert!(picture.pixels().iter().all(|p| *p != [1; 3]));
        for (w, h) in [(0, 5), (u64::MAX, 2), (1 << 14, 1 << 14)] {
            assert!(matches!(Picture::new(w, h, [0; 3]), Err(Error::TooLarge { .. })));
        }
    }
}

#[cfg(test)]
mod view_sheet_tests {
    use super::super::camera::UpAxis;
    use super::super::colour::Rgb;
    use super::super::dress::STRETCH_RANGE;
    use super::*;
    use glam::DVec3;

    fn pool() -> Pool {
        Pool::new(2).expect("two threads")
    }

    fn surface(size: f64) -> ShadedSurface {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * size);
        ShadedSurface::new(&p, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], &pool()).expect("a surface")
    }

    /// How many pixels of a tile differ from the same row's first pixel of the picture: what is drawn there.
    fn drawn(picture: &Picture, x: u32, y: u32, size: u32) -> usize {
        let mut count = 0;
        for row in y..y + size {
            let sky = picture.pixel(0, row);
            count += (x..x + size)
                .filter(|&column| picture.pixel(column, row) != sky)
                .count();
        }
        count
    }

    #[test]
    fn before_and_after_share_a_scale() {
        let (small, large) = (surface(1.0), surface(2.0));
        let views = [ViewDirection::new(30.0, 20.0, UpAxis::Y).expect("in range")];
        let plate = ViewSheet {
            before: Some(&small),
            shape: &large,
            views: &views,
            size: PictureSize::new(64, 64).expect("in range"),
            key: None,
            marks: Vec::new(),
        };
        let picture = plate.draw_views(&pool()).expect("small");
        assert_eq!((picture.width(), picture.height()), (128, 64));
        let (before, after) = (drawn(&picture, 0, 0, 64), drawn(&picture, 64, 0, 64));
        let ratio = after as f64 / before as f64;
        assert!((3.4..4.6).contains(&ratio), "{before} and {after} pixels");
    }

    #[test]
    fn a_strip_has_a_tile_for_each_view() {
        let (small, large) = (surface(1.0), surface(2.0));
        let first = ViewDirection::new(0.0, 20.0, UpAxis::Z).expect("in range");
        let views: Vec<ViewDirection> = (0..5).map(|k| first.turned_by(72.0 * f64::from(k))).collect();
        let size = PictureSize::new(40, 40).expect("in range");
        let plate = ViewSheet {
            before: None,
            shape: &large,
            views: &views,
            size,
            key: None,
            marks: Vec::new(),
        };
        let strip = plate.draw_views(&pool()).expect("small");
        assert_eq!((strip.width(), strip.height()), (200, 40));
        assert!((0..5).all(|k| drawn(&strip, 40 * k, 0, 40) > 40));
        let two = ViewSheet {
            before: Some(&small),
            ..plate.clone()
        };
        assert_eq!(two.draw_views(&pool()).map(|p| (p.width(), p.height())), Ok((200, 80)));
        let many: Vec<ViewDirection> = (0..64).map(|k| first.turned_by(f64::from(k))).collect();
        let too_large = ViewSheet {
            views: &many,
            size: PictureSize::new(8192, 8192).expect("in range"),
            ..plate
        };
        assert!(matches!(too_large.draw_views(&pool()), Err(Error::TooLarge { .. })));
    }

    #[test]
    fn a_key_is_told_where_there_is_room() {
        let shape = surface(1.0);
        let views = [ViewDirection::new(30.0, 20.0, UpAxis::Y).expect("in range")];
        let colours = |side: u32| {
            let plate = ViewSheet {
                before: None,
                shape: &shape,
                views: &views,
                size: PictureSize::new(side, side).expect("in range"),
                key: Some(ColourKey::for_stretch(STRETCH_RANGE)),
                marks: Vec::new(),
            };
            let picture = plate.draw_views(&pool()).expect("small");
            assert_eq!((picture.width(), picture.height()), (side, side));
            let strong = |p: &&Rgb| p[0].abs_diff(p[2]) > 100;
            picture.pixels().iter().filter(strong).count()
        };
        assert!(colours(320) > 100);
        assert_eq!(colours(64), 0);
    }
}

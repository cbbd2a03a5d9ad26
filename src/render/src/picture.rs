//! A picture in memory: pixels, what is put on it, and its PNG bytes.

use super::colour::Rgb;
use super::{Error, font};

/// The colour of words and numbers on a picture.
pub const INK: Rgb = [52, 58, 66];

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

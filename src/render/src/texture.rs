//! Pictures that lie on a surface: decoded within bounds, kept in halving sizes, looked up by texture coordinates.
//!
//! PNG and JPEG, by crates that decode without instructions of a certain processor, so that a picture is the same
//! everywhere. A header is not trusted: what it asks for is checked before anything is allocated.

use super::colour::{SrgbTable, linear_from_hex};
use glam::{Vec3, Vec4};
use pliant_asset::TextureWrap;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Most texels of one picture: 8192 × 8192.
const MOST_TEXELS: u64 = 1 << 26;
/// Longest side of a picture.
const LONGEST_SIDE: usize = 1 << 15;

/// One size of a picture; rows from the top, sRGB and opacity.
#[derive(Debug, Clone)]
struct TextureLevel {
    width: usize,
    height: usize,
    texels: Vec<[u8; 4]>,
}

/// A texture is a picture in all its halving sizes.
#[derive(Debug, Clone)]
pub struct Texture {
    levels: Vec<TextureLevel>,
    linear: [f32; 256],
}

/// Where and how a texture is looked up.
#[derive(Debug, Clone, Copy)]
pub(super) struct TextureLookup {
    pub wrap: [TextureWrap; 2],
    pub nearest: bool,
    /// How often the size is halved.
    pub level: usize,
}

impl Texture {
    /// Decodes a PNG or JPEG.
    ///
    /// # Errors
    /// A sentence that says what is wrong with the file, or how large it may be.
    pub fn decode(bytes: &[u8]) -> Result<Self, String> {
        let first = if bytes.starts_with(b"\x89PNG") {
            decode_png(bytes)?
        } else if bytes.starts_with(&[0xff, 0xd8]) {
            decode_jpeg(bytes)?
        } else {
            return Err("it is neither PNG nor JPEG".into());
        };
        let linear = std::array::from_fn(|byte| linear_from_hex((byte as u32) << 16).x);
        let mut texture = Self {
            levels: vec![first],
            linear,
        };
        let screen = SrgbTable::new();
        while let Some(last) = texture.levels.last().filter(|l| l.width > 1 || l.height > 1) {
            let half = texture.halved(last, &screen);
            texture.levels.push(half);
        }
        Ok(texture)
    }

    /// Texels across and down.
    pub fn size(&self) -> [usize; 2] {
        self.levels.first().map_or([1, 1], |l| [l.width, l.height])
    }

    /// How often the size can be halved.
    pub(super) fn last_level(&self) -> usize {
        self.levels.len().saturating_sub(1)
    }

    /// Linear red, green and blue, and opacity at a place from the upper left corner.
    pub(super) fn look_up(&self, [u, v]: [f32; 2], lookup: TextureLookup) -> Vec4 {
        let Some(level) = self.levels.get(lookup.level.min(self.last_level())) else {
            return Vec4::ONE;
        };
        let (x, y) = (u * level.width as f32, v * level.height as f32);
        let texel = |column: f32, row: f32| {
            let column = wrapped(column, level.width, lookup.wrap[0]);
            let row = wrapped(row, level.height, lookup.wrap[1]);
            self.linear_of(level.texels.get(row * level.width + column))
        };
        if lookup.nearest && lookup.level == 0 {
            return texel(x.floor(), y.floor());
        }
        let (left, top) = ((x - 0.5).floor(), (y - 0.5).floor());
        let (across, down) = (x - 0.5 - left, y - 0.5 - top);
        let row = |y: f32| texel(left, y).lerp(texel(left + 1.0, y), across);
        row(top).lerp(row(top + 1.0), down)
    }

    fn linear_of(&self, texel: Option<&[u8; 4]>) -> Vec4 {
        let &[r, g, b, a] = texel.unwrap_or(&[255; 4]);
        let light = |byte: u8| self.linear[usize::from(byte)];
        Vec4::new(light(r), light(g), light(b), f32::from(a) / 255.0)
    }

    /// Half as large: each texel the mean of up to four, by light and by opacity, so that what is not there does not tint.
    fn halved(&self, full: &TextureLevel, screen: &SrgbTable) -> TextureLevel {
        let (width, height) = (full.width.div_ceil(2).max(1), full.height.div_ceil(2).max(1));
        let mut texels = Vec::with_capacity(width * height);
        for row in 0..height {
            for column in 0..width {
                let mut light = Vec3::ZERO;
                let (mut opacity, mut plain) = (0.0, Vec3::ZERO);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let x = (column * 2 + dx).min(full.width - 1);
                    let y = (row * 2 + dy).min(full.height - 1);
                    let texel = self.linear_of(full.texels.get(y * full.width + x));
                    light += texel.truncate() * texel.w;
                    plain += texel.truncate();
                    opacity += texel.w;
                }
                let mean = if opacity > 0.0 { light / opacity } else { plain / 4.0 };
                let [r, g, b] = screen.to_srgb(mean);
                texels.push([r, g, b, (opacity / 4.0 * 255.0).round() as u8]);
            }
        }
        TextureLevel { width, height, texels }
    }
}

/// The column or row of a place outside of the picture.
fn wrapped(place: f32, count: usize, wrap: TextureWrap) -> usize {
    // Casts saturate, and take what is not a number as 0.
    let (at, count_i) = (place as i64, count as i64);
    let found = match wrap {
        TextureWrap::Repeat => at.rem_euclid(count_i),
        TextureWrap::Clamp => at.clamp(0, count_i - 1),
        TextureWrap::Mirror => {
            let twice = at.rem_euclid(2 * count_i);
            twice.min(2 * count_i - 1 - twice)
        }
    };
    found as usize
}

fn check_size(width: usize, height: usize) -> Result<(), String> {
    let texels = width as u64 * height as u64;
    if width == 0 || height == 0 {
        return Err(format!("it has {width} x {height} pixels"));
    }
    if texels > MOST_TEXELS || width.max(height) > LONGEST_SIDE {
        return Err(format!(
            "it has {width} x {height} pixels, at most {MOST_TEXELS} in all are drawn"
        ));
    }
    Ok(())
}

fn decode_png(bytes: &[u8]) -> Result<TextureLevel, String> {
    let failed = |e: png::DecodingError| {
        format!("it is not a complete PNG: {e}")
            .to_lowercase()
            .replace("png", "PNG")
    };
    let mut decoder = png::Decoder::new_with_limits(
        std::io::Cursor::new(bytes),
        png::Limits {
            bytes: 8 * MOST_TEXELS as usize,
        },
    );
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(failed)?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    check_size(width, height)?;
    let size = reader.output_buffer_size().ok_or("it is too large")?;
    let mut samples = vec![0; size];
    let frame = reader.next_frame(&mut samples).map_err(failed)?;
    samples.truncate(frame.buffer_size());
    let texels: Vec<[u8; 4]> = match frame.color_type {
        png::ColorType::Grayscale => samples.iter().map(|&g| [g, g, g, 255]).collect(),
        png::ColorType::GrayscaleAlpha => samples.as_chunks().0.iter().map(|&[g, a]| [g, g, g, a]).collect(),
        png::ColorType::Rgb => samples.as_chunks().0.iter().map(|&[r, g, b]| [r, g, b, 255]).collect(),
        png::ColorType::Rgba => samples.as_chunks().0.to_vec(),
        png::ColorType::Indexed => return Err("its palette is missing".into()),
    };
    whole_level(width, height, texels)
}

fn decode_jpeg(bytes: &[u8]) -> Result<TextureLevel, String> {
    let failed = |e: zune_jpeg::errors::DecodeErrors| format!("it is not a complete JPEG: {e}");
    let options = DecoderOptions::default()
        .set_max_width(LONGEST_SIDE)
        .set_max_height(LONGEST_SIDE)
        .set_use_unsafe(false)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(failed)?;
    let (width, height) = decoder.dimensions().ok_or("it declares no size")?;
    check_size(width, height)?;
    let samples = decoder.decode().map_err(failed)?;
    let texels = match decoder.output_colorspace() {
        Some(ColorSpace::Luma) => samples.iter().map(|&g| [g, g, g, 255]).collect(),
        _ => samples.as_chunks().0.iter().map(|&[r, g, b]| [r, g, b, 255]).collect(),
    };
    whole_level(width, height, texels)
}

fn whole_level(width: usize, height: usize, texels: Vec<[u8; 4]>) -> Result<TextureLevel, String> {
    if texels.len() != width * height {
        return Err(format!("it has {} of {width} x {height} pixels", texels.len()));
    }
    Ok(TextureLevel { width, height, texels })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of 4 × 2 texels: the column in red, the row in green.
    fn picture() -> Texture {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 4, 2);
        encoder.set_color(png::ColorType::Rgb);
        let mut writer = encoder.write_header().expect("a header");
        let texels: Vec<u8> = (0..8u8).flat_map(|k| [k % 4 * 80, k / 4 * 80, 0]).collect();
        writer.write_image_data(&texels).expect("texels");
        writer.finish().expect("an end");
        Texture::decode(&bytes).expect("a picture")
    }

    #[test]
    fn coordinates_count_from_the_upper_left_and_wrap_as_written() {
        let texture = picture();
        assert_eq!((texture.size(), texture.last_level()), ([4, 2], 2));
        let screen = SrgbTable::new();
        let texel = |u: f32, v: f32, wrap: TextureWrap| {
            let lookup = TextureLookup {
                wrap: [wrap; 2],
                nearest: true,
                level: 0,
            };
            let [r, g, _] = screen.to_srgb(texture.look_up([u, v], lookup).truncate());
            [r / 80, g / 80]
        };
        use TextureWrap::{Clamp, Mirror, Repeat};
        assert_eq!([texel(0.1, 0.1, Repeat), texel(0.9, 0.9, Repeat)], [[0, 0], [3, 1]]);
        assert_eq!([texel(1.1, 0.1, Repeat), texel(-0.1, 0.1, Repeat)], [[0, 0], [3, 0]]);
        assert_eq!([texel(1.1, 0.1, Clamp), texel(-0.1, 9.0, Clamp)], [[3, 0], [0, 1]]);
        assert_eq!([texel(1.1, 0.1, Mirror), texel(-0.3, 0.1, Mirror)], [[3, 0], [1, 0]]);
        assert_eq!(texel(f32::NAN, f32::INFINITY, Repeat).len(), 2, "no panic, some texel");
    }

    #[test]
    fn what_is_no_picture_is_refused_with_a_reason() {
        let whole = {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, 1, 1);
            encoder.set_color(png::ColorType::Grayscale);
            let mut writer = encoder.write_header().expect("a header");
            writer.write_image_data(&[7]).expect("a texel");
            writer.finish().expect("an end");
            bytes
        };
        assert!(Texture::decode(&whole).is_ok());
        for cut in 0..whole.len() - 12 {
            assert!(Texture::decode(&whole[..cut]).is_err(), "{cut} bytes");
        }
        for bytes in [
            &b"\xff\xd8\xff"[..],
            b"\xff\xd8\xff\xc0\0\x11\x08\xff\xff\xff\xff",
            b"GIF89a",
            b"",
        ] {
            assert!(Texture::decode(bytes).is_err());
        }
    }
}

//! Colours: as bytes for the screen, as linear light for shading, and ramps that give numbers a colour.
//!
//! Ramps run through Oklab (Ottosson 2020), where equal steps look equal, so that no number stands out by its colour
//! alone.

use glam::Vec3;
use pliant_mesh::Crossing;

/// A colour as a screen takes it: sRGB, red, green, blue.
pub type Rgb = [u8; 3];

/// Turns an sRGB colour written as 0xRRGGBB into linear light.
pub(super) fn linear_from_hex(hex: u32) -> Vec3 {
    let channel = |shift: u32| {
        let s = f64::from(hex >> shift & 0xff) / 255.0;
        let linear = if s <= 0.04045 {
            s / 12.92
        } else {
            libm::pow((s + 0.055) / 1.055, 2.4)
        };
        linear as f32
    };
    Vec3::new(channel(16), channel(8), channel(0))
}

/// The colour that marks a triangle by what it crosses, as linear light: amber, red, or none.
pub fn crossing_colour(crossing: Crossing) -> Option<Vec3> {
    match crossing {
        Crossing::None => None,
        Crossing::AtRest => Some(linear_from_hex(0xf0_b0_20)),
        Crossing::New => Some(linear_from_hex(0xe0_10_18)),
    }
}

/// Steps of linear light that a [`SrgbTable`] resolves.
const STEPS: usize = 8192;

/// A table that turns linear light into sRGB bytes.
pub(super) struct SrgbTable(Vec<u8>);

impl SrgbTable {
    pub fn new() -> Self {
        let byte = |k: usize| {
            let linear = k as f64 / STEPS as f64;
            let s = if linear <= 0.003_130_8 {
                linear * 12.92
            } else {
                1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055
            };
            (s * 255.0).round() as u8
        };
        Self((0..=STEPS).map(byte).collect())
    }

    pub fn to_srgb(&self, light: Vec3) -> Rgb {
        // Casts saturate, and take what is not a number as 0.
        let byte = |x: f32| self.0[((x * STEPS as f32).round() as usize).min(STEPS)];
        [byte(light.x), byte(light.y), byte(light.z)]
    }
}

/// A colour in Oklab: lightness, then green to red, then blue to yellow.
#[derive(Debug, Clone, Copy)]
struct OklabColour(f64, f64, f64);

impl OklabColour {
    fn blend(self, other: Self, share: f64) -> Self {
        let between = |a: f64, b: f64| a + (b - a) * share;
        Self(
            between(self.0, other.0),
            between(self.1, other.1),
            between(self.2, other.2),
        )
    }

    fn to_linear(self) -> Vec3 {
        let Self(l, a, b) = self;
        let cube = |x: f64| x * x * x;
        let long = cube(l + 0.396_337_777_4 * a + 0.215_803_757_3 * b);
        let medium = cube(l - 0.105_561_345_8 * a - 0.063_854_172_8 * b);
        let short = cube(l - 0.089_484_177_5 * a - 1.291_485_548_0 * b);
        let red = 4.076_741_662_1 * long - 3.307_711_591_3 * medium + 0.230_969_929_2 * short;
        let green = -1.268_438_004_6 * long + 2.609_757_401_1 * medium - 0.341_319_396_5 * short;
        let blue = -0.004_196_086_3 * long - 0.703_418_614_7 * medium + 1.707_614_701_0 * short;
        let channel = |x: f64| x.clamp(0.0, 1.0) as f32;
        Vec3::new(channel(red), channel(green), channel(blue))
    }
}

/// A colour ramp gives every number a colour.
///
/// ```
/// use pliant_render::ColourRamp;
///
/// let unchanged = ColourRamp::Stretch.linear_colour(0.0);
/// assert_eq!(unchanged, ColourRamp::Stretch.linear_colour(f64::NAN));
/// assert!(ColourRamp::Stretch.linear_colour(1.0).x > ColourRamp::Stretch.linear_colour(1.0).z);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourRamp {
    /// Runs from -1 (blue, squeezed) over 0 (light grey, as it was) to 1 (red, stretched).
    Stretch,
    /// Runs from 0 (light) to 1 (dark red).
    Amount,
}

impl ColourRamp {
    /// The least number with a colour of its own; the greatest is 1.
    pub fn lower_end(self) -> f64 {
        match self {
            Self::Stretch => -1.0,
            Self::Amount => 0.0,
        }
    }

    /// The colour of a number, as linear light; numbers beyond the ends have the colour of the end, NaN that of 0.
    pub fn linear_colour(self, value: f64) -> Vec3 {
        let value = if value.is_nan() {
            0.0
        } else {
            value.clamp(self.lower_end(), 1.0)
        };
        match self {
            Self::Stretch => {
                let middle = OklabColour(0.93, 0.0, 0.0);
                let end = if value < 0.0 {
                    OklabColour(0.45, -0.045, -0.160)
                } else {
                    OklabColour(0.50, 0.172, 0.092)
                };
                middle.blend(end, value.abs()).to_linear()
            }
            Self::Amount => {
                let stops = [
                    OklabColour(0.95, -0.005, 0.030),
                    OklabColour(0.82, 0.030, 0.130),
                    OklabColour(0.62, 0.160, 0.100),
                    OklabColour(0.36, 0.130, 0.010),
                ];
                let at = value * (stops.len() - 1) as f64;
                let k = (at as usize).min(stops.len() - 2);
                stops[k].blend(stops[k + 1], at - k as f64).to_linear()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back_as_they_went() {
        let screen = SrgbTable::new();
        for byte in 0..=255u32 {
            let there = linear_from_hex(byte << 16 | byte << 8 | byte);
            assert_eq!(screen.to_srgb(there), [byte as u8; 3]);
        }
        assert_eq!(screen.to_srgb(Vec3::new(9.0, -1.0, f32::NAN)), [255, 0, 0]);
    }

    #[test]
    fn a_ramp_distinguishes_sides_and_knows_every_number() {
        let screen = SrgbTable::new();
        let rgb = |ramp: ColourRamp, x: f64| screen.to_srgb(ramp.linear_colour(x));
        let [red, blue] = [rgb(ColourRamp::Stretch, 1.0), rgb(ColourRamp::Stretch, -1.0)];
        assert!(red[0] > 150 && red[2] < 80, "{red:?}");
        assert!(blue[2] > 130 && blue[0] < 60, "{blue:?}");
        let [r, g, b] = rgb(ColourRamp::Stretch, 0.0);
        assert!(r == g && g == b && r > 220);
        for ramp in [ColourRamp::Stretch, ColourRamp::Amount] {
            assert_eq!(rgb(ramp, f64::INFINITY), rgb(ramp, 1.0));
            assert_eq!(rgb(ramp, f64::NEG_INFINITY), rgb(ramp, ramp.lower_end()));
            assert_eq!(rgb(ramp, f64::NAN), rgb(ramp, 0.0));
            // Away from 0 it only gets darker.
            let lightness = |x: f64| ramp.linear_colour(x).element_sum();
            for k in 0..100 {
                assert!(
                    lightness(f64::from(k + 1) / 100.0) < lightness(f64::from(k) / 100.0),
                    "{ramp:?} at {k}"
                );
            }
        }
    }
}

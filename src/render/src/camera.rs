//! Where a picture is taken from: a direction, and a frame that several shapes can share.

use super::Error;
use super::surface::ShadedSurface;
use glam::DVec3;

/// Share of a view's sides that the shape may fill.
const FILL: f64 = 0.92;

/// A picture size is the pixels of a view, both sides in the range that is allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PictureSize {
    width: u32,
    height: u32,
}

impl PictureSize {
    /// Fewest pixels of a side.
    pub const LEAST: u32 = 16;
    /// Most pixels of a side.
    pub const MOST: u32 = 8192;

    /// Checks both sides.
    ///
    /// # Errors
    /// [`Error::Size`] when a side is out of range.
    pub fn new(width: u32, height: u32) -> Result<Self, Error> {
        let allowed = Self::LEAST..=Self::MOST;
        if allowed.contains(&width) && allowed.contains(&height) {
            return Ok(Self { width, height });
        }
        Err(Error::Size {
            width: width.into(),
            height: height.into(),
            least: Self::LEAST,
            most: Self::MOST,
        })
    }

    /// Pixels across.
    pub fn width(self) -> u32 {
        self.width
    }

    /// Pixels down.
    pub fn height(self) -> u32 {
        self.height
    }
}

/// The up axis is the axis of the model that points up in the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UpAxis {
    /// The y axis points up, as in glTF.
    #[default]
    Y,
    /// The z axis points up, as in most scans and drawings.
    Z,
}

/// A view direction is the direction from which a shape is seen, without perspective.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewDirection {
    azimuth: f64,
    elevation: f64,
    up: UpAxis,
}

impl ViewDirection {
    /// Looks from `azimuth` degrees around the up axis (0 looks at the side that faces +z, or -y with [`UpAxis::Z`]; 90 at the one that
    /// faces +x) and `elevation` degrees above the horizon.
    ///
    /// # Errors
    /// [`Error::View`] when the angles are out of range.
    pub fn new(azimuth: f64, elevation: f64, up: UpAxis) -> Result<Self, Error> {
        if azimuth.abs() <= 360.0 && elevation.abs() <= 90.0 {
            Ok(Self { azimuth, elevation, up })
        } else {
            Err(Error::View { azimuth, elevation })
        }
    }

    /// Finds the view in which `direction` points at the eye, as nearly as an elevation of at most 70° allows, so that up
    /// stays up. Without a direction it looks straight ahead.
    ///
    /// ```
    /// use glam::DVec3;
    /// use pliant_render::{UpAxis, ViewDirection};
    ///
    /// let from_the_right = ViewDirection::facing(DVec3::X, UpAxis::Y);
    /// assert_eq!(from_the_right, ViewDirection::new(90.0, 0.0, UpAxis::Y)?);
    /// # Ok::<(), pliant_render::Error>(())
    /// ```
    #[must_use]
    pub fn facing(direction: DVec3, up: UpAxis) -> Self {
        let d = match up {
            UpAxis::Y => direction,
            UpAxis::Z => DVec3::new(direction.x, direction.z, -direction.y),
        };
        let finite = |angle: f64| if angle.is_finite() { angle } else { 0.0 };
        let level = (d.x * d.x + d.z * d.z).sqrt();
        Self {
            azimuth: finite(libm::atan2(d.x, d.z).to_degrees()),
            elevation: finite(libm::atan2(d.y, level).to_degrees()).clamp(-70.0, 70.0),
            up,
        }
    }

    /// Turns the view by `degrees` more around the up axis.
    #[must_use]
    pub fn turned_by(self, degrees: f64) -> Self {
        Self {
            azimuth: (self.azimuth + degrees) % 360.0,
            ..self
        }
    }

    /// Unit vectors in model space: right, up and towards the eye.
    fn axes(&self) -> [DVec3; 3] {
        let (sin_a, cos_a) = libm::sincos(self.azimuth.to_radians());
        let (sin_e, cos_e) = libm::sincos(self.elevation.to_radians());
        let right = DVec3::new(cos_a, 0.0, -sin_a);
        let towards = DVec3::new(cos_e * sin_a, sin_e, cos_e * cos_a);
        let axes = [right, towards.cross(right), towards];
        match self.up {
            UpAxis::Y => axes,
            UpAxis::Z => axes.map(|v| DVec3::new(v.x, -v.z, v.y)),
        }
    }
}

/// A camera is a view direction with a scale and a middle: it maps points of the model to pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    axes: [DVec3; 3],
    center: DVec3,
    scale: f64,
    size: PictureSize,
}

impl Camera {
    /// Makes one camera for each view, with one scale for all, such that every surface fits into every picture. A single
    /// view is centred on what is seen; several turn about the middle of the box around the surfaces.
    pub fn around_surfaces(surfaces: &[&ShadedSurface], views: &[ViewDirection], size: PictureSize) -> Vec<Self> {
        let points = || surfaces.iter().flat_map(|s| s.positions());
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        for &p in points() {
            (low, high) = (low.min(p), high.max(p));
        }
        let mut middle = low * 0.5 + high * 0.5;
        if !middle.is_finite() {
            middle = DVec3::ZERO;
        }
        // Half of what each picture must show, seen from the middle.
        let mut half = [0.0f64; 2];
        for view in views {
            let [right, up, _] = view.axes();
            let mut reach = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
            for p in points() {
                let d = *p - middle;
                for (r, x) in reach.iter_mut().zip([d.dot(right), d.dot(up)]) {
                    *r = [r[0].min(x), r[1].max(x)];
                }
            }
            if views.len() == 1 && reach.iter().flatten().all(|x| x.is_finite()) {
                let shift = reach.map(|r| 0.5 * (r[0] + r[1]));
                middle += right * shift[0] + up * shift[1];
                reach = [0, 1].map(|k| [reach[k][0] - shift[k], reach[k][1] - shift[k]]);
            }
            for (h, r) in half.iter_mut().zip(reach) {
                *h = h.max(-r[0]).max(r[1]);
            }
        }
        let room = [size.width, size.height].map(|n| 0.5 * FILL * f64::from(n));
        let fit = |k: usize| room[k] / half[k];
        let mut scale = fit(0).min(fit(1));
        if !(scale.is_finite() && scale > 0.0) {
            scale = 1.0;
        }
        views
            .iter()
            .map(|view| Self {
                axes: view.axes(),
                center: middle,
                scale,
                size,
            })
            .collect()
    }

    /// Keeps the direction, puts `at` in the middle, and lets `radius` around it fill the picture.
    #[must_use]
    pub fn close_up(&self, at: DVec3, radius: f64) -> Self {
        let side = f64::from(self.size.width.min(self.size.height));
        let scale = 0.5 * side / radius;
        let usable = scale.is_finite() && scale > 0.0;
        Self {
            center: at,
            scale: if usable { scale } else { self.scale },
            ..self.clone()
        }
    }

    /// The pixels of the picture.
    pub fn size(&self) -> PictureSize {
        self.size
    }

    /// Projects a point: right and down in pixels from the upper left corner, and towards the eye.
    pub fn project_point(&self, p: DVec3) -> DVec3 {
        let d = p - self.center;
        let [right, up, towards] = self.axes;
        DVec3::new(
            0.5 * f64::from(self.size.width) + d.dot(right) * self.scale,
            0.5 * f64::from(self.size.height) - d.dot(up) * self.scale,
            d.dot(towards) * self.scale,
        )
    }

    /// The unit vector in model space towards the eye.
    pub fn towards_eye(&self) -> DVec3 {
        self.axes[2]
    }

    /// Unit vectors in model space: right, up and towards the eye.
    pub(super) fn axes(&self) -> [DVec3; 3] {
        self.axes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_look_where_they_say_and_are_right_handed() {
        let axes = |a, e, up| ViewDirection::new(a, e, up).expect("in range").axes();
        let near = |a: DVec3, b: DVec3| a.distance(b) < 1e-12;
        assert!(near(axes(0.0, 0.0, UpAxis::Y)[2], DVec3::Z) && near(axes(90.0, 0.0, UpAxis::Y)[2], DVec3::X));
        assert!(near(axes(0.0, 0.0, UpAxis::Z)[2], -DVec3::Y) && near(axes(90.0, 0.0, UpAxis::Z)[2], DVec3::X));
        assert!(near(axes(0.0, 0.0, UpAxis::Y)[1], DVec3::Y) && near(axes(0.0, 0.0, UpAxis::Z)[1], DVec3::Z));
        for up in [UpAxis::Y, UpAxis::Z] {
            let [right, above, towards] = axes(37.0, 64.0, up);
            assert!(near(right.cross(above), towards));
        }
        assert!(near(axes(10.0, 90.0, UpAxis::Y)[2], DVec3::Y), "straight from above");
    }

    #[test]
    fn a_view_can_face_a_direction_and_a_camera_go_near() {
        for up in [UpAxis::Y, UpAxis::Z] {
            for d in [DVec3::new(1.0, 0.4, -0.7), DVec3::new(-0.2, -0.5, 0.9), DVec3::X] {
                let [_, _, towards] = ViewDirection::facing(d, up).axes();
                assert!(towards.distance(d.normalize()) < 1e-12, "{up:?} {d}");
            }
            let steep = if up == UpAxis::Y { DVec3::Y } else { DVec3::Z };
            let [_, above, towards] = ViewDirection::facing(steep, up).axes();
            assert!(towards.dot(steep) > 0.9 && above.dot(steep) > 0.3);
            assert!(ViewDirection::facing(DVec3::ZERO, up).axes()[2].is_finite());
        }
        let size = PictureSize::new(100, 60).expect("in range");
        let view = ViewDirection::new(0.0, 0.0, UpAxis::Y).expect("in range");
        let near = Camera::around_surfaces(&[], &[view], size)[0].close_up(DVec3::new(3.0, 2.0, 1.0), 0.5);
        assert_eq!(
            near.project_point(DVec3::new(3.0, 2.0, 1.0)).truncate(),
            glam::DVec2::new(50.0, 30.0)
        );
        assert_eq!(near.project_point(DVec3::new(3.0, 2.5, 1.0)).y, 0.0);
    }

    #[test]
    fn sizes_and_views_out_of_range_are_refused_with_what_is_allowed() {
        for (w, h) in [(15, 100), (100, 8193), (0, 0)] {
            let text = PictureSize::new(w, h).expect_err("out of range").to_string();
            assert!(
                text.contains(&format!("{w}x{h}")) && text.contains("16 to 8192"),
                "{text}"
            );
        }
        for (a, e) in [(f64::NAN, 0.0), (0.0, 91.0), (f64::INFINITY, 0.0)] {
            assert!(ViewDirection::new(a, e, UpAxis::Y).is_err());
        }
    }
}

//! Gaussian splats, which are carried along with a model and not solved: PLY as 3DGS writes it, `.splat` and `.spz`. As a model of
//! their own they get a surface that is solved.
//!
//! A file comes back in its own format with the numbers changed that the motion changed, or as a fresh file of another one.

mod attributes;
mod cage;
mod cells;
mod cloud;
mod harmonics;
mod model;
mod motion;
mod ply;
mod records;
mod spz;
#[cfg(test)]
mod tests;

pub(super) use attributes::SplatAttributes;
pub use cloud::Splats;
pub(super) use model::SplatModelCodec;
pub use motion::{SplatMotion, SplatPlaces};

use crate::files::{ReadWatch, check_main_size, counted};
use crate::format::{FormatDetails, Recognition};
use crate::{Error, FileSet, Format, Limits, WrittenFiles, WrittenWarning};
use bytes::Bytes;
use cloud::SplatChange;
use pliant_exec::progress::Progress;

/// Records of 32 bytes, one for each Gaussian splat.
pub(super) const SPLAT_FORMAT: Format = Format::new(&FormatDetails {
    name: "splat",
    media_types: &[],
    recognise: |_| Recognition::Unlikely,
    aliases: &[],
});

/// Niantic's packed Gaussian splats.
pub(super) const SPZ_FORMAT: Format = Format::new(&FormatDetails {
    name: "spz",
    media_types: &[],
    recognise: |bytes| Recognition::mark(spz::begins_like(bytes)),
    aliases: &[],
});

impl Format {
    /// Whether it holds Gaussian splats: in PLY a cloud of points can be one.
    pub fn holds_splats(self) -> bool {
        self == Self::PLY || self.holds_splats_alone()
    }

    /// Whether it holds Gaussian splats and nothing else.
    pub fn holds_splats_alone(self) -> bool {
        Self::SPLATS.contains(&self)
    }
}

/// The warning of so many splats whose numbers are those of no ellipsoid.
pub(super) fn unsound_warning(count: usize) -> Option<WrittenWarning> {
    let unsound = counted(count, "splat has", "splats have")?;
    let message = format!(
        "{unsound} no rotation or one of length 0, or a scale or rotation that is not a number; they move and keep their shape"
    );
    Some(WrittenWarning::new("splats-unsound", message, ""))
}

/// Centres are said to be rounded where one is off by more than this: half of a millimetre, where numbers are metres,
const SEEN_ROUNDING: f64 = 0.5e-3;
/// or by more than this share of the usual standard deviation along the longest axis.
const SEEN_SHARE: f64 = 0.1;

/// Reads and writes one format of splats.
struct SplatFile {
    read: fn(Bytes, &ReadWatch<'_>) -> Result<Splats, Error>,
    /// Writes a file of the same format with the numbers changed of what has moved.
    patch: fn(&Splats) -> Result<Vec<u8>, Error>,
    /// Writes a fresh file.
    build: fn(&Splats) -> Result<Vec<u8>, Error>,
}

impl SplatFile {
    fn of(format: Format) -> Self {
        if format == Format::PLY {
            Self {
                read: ply::read,
                patch: ply::patch,
                build: ply::build,
            }
        } else if format == Format::SPZ {
            Self {
                read: spz::read,
                patch: spz::patch,
                build: spz::build,
            }
        } else {
            Self {
                read: records::read,
                patch: records::patch,
                build: records::build,
            }
        }
    }
}

impl Splats {
    /// The format of a file of Gaussian splats, `format` where it is known; `None` for other files.
    pub fn format_of(files: &FileSet, format: Option<Format>) -> Option<Format> {
        let known = format.or_else(|| Format::from_file(&files.name, &files.main))?;
        let holds = known.holds_splats_alone() || (known == Format::PLY && ply::holds_splats(&files.main));
        holds.then_some(known)
    }

    /// Reads a file of that format, which [`Splats::format_of`] has found.
    ///
    /// # Errors
    /// [`Error`] with the place and what is allowed.
    pub fn read(files: FileSet, format: Format, limits: &Limits, progress: &dyn Progress) -> Result<Self, Error> {
        let watch = ReadWatch::new(limits, progress, files.total_bytes());
        Self::read_within(files.main, format, &watch)
    }

    /// As [`Splats::read`], as a part of reading a model.
    pub(super) fn read_within(main: Bytes, format: Format, watch: &ReadWatch<'_>) -> Result<Self, Error> {
        check_main_size(&main)?;
        let splats = (SplatFile::of(format).read)(main, watch)?;
        splats.check_centers()?;
        Ok(splats)
    }

    /// Writes them as they are now in `format`: in their own one with the numbers changed that have changed.
    ///
    /// # Errors
    /// [`Error::Unwritable`] for a format without splats, and where a number does not fit.
    pub fn write(&self, format: Format) -> Result<WrittenFiles, Error> {
        if !format.holds_splats() {
            let problem = "it holds no Gaussian splats; choose ply, splat or spz";
            return Err(Error::unwritable(format, problem));
        }
        let is_own = format == self.format;
        let codec = SplatFile::of(format);
        let main = match is_own {
            true if self.is_whole() && self.changes.iter().all(|c| *c == SplatChange::None) => self.upload.to_vec(),
            true => (codec.patch)(self)?,
            false => (codec.build)(self)?,
        };
        Ok(WrittenFiles {
            main,
            warnings: self.warnings_in(format),
            ..WrittenFiles::default()
        })
    }

    /// What a file of that format does not hold of them, and what of them may not fit.
    fn warnings_in(&self, format: Format) -> Vec<WrittenWarning> {
        let mut warnings = Vec::new();
        warnings.extend(unsound_warning(self.unsound()));
        let mut warn = |code: &'static str, message: String| warnings.push(WrittenWarning::new(code, message, ""));
        if let Some(divided) = counted(self.divided, "splat was", "splats were") {
            warn(
                "splats-divided",
                format!(
                    "{divided} larger than the bend around them and divided: the file has {} splats; largeSplats KEEP leaves them whole",
                    self.len()
                ),
            );
        }
        if let Some(bent) = counted(self.bent, "splat is", "splats are") {
            warn(
                "splats-large",
                format!(
                    "{bent} larger than the bend around them: they turn and stretch as a whole, and their ends stand off; \
                     divide them, or train with smaller ones"
                ),
            );
        }
        if let Some(clamped) = counted(self.clamped_in(format), "splat has", "splats have") {
            warn(
                "splats-clamped",
                format!(
                    "{clamped} colours, scales or harmonics beyond what {format} holds; the nearest that it holds are written"
                ),
            );
        }
        warnings.extend(self.rounded_in(format));
        if format != self.format {
            let mut left = self.beyond.clone();
            if format != Format::PLY && !self.normals.is_empty() {
                left.push("normals".into());
            }
            if format == Format::SPLAT && self.degree > 0 {
                left.push("spherical harmonics".into());
            }
            warnings.extend(WrittenWarning::left_out(&left, format, ""));
        }
        warnings
    }

    /// The warning of centres that a file of that format rounds by more than is seen.
    fn rounded_in(&self, format: Format) -> Option<WrittenWarning> {
        let is_own = format == self.format;
        let step = if format == Format::SPZ { spz::step(self) } else { 0.0 };
        if format == Format::PLY && ply::has_double_centers(self) {
            return None;
        }
        let off = |value: f64| match step > 0.0 {
            true => (libm::round(value / step) * step - value).abs(),
            false => (f64::from(value as f32) - value).abs(),
        };
        let written = self.centers.iter().zip(&self.changes);
        let written = written.filter(|(_, change)| !is_own || **change > SplatChange::None);
        let parts = written.flat_map(|(center, _)| center.to_array());
        let most = parts.map(off).fold(0.0, f64::max);
        let mut lengths: Vec<f64> = (0..self.len()).map(|k| self.longest_axis(k).length()).collect();
        lengths.retain(|length| *length > 0.0);
        let middle = lengths.len() / 2;
        let usual = match lengths.is_empty() {
            true => f64::INFINITY,
            false => *lengths.select_nth_unstable_by(middle, f64::total_cmp).1,
        };
        let far = self.centers.iter().map(|c| c.abs().max_element()).fold(0.0, f64::max);
        let how = match step > 0.0 {
            true => format!("coordinates of the {format} have steps of {step:.1e}, for the largest is {far:.3e}"),
            false => format!("numbers of the {format} have seven digits, and the largest coordinate is {far:.3e}"),
        };
        let message = format!(
            "{how}: centres are up to {most:.1e} off; move the splats nearer to the origin, or delete those that are far from the others"
        );
        (most > SEEN_ROUNDING.min(SEEN_SHARE * usual)).then(|| WrittenWarning::new("places-rounded", message, ""))
    }

    /// How many have numbers that do not fit the bytes of that format.
    fn clamped_in(&self, format: Format) -> usize {
        let is_own = format == self.format;
        let width = self.coefficients();
        let clamps = |row: usize| {
            let moved = self.changes[row] > SplatChange::None;
            let colours = self.looks[row].colour;
            let shape = &self.shapes[row];
            let harmonics = &self.harmonics[row * width..(row + 1) * width];
            if format == Format::SPLAT {
                return !is_own && records::clamps_colours(colours);
            }
            let placed = (moved || !is_own) && spz::clamps_shape(shape, harmonics);
            placed || (!is_own && spz::clamps_colours(colours))
        };
        match format == Format::PLY {
            true => 0,
            false => (0..self.len()).filter(|&row| clamps(row)).count(),
        }
    }
}

//! Gaussian splats, which are carried along with a model and not solved: PLY as 3DGS writes it, `.splat` and `.spz`.
//!
//! A file comes back in its own format with the numbers changed that the motion changed, or as a fresh file of another one.

mod cloud;
mod harmonics;
mod ply;
mod records;
mod spz;
#[cfg(test)]
mod tests;

pub use cloud::Splats;

use super::list_of;
use crate::files::{ReadWatch, check_main_size, counted};
use crate::format::{FormatDetails, Recognition};
use crate::{Error, FileSet, Format, Limits, WrittenFiles, WrittenWarning};
use bytes::Bytes;
use pliant_exec::progress::Progress;

impl Format {
    /// Records of 32 bytes, one for each Gaussian splat.
    pub const SPLAT: Self = Self::new(&FormatDetails {
        name: "splat",
        media_types: &["application/octet-stream"],
        recognise: |_| Recognition::Unlikely,
        aliases: &[],
    });
    /// Niantic's packed Gaussian splats.
    pub const SPZ: Self = Self::new(&FormatDetails {
        name: "spz",
        media_types: &["application/gzip"],
        recognise: |bytes| Recognition::mark(spz::begins_like(bytes)),
        aliases: &[],
    });

    /// The formats of a passenger that hold Gaussian splats and nothing else.
    const SPLATS_ALONE: [Self; 2] = [Self::SPLAT, Self::SPZ];

    /// The names of the formats in which a passenger is written: with `and`, "glb, gltf, obj, ply, off, stl, splat and spz".
    pub fn passenger_output_list(conjunction: &str) -> String {
        let all = Self::ALL.into_iter().chain(Self::SPLATS_ALONE);
        list_of(&all.map(Self::name).collect::<Vec<_>>(), conjunction)
    }

    /// The names of the formats in which a passenger is read: with `and`, "glb, gltf, obj, ply, off, stl, fbx, splat and spz".
    pub fn passenger_name_list(conjunction: &str) -> String {
        let all = Self::READ.into_iter().chain(Self::SPLATS_ALONE);
        list_of(&all.map(Self::name).collect::<Vec<_>>(), conjunction)
    }

    /// The format of that name in which a passenger is read, in any case.
    pub fn of_passenger(name: &str) -> Option<Self> {
        let mut splats = Self::SPLATS_ALONE.into_iter();
        Self::from_name(name).or_else(|| splats.find(|f| f.name().eq_ignore_ascii_case(name)))
    }

    /// The format of a passenger by its file name's extension.
    pub fn of_passenger_file(name: &str) -> Option<Self> {
        name.rsplit_once('.')
            .and_then(|(_, extension)| Self::of_passenger(extension))
    }

    /// Whether it holds Gaussian splats: in PLY a cloud of points can be one.
    pub fn holds_splats(self) -> bool {
        self == Self::PLY || self.holds_splats_alone()
    }

    /// Whether it holds Gaussian splats and nothing else.
    pub fn holds_splats_alone(self) -> bool {
        Self::SPLATS_ALONE.contains(&self)
    }
}

/// Refuses a file of Gaussian splats that is to be a model of its own.
pub(crate) fn refuse_as_model(files: &FileSet, format: Option<Format>) -> Result<(), Error> {
    match Splats::format_of(files, format) {
        Some(format) => Err(Error::unsupported(
            format,
            "the model",
            "Gaussian splats, which have no surface to pose",
            "open the mesh that they belong to, or one around them, and give this file as its passenger: file of \
             passengers in a job, or Carry",
        )),
        None => Ok(()),
    }
}

/// Reads and writes one format of splats.
struct SplatCodec {
    read: fn(Bytes, &ReadWatch<'_>) -> Result<Splats, Error>,
    /// Writes a file of the same format with the numbers changed of what has moved.
    patch: fn(&Splats) -> Result<Vec<u8>, Error>,
    /// Writes a fresh file.
    build: fn(&Splats) -> Result<Vec<u8>, Error>,
}

impl SplatCodec {
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
        let is_known = |known: Format| match format {
            Some(format) => format == known,
            None => (known.details().recognise)(&files.main) > Recognition::Unlikely,
        };
        let named = || format.is_none() && Format::from_file(&files.name, &files.main).is_none();
        if is_known(Format::SPZ) {
            Some(Format::SPZ)
        } else if is_known(Format::SPLAT) || (named() && files.name.to_ascii_lowercase().ends_with(".splat")) {
            Some(Format::SPLAT)
        } else if is_known(Format::PLY) && ply::holds_splats(&files.main) {
            Some(Format::PLY)
        } else {
            None
        }
    }

    /// Reads a file of that format, which [`Splats::format_of`] has found.
    ///
    /// # Errors
    /// [`Error`] with the place and what is allowed.
    pub fn read(files: FileSet, format: Format, limits: &Limits, progress: &dyn Progress) -> Result<Self, Error> {
        check_main_size(&files.main)?;
        let watch = ReadWatch::new(limits, progress, files.total_bytes());
        let splats = (SplatCodec::of(format).read)(files.main, &watch)?;
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
        let codec = SplatCodec::of(format);
        let main = match is_own {
            true if !self.moved.contains(&true) => self.upload.to_vec(),
            true => (codec.patch)(self)?,
            false => (codec.build)(self)?,
        };
        let mut warnings = Vec::new();
        if let Some(unsound) = counted(self.unsound(), "splat has", "splats have") {
            let message = format!(
                "{unsound} a rotation of length 0, or a scale or rotation that is not a number; they move and keep their shape"
            );
            warnings.push(WrittenWarning::new("splats-unsound", message, ""));
        }
        if !is_own {
            let mut left = self.beyond.clone();
            if format == Format::SPLAT && self.degree > 0 {
                left.push("spherical harmonics".into());
            }
            warnings.extend(WrittenWarning::left_out(&left, format, ""));
        }
        Ok(WrittenFiles {
            main,
            warnings,
            ..WrittenFiles::default()
        })
    }
}

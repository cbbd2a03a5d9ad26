//! A model as the rest of the house sees it: render vertices, triangles, primitives, and how to write it back.

use super::{Error, FileSet, Format, Geometry, Limits, Written, gltf, obj, off, plain, ply, stl};
use glam::DVec3;
use std::ops::Deref;

/// One run of render vertices: a glTF primitive under one node, or the whole of any other format.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Primitive {
    /// Index of the node that places it; 0 without nodes.
    pub node: u32,
    /// Index of its mesh in the file; 0 without meshes.
    pub mesh: u32,
    /// Index inside that mesh.
    pub primitive: u32,
    /// Name of the node, else of the mesh, else empty.
    pub name: String,
    /// Its first render vertex.
    pub first_vertex: u32,
    /// Number of its render vertices.
    pub vertex_count: u32,
    /// Number of its triangle-corner indices after conversion to triangles (three per triangle).
    pub index_count: u32,
    /// Whether the model gives normals for it.
    pub has_normals: bool,
    /// Whether the model gives tangents for it.
    pub has_tangents: bool,
}

/// A model that was read, with the files it came from. Dereferences to its [`Geometry`], so that `model.positions`,
/// `model.triangles` and the like read as fields of the model.
#[derive(Debug, Clone)]
pub struct Model {
    /// The format it came in.
    pub format: Format,
    /// The mesh that the files describe, at rest.
    pub geometry: Geometry,
    /// The files, kept byte for byte.
    pub files: FileSet,
    pub(super) source: Source,
}

/// What a format's writer must know beyond the files and the geometry.
#[derive(Debug, Clone)]
pub(super) enum Source {
    Gltf(gltf::Source),
    Obj(obj::Source),
    Ply(ply::Source),
    Off(off::Source),
    Stl(stl::Source),
}

impl Deref for Model {
    type Target = Geometry;

    fn deref(&self) -> &Geometry {
        &self.geometry
    }
}

impl Model {
    /// Reads a model. The format is `format` when given, else what the bytes say, else what the file name says.
    ///
    /// # Errors
    /// [`Error`] with the place and what is allowed; nothing is read outside `files`.
    ///
    /// # Example
    /// ```
    /// use pliant::asset::{FileSet, Format, Limits, Model};
    ///
    /// let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 # a face\n";
    /// let model = Model::read(FileSet::single("one.obj", text), None, &Limits::default())?;
    /// assert_eq!((model.positions.len(), model.triangles.len()), (3, 1));
    ///
    /// let mut positions = model.positions.clone();
    /// positions[1].z = 0.5;
    /// let written = model.write(&positions, Format::Obj)?;
    /// assert_eq!(written.main, b"v 0 0 0\nv 1 0 0.5\nv 0 1 0\nf 1 2 3 # a face\n");
    /// # Ok::<(), pliant::asset::Error>(())
    /// ```
    pub fn read(files: FileSet, format: Option<Format>, limits: &Limits) -> Result<Self, Error> {
        let told = || Format::from_bytes(&files.main).or_else(|| Format::from_file_name(&files.name));
        let Some(format) = format.or_else(told) else {
            let place = if files.name.is_empty() {
                "the model".into()
            } else {
                files.name
            };
            return Err(Error::UnknownFormat { place });
        };
        let (geometry, source) = match format {
            Format::Glb | Format::Gltf => {
                gltf::read(&files, format, limits).map(|(geometry, source)| (geometry, Source::Gltf(source)))
            }
            Format::Obj => obj::read(&files.main, limits).map(|(geometry, source)| (geometry, Source::Obj(source))),
            Format::Ply => ply::read(&files.main, limits).map(|(geometry, source)| (geometry, Source::Ply(source))),
            Format::Off => off::read(&files.main, limits).map(|(geometry, source)| (geometry, Source::Off(source))),
            Format::Stl => stl::read(&files.main, limits).map(|(geometry, source)| (geometry, Source::Stl(source))),
        }?;
        geometry.check(format, limits)?;
        Ok(Self {
            format,
            geometry,
            files,
            source,
        })
    }

    /// Writes the model with new positions (one per render vertex, in model space) in `format`.
    ///
    /// In the model's own format (GLB and glTF count as one) the uploaded files are edited: what the deformation did not
    /// change stays as it was, byte for byte, and authored normals and tangents follow the deformation. In another
    /// format a fresh file is made of the positions, triangles, names, normals, one set of texture coordinates, colours
    /// and the names of materials, as far as both formats know them.
    ///
    /// # Errors
    /// [`Error::Unwritable`] when the count differs from the model's, when a position is not finite, or when it does not
    /// fit the format's numbers.
    pub fn write(&self, positions: &[DVec3], format: Format) -> Result<Written, Error> {
        let (seen, count) = (positions.len(), self.positions.len());
        if seen != count {
            return Err(Error::unwritable(
                format,
                format!("{seen} positions are given, the model has {count} vertices"),
            ));
        }
        if let Some(i) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::unwritable(
                format,
                format!("the position of vertex {i} is {}, not finite", positions[i]),
            ));
        }
        if format == self.format && same_bits(&self.positions, positions) {
            return Ok(self.as_uploaded());
        }
        let rest = &self.geometry;
        let bytes = match (&self.source, format) {
            (Source::Gltf(source), Format::Glb | Format::Gltf) => {
                return gltf::write(&self.files, source, rest, positions, format);
            }
            (_, Format::Glb | Format::Gltf) => return gltf::build(&plain::of_model(self, positions, format)?, format),
            (Source::Obj(source), Format::Obj) => obj::write(&self.files.main, source, rest, positions),
            (Source::Ply(source), Format::Ply) => ply::write(&self.files.main, source, rest, positions)?,
            (Source::Off(source), Format::Off) => off::write(&self.files.main, source, rest, positions),
            (Source::Stl(source), Format::Stl) => stl::write(&self.files.main, source, rest, positions)?,
            (_, Format::Obj) => obj::build(&plain::of_model(self, positions, format)?),
            (_, Format::Ply) => ply::build(&plain::of_model(self, positions, format)?),
            (_, Format::Off) => off::build(&rest.deformed(positions)),
            (_, Format::Stl) => stl::build(&rest.deformed(positions))?,
        };
        Ok(Written {
            main: bytes,
            ..Written::default()
        })
    }

    /// About how many bytes it holds in memory.
    pub fn bytes_held(&self) -> u64 {
        let source = match &self.source {
            Source::Obj(source) => source.bytes_held(),
            Source::Gltf(_) | Source::Ply(_) | Source::Off(_) | Source::Stl(_) => 0,
        };
        self.files.total_bytes() + self.geometry.bytes_held() + source
    }

    fn as_uploaded(&self) -> Written {
        let companions = self
            .files
            .companions
            .iter()
            .map(|(uri, bytes)| (uri.clone(), bytes.to_vec()))
            .collect();
        Written {
            main: self.files.main.to_vec(),
            companions,
        }
    }
}

fn same_bits(a: &[DVec3], b: &[DVec3]) -> bool {
    a.iter().zip(b).all(|(p, q)| bits(*p) == bits(*q))
}

/// The bits of a position: equal when nothing changed, which `==` does not say for zeros.
pub(super) fn bits(p: DVec3) -> [u64; 3] {
    p.to_array().map(f64::to_bits)
}

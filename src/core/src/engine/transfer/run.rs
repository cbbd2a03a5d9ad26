//! A transfer from its first step to its last.

use super::command::{ShapeFacts, TransferCommand, TransferReport, Transferred};
use super::places::{SurfacePlace, places_on};
use crate::asset::{self, BlendShape, BlendShapes, Format, Model, Splats, WrittenFiles, WrittenWarning};
use crate::deform::{CarriedMotion, FaceSurroundings, SurfaceTransfer, unfold_vertices};
use crate::engine::Deformer;
use crate::engine::derived_structures::admit_bytes;
use crate::engine::error::Error;
use crate::engine::other_model::OtherModel;
use crate::engine::quality::measure_quality;
use crate::engine::wrap::{
    LandmarkSurfaces, OrientedPoint, WRAPPED_BYTES, WrapLandmark, WrapReport, WrapTask, turn_outwards, wrap,
};
use crate::exec::Exec;
use crate::mesh::shading::smooth_normals;
use crate::mesh::{Mesh, NONE, Weld};
use glam::{DVec3, Vec3};
use std::sync::OnceLock;

/// Bytes for each number that a shape has in the source and on the model, while it is carried and written.
const BYTES_PER_MOVE: u64 = 16;

impl Deformer {
    /// Brings blend shapes of another model, or what it does from one shape to another, to this model, which is at `positions` (one
    /// per render vertex). The model here does not change.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the field for another model that cannot be read, has no blend shapes, or a shape that does not fit it;
    /// [`Error::Precondition`] where it cannot be wrapped onto this one; [`Error::TooLarge`], [`Error::Cancelled`].
    pub fn transfer(
        &self,
        positions: &[DVec3],
        command: &TransferCommand,
        exec: &Exec<'_>,
    ) -> Result<Transferred, Error> {
        exec.progress.report("read", 0.0);
        let source = self.read_source(&command.source, "model", exec)?;
        if let Some(fit) = &command.fit {
            return self.fitted(positions, source, command, *fit, exec);
        }
        let moving = match &command.shape {
            Some(shape) => MovingSource::of_shape(&source, &self.read_source(shape, "shape", exec)?)?,
            None => MovingSource::of_shapes(&source)?,
        };
        let format = match &command.shape {
            // One file, without buffers beside it, unless those are asked for.
            Some(_) => command.format.unwrap_or_else(|| self.one_file_format()),
            None => Format::GLB,
        };
        let of_source = moving.shapes.len() * source.mesh.positions.len();
        let moves = (of_source + moving.shapes.len() * positions.len()) as u64;
        let points = (source.mesh.positions.len() + self.mesh().positions.len()) as u64;
        let bytes = BYTES_PER_MOVE * moves + WRAPPED_BYTES * points;
        admit_bytes(self.byte_size().saturating_add(bytes), &self.limits, exec)?;

        let mut own = self.mesh().clone();
        own.positions = self.mesh().welded(positions);
        let turned = command.landmarks.iter().map(|landmark| WrapLandmark {
            own: landmark.target,
            target: landmark.own,
        });
        let target = WrapSide {
            triangles: &self.geometry().triangles,
            mesh: &own,
        };
        let (wrapped, report) = self.wrapped(&source, target, &turned.collect::<Vec<_>>(), ["target", "own"], exec)?;
        let run = TransferRun {
            deformer: self,
            positions,
            own: &own,
            carrier: SourceCarrier {
                source: &source.mesh,
                wrapped: &wrapped,
                is_same: report.is_none(),
            },
            exec,
        };
        let told = TransferReport {
            wrap: report,
            ..TransferReport::default()
        };
        match &command.shape {
            Some(_) => run.in_other_shape(&moving.shapes[0], told, format),
            None => run.with_shapes(moving, told),
        }
    }

    /// The model's format, as one file.
    pub(super) fn one_file_format(&self) -> Format {
        match self.model().format {
            own if own == Format::GLTF => Format::GLB,
            own => own,
        }
    }

    pub(super) fn read_source(&self, other: &OtherModel, field: &str, exec: &Exec<'_>) -> Result<Source, Error> {
        let field = match other.from_session {
            true => "session".to_owned(),
            false => field.to_owned(),
        };
        let unfit = |e: Error| match e {
            Error::Asset(asset::Error::TooLarge { .. }) | Error::TooLarge { .. } | Error::Cancelled => e,
            other => Error::invalid(field.clone(), format!("cannot be taken: {other}")),
        };
        if Splats::format_of(&other.files, other.format).is_some() {
            return Err(Error::invalid(field, "is of Gaussian splats, which have no surface"));
        }
        let limits = self.limits.of_reading();
        let model = Model::read_watched(other.files.clone(), other.format, &limits, exec.progress);
        let model = model.map_err(|e| unfit(e.into()))?;
        let mesh = Mesh::build(&model.positions, &model.triangles, Weld::Rounding);
        let mesh = mesh.map_err(|e| unfit(Error::Precondition(e.to_string())))?;
        Ok(Source { model, mesh, field })
    }

    /// Where the source's vertices are on a target; `sides` are the names of places of landmarks on the one and the other.
    pub(super) fn wrapped(
        &self,
        source: &Source,
        target: WrapSide<'_>,
        landmarks: &[WrapLandmark],
        sides: [&'static str; 2],
        exec: &Exec<'_>,
    ) -> Result<(Vec<DVec3>, Option<WrapReport>), Error> {
        let own = target.mesh;
        if source.model.triangles == *target.triangles && source.mesh.solver_from_render == own.solver_from_render {
            return Ok((own.positions.clone(), None));
        }
        let mut template = source.mesh.clone();
        turn_outwards(&mut template);
        let sides = LandmarkSurfaces {
            surfaces: [&template, own],
            point_of: [&source.mesh.solver_from_render, &own.solver_from_render],
            field: "landmarks",
            sides,
        };
        let landmarks = sides.pairs(landmarks, exec)?;
        let task = WrapTask {
            template: &template,
            masked: &[],
            landmarks: &landmarks,
            body: &self.options.body,
            in_place: false,
        };
        let (wrapped, report) = wrap(&task, own.clone(), exec)?;
        Ok((wrapped, Some(report)))
    }

    /// Moves all render vertices by what points of the surface have moved, and what rides on the surface.
    pub(super) fn with_points_moved(
        &self,
        positions: &[DVec3],
        [before, now]: [&[DVec3]; 2],
        exec: &Exec<'_>,
    ) -> Result<Vec<DVec3>, Error> {
        let mut positions = positions.to_vec();
        for (place, &point) in positions.iter_mut().zip(&self.mesh().solver_from_render) {
            if point != NONE {
                *place += now[point as usize] - before[point as usize];
            }
        }
        self.derived.bind_riders(&self.room_limits(), exec)?;
        if let Some((surface, riders)) = self.derived.riding_vertices() {
            riders.place(surface, now, &mut positions, exec.pool);
        }
        Ok(positions)
    }
}

/// What a source is wrapped onto.
#[derive(Clone, Copy)]
pub(super) struct WrapSide<'a> {
    /// Triangles of its file.
    pub triangles: &'a [[u32; 3]],
    pub mesh: &'a Mesh,
}

/// Files with what is to be said of how the source lies on the model, and of shapes that move nothing of it.
pub(super) fn with_warnings(mut files: WrittenFiles, told: &TransferReport) -> WrittenFiles {
    let still = told.shapes.iter().filter(|shape| shape.moved_vertices == 0);
    let still: Vec<&str> = still.map(|shape| shape.name.as_str()).collect();
    if !still.is_empty() {
        let named: Vec<String> = still.iter().take(8).map(|name| format!("\"{name}\"")).collect();
        let message = match (&still[..], told.shapes.len()) {
            ([""], 1) => "the other shape moves nothing of the model".to_owned(),
            (still, all) => format!(
                "{} of {all} shapes move nothing of the model: {}",
                still.len(),
                named.join(", ")
            ),
        };
        files.warnings.push(WrittenWarning {
            code: "shapes-move-nothing",
            message,
            place: String::new(),
        });
    }
    let of_wrap = told.wrap.iter().flat_map(WrapReport::warnings);
    files.warnings.extend(of_wrap.map(|warning| WrittenWarning {
        code: warning.code,
        message: warning.message,
        place: String::new(),
    }));
    files
}

/// A source that is on the model.
struct TransferRun<'a> {
    deformer: &'a Deformer,
    /// Where the render vertices of the model are.
    positions: &'a [DVec3],
    /// Its mesh there.
    own: &'a Mesh,
    carrier: SourceCarrier<'a>,
    exec: &'a Exec<'a>,
}

impl TransferRun<'_> {
    /// The model in another shape.
    fn in_other_shape(
        &self,
        shape: &SourceShape,
        mut told: TransferReport,
        format: Format,
    ) -> Result<Transferred, Error> {
        let Self {
            deformer,
            own,
            carrier,
            exec,
            ..
        } = self;
        let places = carrier.places(own, exec)?;
        let mut surfaces = SurfaceTransfer::between(carrier.source, carrier.wrapped, CarriedMotion::Pose, exec)?;
        let moves = surfaces.carry(&shape.moves, exec)?;
        let moved = ModelInShape::of(own, &OnceLock::new(), &moves, &places, exec);
        told.shapes = vec![carrier.facts(shape, own, &moved, exec)];
        let positions = deformer.with_points_moved(self.positions, [&own.positions, &moved.now], exec)?;
        Ok(Transferred {
            files: with_warnings(deformer.write(&positions, format, exec)?, &told),
            format,
            report: told,
        })
    }

    /// The model with blend shapes.
    fn with_shapes(&self, moving: MovingSource, mut told: TransferReport) -> Result<Transferred, Error> {
        let Self { carrier, exec, .. } = self;
        let written = self.deformer.write(self.positions, Format::GLB, exec)?;
        let files = written.into_files("model.glb");
        let limits = self.deformer.model().limits_of_written();
        let model = Model::read_watched(files, Some(Format::GLB), &limits, exec.progress)?;
        let mesh = Mesh::build(&model.positions, &model.triangles, Weld::Exact)
            .map_err(|e| Error::Precondition(format!("the model as a GLB: {e}")))?;
        let is_same = carrier.is_same && mesh.solver_from_render == self.own.solver_from_render;
        let places = SourceCarrier { is_same, ..*carrier }.places(&mesh, exec)?;
        let mut surfaces = SurfaceTransfer::between(carrier.source, carrier.wrapped, CarriedMotion::Shapes, exec)?;
        let MovingSource { shapes, blend } = moving;
        let surroundings = OnceLock::new();
        let count = shapes.len().max(1);
        let mut carried = Vec::with_capacity(count);
        for (k, shape) in shapes.iter().enumerate() {
            exec.check()?;
            exec.progress.report("shapes", k as f32 / count as f32);
            let moves = surfaces.carry(&shape.moves, exec)?;
            let moved = ModelInShape::of(&mesh, &surroundings, &moves, &places, exec);
            told.shapes.push(carrier.facts(shape, &mesh, &moved, exec));
            let of = |point: &u32| match *point {
                NONE => Vec3::ZERO,
                point => (moved.now[point as usize] - mesh.positions[point as usize]).as_vec3(),
            };
            carried.push(BlendShape {
                name: shape.name.clone(),
                weight: shape.weight,
                moves: mesh.solver_from_render.iter().map(of).collect(),
            });
        }
        told.clips = blend.clips.len() as u32;
        let shapes = BlendShapes {
            shapes: carried,
            ..blend
        };
        exec.progress.report("write", 0.0);
        Ok(Transferred {
            files: with_warnings(model.write_blend_shapes(&shapes)?, &told),
            format: Format::GLB,
            report: told,
        })
    }
}

/// The other model.
pub(super) struct Source {
    pub model: Model,
    pub mesh: Mesh,
    /// The field that names it.
    field: String,
}

/// A shape of the source, by its welded vertices.
struct SourceShape {
    name: String,
    moves: Vec<DVec3>,
    weight: f32,
}

/// What the source does.
struct MovingSource {
    shapes: Vec<SourceShape>,
    /// What else its file says of its blend shapes; without these.
    blend: BlendShapes,
}

impl MovingSource {
    /// From its own shape to another one.
    fn of_shape(source: &Source, shape: &Source) -> Result<Self, Error> {
        let (own, other) = (&source.model, &shape.model);
        if own.positions.len() != other.positions.len() || own.triangles != other.triangles {
            let problem = format!(
                "has {} vertices and {} triangles, the source has {} and {}; the same ones in the same order are needed",
                other.positions.len(),
                other.triangles.len(),
                own.positions.len(),
                own.triangles.len()
            );
            return Err(Error::invalid("shape", problem));
        }
        let moves = own.positions.iter().zip(&other.positions).map(|(a, b)| *b - *a);
        let moves: Vec<DVec3> = moves.collect();
        Ok(Self {
            shapes: vec![SourceShape {
                name: String::new(),
                moves: source.mesh.welded(&moves),
                weight: 0.0,
            }],
            blend: BlendShapes::default(),
        })
    }

    /// Its blend shapes.
    fn of_shapes(source: &Source) -> Result<Self, Error> {
        let mut blend = source.model.blend_shapes()?;
        if blend.shapes.is_empty() {
            let problem = "has no blend shapes; give a model that has some, or another shape of it as `shape`";
            return Err(Error::invalid(source.field.clone(), problem));
        }
        let welded = |shape: BlendShape| {
            let moves: Vec<DVec3> = shape.moves.iter().map(|m| m.as_dvec3()).collect();
            SourceShape {
                name: shape.name,
                moves: source.mesh.welded(&moves),
                weight: shape.weight,
            }
        };
        Ok(Self {
            shapes: std::mem::take(&mut blend.shapes).into_iter().map(welded).collect(),
            blend,
        })
    }
}

/// The source on the model.
#[derive(Clone, Copy)]
struct SourceCarrier<'a> {
    source: &'a Mesh,
    /// Where its vertices are on the model.
    wrapped: &'a [DVec3],
    /// Whether its vertices are those of the model.
    is_same: bool,
}

impl SourceCarrier<'_> {
    /// Where the vertices of a mesh are on the wrapped source.
    fn places(&self, mesh: &Mesh, exec: &Exec<'_>) -> Result<Vec<SurfacePlace>, Error> {
        if self.is_same {
            return Ok((0..mesh.positions.len() as u32)
                .map(|v| [(v, 1.0), (v, 0.0), (v, 0.0)])
                .collect());
        }
        let normals = smooth_normals(&mesh.positions, &mesh.triangles);
        let points = mesh
            .positions
            .iter()
            .zip(&normals)
            .map(|(point, normal)| OrientedPoint {
                point: *point,
                normal: normal.as_dvec3().normalize_or_zero(),
            });
        places_on(self.wrapped, &self.source.triangles, &points.collect::<Vec<_>>(), exec)
    }

    fn facts(&self, shape: &SourceShape, mesh: &Mesh, moved: &ModelInShape, exec: &Exec<'_>) -> ShapeFacts {
        let source = self.source.positions.iter().zip(&shape.moves).map(|(p, m)| *p + *m);
        let source: Vec<DVec3> = source.collect();
        let moves = || mesh.positions.iter().zip(&moved.now).map(|(p, now)| *now - *p);
        let largest = moves().map(|m| m.length()).fold(0.0, f64::max);
        ShapeFacts {
            name: shape.name.clone(),
            moved_vertices: moves().filter(|m| *m != DVec3::ZERO).count() as u32,
            largest_move: largest / mesh.bounds().diagonal().max(f64::MIN_POSITIVE),
            flipped_triangles: moved.flipped,
            flipped_in_source: measure_quality(self.source, false, &source, exec.pool).flipped_triangles,
        }
    }
}

/// The model's surface in a shape.
struct ModelInShape {
    now: Vec<DVec3>,
    /// Triangles that are turned over.
    flipped: u32,
}

impl ModelInShape {
    /// Moves a surface by what the wrapped source does at places. Faces that this turns over, because they lie across a crease of the
    /// source, are brought back; what does not move stays.
    fn of(
        mesh: &Mesh,
        surroundings: &OnceLock<FaceSurroundings>,
        moves: &[DVec3],
        places: &[SurfacePlace],
        exec: &Exec<'_>,
    ) -> Self {
        let moves: Vec<DVec3> = (places.iter())
            .map(|place| place.iter().map(|(v, w)| moves[*v as usize] * *w).sum())
            .collect();
        let held: Vec<bool> = moves.iter().map(|m| *m == DVec3::ZERO).collect();
        let mut now: Vec<DVec3> = mesh.positions.iter().zip(&moves).map(|(p, m)| *p + *m).collect();
        let changes = unfold_vertices(mesh, surroundings, &held, &mut now, exec.pool);
        Self {
            now,
            flipped: changes.turned_over() as u32,
        }
    }
}

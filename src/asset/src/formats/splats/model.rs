//! Gaussian splats as a model of their own: a closed surface around them is posed, and they ride along.
//!
//! The first primitive has the centres of the splats as vertices, in the order of the file, the second one is the surface.

use super::cage::Cage;
use super::cloud::Splats;
use super::motion::{SplatMotion, SplatPlaces};
use crate::codec::{EditedOutput, FormatCodec, PatchedOutput, ReadFile};
use crate::edited::{EditedModel, PrimitiveRun};
use crate::files::{ReadWatch, counted};
use crate::model::FileNotes;
use crate::neutral::NeutralModel;
use crate::{
    BoundSplats, Error, FileSet, Format, Geometry, LargeSplatRule, Model, Primitive, ShapeFollowers, WrittenFiles,
    WrittenWarning,
};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Silent;
use pliant_mesh::NONE;
use pliant_mesh::carry::SurfaceCarrier;
use std::sync::Arc;

/// The names of the primitives.
const SPLATS: &str = "splats";
const CAGE: &str = "cage";

/// Reads and writes models of splats.
pub(in super::super) struct SplatModelCodec;

/// The splats of a model.
#[derive(Debug)]
pub(in super::super) struct SplatNotes {
    splats: Splats,
}

impl FileNotes for SplatNotes {
    fn bytes_held(&self) -> u64 {
        self.splats.bytes_held()
    }
}

impl FormatCodec for SplatModelCodec {
    fn patches_files_of(&self, source: Format) -> bool {
        source.holds_splats()
    }

    fn read(&self, files: &FileSet, format: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error> {
        let splats = Splats::read_within(files.main.clone(), format, watch)?;
        let cage = Cage::around(&splats, watch.cage_triangles, watch)?;
        let first = splats.len() as u32;
        let mut positions = splats.centers().to_vec();
        positions.extend(cage.positions);
        watch.check_vertices(positions.len() as u64)?;
        let own = |name: &str, place: u32| Primitive {
            name: name.to_owned(),
            primitive: place,
            mesh: place,
            ..Primitive::default()
        };
        let geometry = Geometry {
            primitives: vec![
                Primitive {
                    vertex_count: first,
                    is_passenger: true,
                    ..own(SPLATS, 0)
                },
                Primitive {
                    first_vertex: first,
                    vertex_count: positions.len() as u32 - first,
                    index_count: 3 * cage.triangles.len() as u32,
                    ..own(CAGE, 1)
                },
            ],
            triangles: cage.triangles.iter().map(|t| t.map(|v| v + first)).collect(),
            positions,
            ..Geometry::default()
        };
        Ok((geometry, Arc::new(SplatNotes { splats })))
    }

    fn patch_positions(&self, output: &PatchedOutput<'_>) -> Result<WrittenFiles, Error> {
        let notes = splats_of(output.model, output.format)?;
        let geometry = &output.model.geometry;
        let first = notes.splats.len();
        let (places, now) = output.positions.split_at(first);
        let triangles: Vec<[u32; 3]> = (geometry.triangles.iter())
            .map(|t| t.map(|v| v - first as u32))
            .collect();
        let surface = MovedSurface {
            triangles: &triangles,
            rest: &geometry.positions[first..],
            now,
            bound: output.followers.splats,
            guesses: None,
        };
        surface.write(notes.splats.clone(), places, output.format, output.followers)
    }

    fn build(&self, _: &NeutralModel, format: Format) -> Result<WrittenFiles, Error> {
        Err(no_splats(format))
    }

    /// The splats that are left, in their order. What other models bring is left out.
    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        let (edited, format) = (output.edited, output.format);
        let Some(base) = edited.bases.first() else {
            return Err(no_splats(format));
        };
        let notes = splats_of(base.model, format)?;
        let own = edited.runs.iter().filter(|run| run.base == 0);
        let (cages, splats): (Vec<&PrimitiveRun>, Vec<&PrimitiveRun>) =
            own.partition(|run| run.triangle_count > 0 || run.primitive > 0);
        let vertices = || splats.iter().flat_map(|run| run.vertices());
        let rows: Vec<u32> = vertices().map(|v| edited.blend(v).heaviest()).collect();
        let places: Vec<DVec3> = vertices().map(|v| output.positions[v]).collect();
        if rows.iter().any(|row| *row as usize >= notes.splats.len()) {
            return Err(Error::unwritable(format, "a vertex is of a splat that is not there"));
        }
        let (mut rest, mut now, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
        let mut guesses = output.followers.rest.is_none().then(RestGuesses::default);
        for run in cages {
            let shift = now.len() as u32;
            let known = output.followers.rest.and_then(|rest| rest.get(run.vertices()));
            match known {
                Some(known) => rest.extend_from_slice(known),
                None => rest.extend(run.vertices().map(|v| rest_place(edited, v))),
            }
            now.extend(run.vertices().map(|v| output.positions[v]));
            let moved = |v: u32| v - run.first_vertex + shift;
            triangles.extend(edited.triangles[run.triangles()].iter().map(|t| t.map(moved)));
            if let Some(guesses) = &mut guesses {
                guesses.add_run(edited, run, shift);
            }
        }
        let surface = MovedSurface {
            triangles: &triangles,
            rest: &rest,
            now: &now,
            bound: None,
            guesses: guesses.as_ref(),
        };
        let mut written = surface.write(notes.splats.kept(&rows), &places, format, output.followers)?;
        let merged = edited.bases.len() - 1;
        let left = counted(merged, "merged model", "merged models");
        written
            .warnings
            .extend(WrittenWarning::left_out(&Vec::from_iter(left), format, ""));
        Ok(written)
    }

    fn beyond_conversion(&self, model: &Model, _: bool) -> Result<Vec<String>, Error> {
        let count = model.notes::<SplatNotes>().map_or(0, |notes| notes.splats.len());
        let named = counted(count, "Gaussian splat", "Gaussian splats");
        Ok(named
            .map(|named| format!("{named} (the file is of the surface around them)"))
            .into_iter()
            .collect())
    }
}

impl Model {
    /// Whether it is of Gaussian splats, with a surface around them that stands in no file.
    pub fn holds_splats(&self) -> bool {
        self.notes::<SplatNotes>().is_some()
    }
}

fn splats_of(model: &Model, format: Format) -> Result<&SplatNotes, Error> {
    model.notes().ok_or_else(|| no_splats(format))
}

fn no_splats(format: Format) -> Error {
    let problem = "the model holds no Gaussian splats of its own, as a file of splats does (those in a glTF stay in it); choose another format";
    Error::unwritable(format, problem)
}

/// Where a vertex of an edited model was in the file of the first base.
fn rest_place(edited: &EditedModel<'_>, vertex: usize) -> DVec3 {
    let rest = edited
        .bases
        .first()
        .map_or(&[][..], |base| &base.model.geometry.positions);
    let part = |(v, weight): (u32, f64)| rest.get(v as usize).copied().unwrap_or_default() * weight;
    edited.blend(vertex).iter().map(part).sum()
}

/// What of an edited surface stands in the file, and what edits have made of it.
#[derive(Default)]
struct RestGuesses {
    /// Triangles of the file.
    kept: Vec<[u32; 3]>,
    /// New vertices, on none of them, of which the blend does not say where they were: those in the middle of a cap are made of so many
    /// that the least of them are left out.
    guessed: Vec<u32>,
}

impl RestGuesses {
    fn add_run(&mut self, edited: &EditedModel<'_>, run: &PrimitiveRun, shift: u32) {
        let mut is_kept = vec![false; run.vertex_count as usize];
        for t in run.triangles() {
            if edited.origins.get(t).is_some_and(|origin| *origin != NONE) {
                let own = edited.triangles[t].map(|v| v - run.first_vertex);
                own.iter().for_each(|v| is_kept[*v as usize] = true);
                self.kept.push(own.map(|v| v + shift));
            }
        }
        // A vertex that divides an edge is made of its ends.
        let is_guess = |v: &u32| {
            let parts = edited.blend((run.first_vertex + v) as usize).iter().count();
            !is_kept[*v as usize] && parts > 2
        };
        let guessed = (0..run.vertex_count).filter(is_guess);
        self.guessed.extend(guessed.map(|v| v + shift));
    }

    /// Where the vertices of a surface were: guesses go back along with the triangles that are known.
    fn mend(&self, rest: &[DVec3], now: &[DVec3], exec: &Exec<'_>) -> Result<Option<Vec<DVec3>>, Error> {
        if self.kept.is_empty() || self.guessed.is_empty() {
            return Ok(None);
        }
        let back = SurfaceCarrier::new(&self.kept, now, rest, exec.pool);
        let places: Vec<DVec3> = self.guessed.iter().map(|v| now[*v as usize]).collect();
        let carried = back.carry_points(&places, exec).map_err(|_| Error::Cancelled)?;
        let mut mended = rest.to_vec();
        for (v, frame) in self.guessed.iter().zip(carried) {
            mended[*v as usize] = frame.position;
        }
        Ok(Some(mended))
    }
}

/// The surface around splats, as it was and as it is.
struct MovedSurface<'a> {
    triangles: &'a [[u32; 3]],
    rest: &'a [DVec3],
    now: &'a [DVec3],
    /// What the splats follow, where that is known.
    bound: Option<BoundSplats<'a>>,
    /// What of `rest` is not known for sure.
    guesses: Option<&'a RestGuesses>,
}

impl MovedSurface<'_> {
    /// Writes splats that have gone along; `places` are where their centres are.
    fn write(
        &self,
        mut splats: Splats,
        places: &[DVec3],
        format: Format,
        followers: &ShapeFollowers<'_>,
    ) -> Result<WrittenFiles, Error> {
        let own;
        let exec = match &followers.exec {
            Some(exec) => exec,
            None => {
                own = Pool::new(1).map_err(|e| Error::unwritable(format, e.to_string()))?;
                &Exec::new(&own, &Silent)
            }
        };
        let bound = self.bound.filter(|bound| bound.points.len() == splats.len());
        let found;
        let carrier = match bound {
            Some(bound) => bound.carrier,
            None => {
                let mended = self.guesses.map(|guesses| guesses.mend(self.rest, self.now, exec));
                let mended = mended.transpose()?.flatten();
                let rest = mended.as_deref().unwrap_or(self.rest);
                found = SurfaceCarrier::new(self.triangles, rest, self.now, exec.pool);
                &found
            }
        };
        let motion = SplatMotion {
            places: SplatPlaces::Given(places),
            bound: bound.map(|bound| bound.points),
            divides: followers.rules.large_splats == LargeSplatRule::Divide,
        };
        let moved = splats.move_along(carrier, &motion, exec);
        moved.map_err(|_| Error::Cancelled)?;
        splats.write(format)
    }
}

//! An outfit of a body on another body.

use super::command::{FitFacts, OutfitFit, TransferCommand, TransferReport, Transferred};
use super::run::{Source, WrapSide, with_warnings};
use crate::asset::WrittenWarning;
use crate::deform::OutfitOnBody;
use crate::engine::Deformer;
use crate::engine::derived_structures::admit_bytes;
use crate::engine::error::Error;
use crate::engine::wrap::{WRAPPED_BYTES, edge_distortion, turn_outwards};
use crate::exec::Exec;
use crate::mesh::carry::SurfaceCarrier;
use glam::DVec3;

impl Deformer {
    /// This model, which at `positions` fits the body that `source` is, on the body that the command's shape is.
    pub(super) fn fitted(
        &self,
        positions: &[DVec3],
        mut source: Source,
        command: &TransferCommand,
        fit: OutfitFit,
        exec: &Exec<'_>,
    ) -> Result<Transferred, Error> {
        let Some(shape) = &command.shape else {
            return Err(Error::invalid(
                "shape",
                "is missing: the body that the outfit is to fit",
            ));
        };
        let mut other = self.read_source(shape, "shape", exec)?;
        let points = source.mesh.positions.len() + other.mesh.positions.len() + self.mesh().positions.len();
        let bytes = WRAPPED_BYTES.saturating_mul(points as u64);
        admit_bytes(self.byte_size().saturating_add(bytes), &self.limits, exec)?;
        let side = WrapSide {
            triangles: &other.model.triangles,
            mesh: &other.mesh,
        };
        let (wrapped, report) = self.wrapped(&source, side, &command.landmarks, ["own", "target"], exec)?;
        exec.progress.report("carry", 0.0);
        let body = &source.mesh;
        let carrier = SurfaceCarrier::new(&body.triangles, &body.positions, &wrapped, exec.pool);
        let mut outfit = self.mesh().clone();
        outfit.positions = self.mesh().welded(positions);
        let carried = carrier.carry_points(&outfit.positions, exec)?;
        let carried: Vec<DVec3> = carried.into_iter().map(|frame| frame.position).collect();
        exec.progress.report("fit", 0.0);
        turn_outwards(&mut source.mesh);
        turn_outwards(&mut other.mesh);
        let on_body = OutfitOnBody {
            body: &source.mesh,
            outfit: &outfit,
            other: &other.mesh,
            clearance: fit.clearance,
        };
        let fitted = on_body.fit(&carried, exec)?;
        if let Some(point) = fitted.positions.iter().position(|p| !p.as_vec3().is_finite()) {
            return Err(Error::Precondition(format!(
                "point {point} leaves the range of numbers"
            )));
        }
        let facts = FitFacts {
            vertices: carried.len() as u32,
            inside_at_rest: fitted.inside_at_rest,
            inside_carried: fitted.carried.inside,
            inside: fitted.fitted.inside,
            crossings_carried: fitted.carried.crossings,
            crossings: fitted.fitted.crossings,
            edge_distortion: edge_distortion(&outfit, &fitted.positions),
        };
        let told = TransferReport {
            wrap: report,
            fit: Some(facts),
            ..TransferReport::default()
        };
        let now = self.with_points_moved(positions, [&outfit.positions, &fitted.positions], exec)?;
        let format = command.format.unwrap_or_else(|| self.one_file_format());
        let mut files = with_warnings(self.write(&now, format, exec)?, &told);
        files.warnings.extend(facts.left());
        Ok(Transferred {
            files,
            format,
            report: told,
        })
    }
}

impl FitFacts {
    /// What is to be said of an outfit that is not outside.
    fn left(&self) -> Option<WrittenWarning> {
        let message = format!(
            "{} vertices are inside of the body and were outside of the other one; {} pairs of triangles cross",
            self.inside, self.crossings
        );
        (self.inside > 0 || self.crossings > 0).then(|| WrittenWarning {
            code: "fit-left",
            message,
            place: String::new(),
        })
    }
}

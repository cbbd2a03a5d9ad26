//! A model whose triangles cross in the shape that it has, freed of that.

use super::Deformer;
use super::adopt::ShapeToEdit;
use super::derived_structures::admit_bytes;
use super::edit_command::{UnintersectCommand, UnintersectReport};
use super::error::Error;
use super::facts::DeformerWarning;
use super::region_context::vertices_in_region;
use super::settings::HeldBeside;
use super::shape::ModelShape;
use super::wrap::turn_outwards;
use crate::deform::{CrossingSurface, MOST_PARTED, UncrossedSurface};
use crate::edit::check_faces_at_points;
use crate::exec::Exec;
use crate::mesh::{Mesh, NONE, grouped_count};
use glam::DVec3;
use std::sync::Arc;

/// Bytes that parting takes for each vertex.
const PARTED_BYTES: u64 = 1024;
/// How many of the pairs that are left a warning names.
const MOST_NAMED: usize = 8;

impl Deformer {
    /// A shape of which as few triangles cross as is possible; what rides along follows.
    pub(super) fn unintersected_shape(
        &self,
        command: &UnintersectCommand,
        shape: ModelShape,
        exec: &Exec<'_>,
    ) -> Result<ShapeToEdit, Error> {
        exec.progress.report("contact", 0.0);
        // The deformer stays until the edit is whole.
        let beside = HeldBeside::of(self.byte_size(), exec.progress);
        let exec = &Exec::new(exec.pool, &beside);
        let surface = self.edit_surface(&shape.positions, &self.topology().origins(&self.derived.mesh), exec)?;
        check_faces_at_points(&surface.surface())?;
        let points = surface.points as usize;
        admit_bytes(PARTED_BYTES * points as u64, &self.room_limits(), exec)?;
        let own = surface.own_surface();
        let unfit = |e: crate::mesh::Error| Error::Precondition(format!("the model has no surface: {e}"));
        let mut mesh = Mesh::of_points(own.positions, own.triangles, own.point_of.to_vec(), points).map_err(unfit)?;
        turn_outwards(&mut mesh);
        let mut fixed = vec![false; points];
        if let Some(region) = &command.fixed {
            let regions = self.region_context(&shape, exec);
            let held = vertices_in_region(&regions, region, None).map_err(|e| e.below("unintersect.fixed"))?;
            let of_vertices = own.point_of.iter().zip(held).filter(|(p, held)| **p != NONE && *held);
            of_vertices.for_each(|(point, _)| fixed[*point as usize] = true);
        }
        let crossing = CrossingSurface {
            mesh: &mesh,
            fixed: &fixed,
            clearance: command.clearance,
        };
        let parted = crossing.part(exec)?;
        let report = UnintersectReport::of(&mesh, &parted);
        let mut warnings = Vec::new();
        let shape = if report.moved_vertices == 0 {
            shape
        } else {
            let mut positions = shape.positions.as_ref().clone();
            for (position, &point) in positions.iter_mut().zip(own.point_of).filter(|(_, p)| **p != NONE) {
                // What has not moved keeps its bits.
                let (was, now) = (mesh.positions[point as usize], parted.positions[point as usize]);
                if was != now {
                    *position = now;
                }
            }
            self.place_riders(&mut positions, exec)?;
            ModelShape::from_positions(Arc::new(positions))
        };
        if report.crossings_before == 0 {
            let message = "triangles of the model cross nowhere";
            warnings.push(DeformerWarning::new("unintersect-nothing", message, ""));
        }
        warnings.extend(self.crossings_left(&shape.positions, &parted, exec)?);
        Ok(ShapeToEdit {
            shape,
            wrap: None,
            unintersect: Some(report),
            warnings,
        })
    }

    /// What is to be said of pairs that still cross.
    fn crossings_left(
        &self,
        positions: &[DVec3],
        parted: &UncrossedSurface,
        exec: &Exec<'_>,
    ) -> Result<Option<DeformerWarning>, Error> {
        if parted.crossings == 0 {
            return Ok(None);
        }
        let (left, before) = (grouped_count(parted.crossings), grouped_count(parted.crossings_before));
        let end = match parted.is_given_up {
            true => "; the work ended after three places in a row that could not be parted",
            false => "",
        };
        let message = match parted.crossings_before > MOST_PARTED as u64 {
            true => format!(
                "{before} pairs of triangles cross; up to {} are parted",
                grouped_count(MOST_PARTED as u64)
            ),
            false => format!("{left} of {before} pairs of triangles still cross{end}"),
        };
        let found = self.crossing_pairs(positions, MOST_NAMED, exec)?;
        let named: Vec<String> = (found.pairs.iter())
            .map(|pair| format!("{} and {}", pair.triangles[0], pair.triangles[1]))
            .collect();
        let place = format!("triangles {}", named.join(", "));
        Ok(Some(DeformerWarning::new("contact-left", message, place)))
    }
}

impl UnintersectReport {
    fn of(mesh: &Mesh, parted: &UncrossedSurface) -> Self {
        let ways = mesh.positions.iter().zip(&parted.positions);
        let ways: Vec<f64> = ways
            .map(|(was, now)| was.distance(*now))
            .filter(|way| *way > 0.0)
            .collect();
        let largest = ways.iter().copied().fold(0.0, f64::max);
        let squares = ways.iter().map(|way| way * way).fold(0.0, |sum, square| sum + square);
        let rms = (squares / f64::max(ways.len() as f64, 1.0)).sqrt();
        let share = |way: f64, of: f64| way / of.max(f64::MIN_POSITIVE);
        let (diagonal, edge) = (mesh.bounds().diagonal(), mesh.median_edge());
        Self {
            crossings_before: parted.crossings_before,
            crossings: parted.crossings,
            moved_vertices: ways.len() as u32,
            largest_move: share(largest, diagonal),
            rms_move: share(rms, diagonal),
            largest_move_in_edges: share(largest, edge),
            rms_move_in_edges: share(rms, edge),
        }
    }
}

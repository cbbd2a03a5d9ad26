//! A model that is open towards the eye, with the nodes that a rig holds in it.

use crate::cli::input_files::{in_file, open_model, read_file};
use crate::cli::terminal::CliFailure;
use crate::engine::{Deformer, DeformerLimits, OpenOptions, RigNodes, left_out_passengers};
use crate::exec::Exec;
use crate::mesh::BoundingBox;
use crate::pool::Pool;
use crate::progress::Silent;
use crate::render::{
    Camera, DrawnBall, POSITION_COLOUR, Picture, PictureSize, ROTATION_COLOUR, ShadedSurface, ViewDirection,
    draw_surface, open_surface,
};
use crate::wire;
use glam::DVec3;
use std::path::Path;

/// Radii of nodes, in diagonals of the model.
const ROTATION_BALL: f64 = 0.006;
const POSITION_BALL: f64 = 0.008;
/// Pictures smaller than this have no words.
const WORDS: u32 = 160;

/// Draws a model and the nodes that a rig holds in it; the text counts them.
pub(super) fn draw_cutaway(
    model: &Path,
    rig: &Path,
    view: ViewDirection,
    size: PictureSize,
    pool: &Pool,
) -> Result<(Picture, String), CliFailure> {
    let bones = wire::rig_from_json(&read_file(rig)?).map_err(|e| in_file(rig, e))?;
    let limits = DeformerLimits::default();
    let read = open_model(model)?;
    // As in an animation of the model's own clip, what no skin places has no part in it.
    let options = OpenOptions {
        passengers: left_out_passengers(&read).map_err(|e| in_file(model, e))?,
        ..Default::default()
    };
    let exec = Exec::new(pool, &Silent);
    let deformer = Deformer::of_model(read, &options, &limits, &exec).map_err(|e| in_file(model, e))?;
    let held = deformer.nodes_of_rig(&bones, &exec);
    let RigNodes { rotations, positions } = held.map_err(|e| in_file(rig, e))?;

    let rest = deformer.rest();
    let geometry = deformer.geometry();
    let is_passenger = |vertex: u32| {
        let own = geometry
            .primitives
            .iter()
            .find(|p| p.vertices().contains(&(vertex as usize)));
        own.is_some_and(|p| p.is_passenger)
    };
    let solved = geometry.triangles.iter().filter(|t| !is_passenger(t[0]));
    let triangles: Vec<[u32; 3]> = solved.copied().collect();
    let diagonal = BoundingBox::of(rest).diagonal();
    let drawn = |places: &[DVec3], share: f64, colour| -> Vec<DrawnBall> {
        let ball = |center: &DVec3| DrawnBall {
            center: *center,
            radius: share * diagonal,
            colour,
        };
        places.iter().map(ball).collect()
    };
    let balls = [
        drawn(&rotations, ROTATION_BALL, ROTATION_COLOUR),
        drawn(&positions, POSITION_BALL, POSITION_COLOUR),
    ]
    .concat();
    let closed = ShadedSurface::new(rest, &triangles, pool)?;
    let camera = &Camera::around_surfaces(&[&closed], &[view], size)[0];
    let open = open_surface(rest, &triangles, camera.towards_eye(), &balls, pool)?;
    let mut picture = draw_surface(&open, camera, pool);
    if size.width().min(size.height()) >= WORDS {
        let dot = (size.width().min(size.height()) / 160).clamp(1, 4);
        let below = Picture::text_size(dot, "x").1 + 3 * dot;
        picture.write_text(4 * dot, 4 * dot, dot, "rotations", ROTATION_COLOUR);
        picture.write_text(4 * dot, 4 * dot + below, dot, "positions", POSITION_COLOUR);
    }
    let reported = format!(
        "rotations of {} nodes and positions of {}",
        rotations.len(),
        positions.len()
    );
    Ok((picture, reported))
}

//! Cuts the model between two poses: `cargo run --example edit_between_poses`.

use pliant::asset::{FileSet, sample};
use pliant::edit::KeptSide;
use pliant::engine::{
    CutLine, Deformer, DeformerLimits, Edit, EditReport, Handle, HandlePose, ModelShape, OpenOptions, Plane, Region,
    SolveSettings,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use std::error::Error;

/// Cuts the legs off and closes the cut, then turns the head of what is left.
pub fn cut_and_turn() -> Result<(EditReport, ModelShape), Box<dyn Error>> {
    let pool = Pool::new(0)?;
    let exec = Exec::new(&pool, &Silent);
    let files = FileSet::single("creature.glb", sample::creature_glb());
    let mut deformer = Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec)?;
    deformer.set_handles(
        [
            Handle::new("tail", Region::sphere([-1.0, 1.06, 0.0], 0.16)),
            Handle::new("head", Region::sphere([0.76, 1.22, 0.0], 0.36)),
        ],
        &exec,
    )?;
    let cut = Edit::Cut {
        along: CutLine::Plane(Plane::new([0.0, 1.0, 0.0], 0.4)),
        keep: KeptSide::Above,
        fill: true,
        cap: None,
    };
    let outcome = deformer.edit_rest(&cut, &exec)?;
    // The handles are still there, in the new numbers of their vertices.
    let turned = HandlePose::rotation([0.0, 0.8, 0.0]);
    let shape = deformer.commit([("head", turned)], &SolveSettings::default(), &exec)?;
    Ok((outcome.report, shape))
}

#[allow(dead_code)]
fn main() -> Result<(), Box<dyn Error>> {
    let (report, shape) = cut_and_turn()?;
    println!(
        "{} triangles, {} after the cut",
        report.before.faces, report.after.faces
    );
    println!(
        "{} vertices solved in {} cycles",
        shape.positions.len(),
        shape.stats.cycles
    );
    Ok(())
}

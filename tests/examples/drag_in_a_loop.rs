//! Drags a handle in a loop, as a viewer does: `cargo run --example drag_in_a_loop`.

use pliant::asset::{FileSet, sample};
use pliant::engine::{Deformer, DeformerLimits, Handle, HandlePose, OpenOptions, Region, SolveSettings};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use std::error::Error;

/// Drags the head of the creature upwards in small steps. Every pose starts from the shape before it, so that it takes a
/// cycle or two. Returns the cycles of each.
pub fn drag_head(steps: u32) -> Result<Vec<u32>, Box<dyn Error>> {
    let pool = Pool::new(0)?;
    let exec = Exec::new(&pool, &Silent);
    let files = FileSet::single("creature.glb", sample::creature_glb());
    let mut deformer = Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec)?;
    deformer.set_handles(
        [
            Handle::new("feet", Region::half_space([0.0, -1.0, 0.0], -0.14)),
            Handle::new("head", Region::sphere([0.76, 1.22, 0.0], 0.36)),
        ],
        &exec,
    )?;
    let mut drag = deformer.drag(&SolveSettings::default());
    let mut cycles = Vec::new();
    for step in 1..=steps {
        let pose = HandlePose::translation([0.0, 0.01 * f64::from(step), 0.0]);
        let shape = drag.solve([("head", pose)], &exec)?;
        // A viewer would draw `shape.positions` here.
        cycles.push(shape.stats.cycles);
    }
    Ok(cycles)
}

#[allow(dead_code)]
fn main() -> Result<(), Box<dyn Error>> {
    println!("cycles of each pose: {:?}", drag_head(20)?);
    Ok(())
}

//! Holds vertices by a rule of the program's own: `cargo run --example custom_region`.

use pliant::asset::{FileSet, sample};
use pliant::engine::{Deformer, DeformerLimits, Handle, HandlePose, OpenOptions, Region, SolveSettings};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use std::error::Error;

/// Lifts every vertex of the creature that is farther from its middle than the rule says, and returns how many that are and
/// how far the first of them went.
pub fn lift_what_sticks_out() -> Result<(usize, f64), Box<dyn Error>> {
    let pool = Pool::new(0)?;
    let exec = Exec::new(&pool, &Silent);
    let files = FileSet::single("creature.glb", sample::creature_glb());
    let mut deformer = Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec)?;
    let rest = deformer.rest().clone();
    // Any rule will do; what it chooses is listed by number.
    let sticks_out: Vec<u32> = (0u32..)
        .zip(rest.iter())
        .filter(|(_, p)| p.x > 0.95)
        .map(|(v, _)| v)
        .collect();
    deformer.set_handles(
        [
            Handle::new("feet", Region::half_space([0.0, -1.0, 0.0], -0.14)),
            Handle::new("nose", Region::vertices(sticks_out.iter().copied())),
        ],
        &exec,
    )?;
    let lifted = HandlePose::translation([0.0, 0.2, 0.0]);
    let shape = deformer.commit([("nose", lifted)], &SolveSettings::default(), &exec)?;
    let first = sticks_out[0] as usize;
    Ok((sticks_out.len(), (shape.positions[first] - rest[first]).length()))
}

#[allow(dead_code)]
fn main() -> Result<(), Box<dyn Error>> {
    let (count, way) = lift_what_sticks_out()?;
    println!("{count} vertices went up by {way}");
    Ok(())
}

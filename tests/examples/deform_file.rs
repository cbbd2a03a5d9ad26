//! Deforms a model and writes it: `cargo run --example deform_file [MODEL.glb [OUT.glb]]`.

use pliant::asset::{FileSet, Format, sample};
use pliant::engine::{Deformer, DeformerLimits, Handle, HandlePose, OpenOptions, Region, SolveSettings};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use std::error::Error;

/// Turns the head of the creature while its feet stay, and returns the turned model as a GLB.
pub fn turn_head(model: Vec<u8>) -> Result<Vec<u8>, Box<dyn Error>> {
    let pool = Pool::new(0)?;
    let exec = Exec::new(&pool, &Silent);
    let files = FileSet::single("model.glb", model);
    let mut deformer = Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec)?;
    deformer.set_handles(
        [
            Handle::new("feet", Region::half_space([0.0, -1.0, 0.0], -0.14)),
            Handle::new("head", Region::sphere([0.76, 1.22, 0.0], 0.36)),
        ],
        &exec,
    )?;
    let turned = HandlePose::rotation([0.0, 0.8, 0.0]);
    let shape = deformer.commit([("head", turned)], &SolveSettings::default(), &exec)?;
    Ok(deformer.write(&shape.positions, Format::GLB, &exec)?.main)
}

/// Reads the model that is named, or the built-in creature.
#[allow(dead_code)]
fn main() -> Result<(), Box<dyn Error>> {
    let mut names = std::env::args().skip(1);
    let model = match names.next() {
        Some(name) => std::fs::read(name)?,
        None => sample::creature_glb().to_vec(),
    };
    let out = names.next().unwrap_or_else(|| "target/turned.glb".into());
    std::fs::write(&out, turn_head(model)?)?;
    println!("{out}");
    Ok(())
}

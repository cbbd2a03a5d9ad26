//! Watches a model being opened, and gives another one up: `cargo run --example progress_and_cancel`.

use pliant::asset::{FileSet, sample};
use pliant::engine::{Deformer, DeformerLimits, OpenOptions};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::{CancelFlag, Progress};
use std::error::Error;
use std::sync::Mutex;

/// Writes down the stages that are reported to it.
#[derive(Default)]
pub struct StageList(Mutex<Vec<&'static str>>);

impl Progress for StageList {
    fn report(&self, stage: &'static str, _fraction: f32) {
        let mut stages = self.0.lock().expect("nobody panics while writing");
        if stages.last() != Some(&stage) {
            stages.push(stage);
        }
    }
}

fn open(watcher: &dyn Progress, pool: &Pool) -> Result<Deformer, pliant::engine::Error> {
    let files = FileSet::single("creature.glb", sample::creature_glb());
    let exec = Exec::new(pool, watcher);
    Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec)
}

/// Returns the stages of opening the creature, and what opening it says once it has been given up.
pub fn watch_and_cancel() -> Result<(Vec<&'static str>, String), Box<dyn Error>> {
    let pool = Pool::new(0)?;
    let stages = StageList::default();
    open(&stages, &pool)?;
    let flag = CancelFlag::default();
    // Any thread may do this while the work runs; it stops at its next look.
    flag.cancel();
    let refused = open(&flag, &pool).err().map(|e| e.to_string()).unwrap_or_default();
    Ok((stages.0.into_inner()?, refused))
}

#[allow(dead_code)]
fn main() -> Result<(), Box<dyn Error>> {
    let (stages, refused) = watch_and_cancel()?;
    println!("stages: {}", stages.join(", "));
    println!("given up: {refused}");
    Ok(())
}

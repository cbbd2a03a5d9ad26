//! What animations are to show: clips on models, row by row, beside what they must reach.
//!
//! [`run_motion`] runs the rows that are asked for and prints them, [`stage`] is a model with a rig and a clip on it. The rows: [`ballet`]
//! (a dancing armadillo), [`runs`] (speed, and the same bits however it is solved), [`models`] (other models, a turned hand, and skins).

mod ballet;
mod models;
mod runs;
mod stage;

use crate::failure::LoadtestFailure;
use ballet::{BALLET, BALLET_DATA};
use pliant::pool::Pool;
use serde_json::Value;
use stage::{MotionFigure, MotionFolders};
use std::path::PathBuf;

/// Rows that there are.
const ROWS: [u8; 15] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 16];

/// Arguments of `loadtest motion`.
#[derive(Debug, clap::Args)]
pub(crate) struct MotionArgs {
    /// Folder of the rigs: rig_armadillo_cmu.json, rig_doorman_cmu.json, rig_horse_boxing.json
    #[arg(long, value_name = "DIR")]
    rigs: PathBuf,
    /// Folder of models and clips, with the folders meshes, bvh and gltf
    #[arg(long, value_name = "DIR", env = "PLIANT_DATA")]
    data: PathBuf,
    /// Rows to measure, such as 1,2 [default: all]
    #[arg(long, value_delimiter = ',', value_name = "ROWS")]
    only: Vec<u8>,
    /// Maximum frames of each animation
    #[arg(long, default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Threads of rows that do not set them; 0 means one per core
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

pub(crate) fn run_motion(args: &MotionArgs) -> Result<(), LoadtestFailure> {
    if let Some(row) = args.only.iter().find(|row| !ROWS.contains(row)) {
        return Err(LoadtestFailure::Usage(format!(
            "--only names row {row}; there are {ROWS:?}"
        )));
    }
    let rows: Vec<u8> = ROWS
        .into_iter()
        .filter(|row| args.only.is_empty() || args.only.contains(row))
        .collect();
    let pool = Pool::new(usize::from(args.threads))?;
    let mut all: Vec<MotionFigure> = Vec::new();
    if !args.json {
        println!("{:>2}  {:<58} {:>12} {:>10} {:>10}", "", "", "value", "must", "aim");
    }
    // The dance is solved once for all rows that it serves.
    let mut dance: Vec<u8> = rows.iter().copied().filter(|row| [1, 2, 3, 12].contains(row)).collect();
    for row in &rows {
        let own: Vec<u8> = match row {
            1 | 2 | 3 | 12 => std::mem::take(&mut dance),
            row => vec![*row],
        };
        if own.is_empty() {
            continue;
        }
        let figures = measure(args, &own, &pool)?;
        if !args.json {
            figures.iter().for_each(|figure| println!("{}", figure.line()));
        }
        all.extend(figures);
    }
    if args.json {
        println!("{}", Value::Array(all.iter().map(MotionFigure::json).collect()));
    }
    let short = all.iter().filter(|figure| figure.is_short()).count();
    match short {
        0 => Ok(()),
        _ => Err(LoadtestFailure::Server(format!(
            "{short} figures are short of what they must be"
        ))),
    }
}

fn measure(args: &MotionArgs, rows: &[u8], pool: &Pool) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let folders = MotionFolders {
        data: &args.data,
        rigs: &args.rigs,
    };
    let most = args.frames as usize;
    let (data, rigs): (&[&str], &[&str]) = match rows {
        [9, ..] => (&["gltf/CesiumMan.glb"], &[]),
        [10, ..] => (&["meshes/doorman.obj", "bvh/cmu_02_01.bvh"], &["rig_doorman_cmu.json"]),
        [11, ..] => (&["meshes/horse.ply", "bvh/boxing_toes.bvh"], &["rig_horse_boxing.json"]),
        [13, ..] => (&[], &[]),
        _ => (&BALLET_DATA, &BALLET[1..2]),
    };
    if let Some(missing) = folders.missing(data, rigs) {
        eprintln!("skipped: {rows:?}: {missing}");
        return Ok(Vec::new());
    }
    match rows {
        [4] => ballet::measure_seams(&folders, most, pool),
        [5] => runs::measure_rates(&folders, most),
        [6] => runs::measure_large(&folders),
        [7] => runs::measure_equality(&folders, most),
        [8] => models::measure_wrist(&folders, pool),
        [9] => models::measure_own_clip(&folders, most, pool),
        [row @ (10 | 11)] => models::measure_recorded(*row, &folders, most, pool),
        [13] => models::measure_soups(&folders, pool),
        [14] => ballet::measure_weights(&folders, pool),
        [16] => ballet::measure_heading(&folders, most, pool),
        dance => ballet::measure_dance(&folders, dance, most, pool),
    }
}

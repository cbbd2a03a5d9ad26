//! `loadtest contact`: poses in which surfaces cross, committed without and with contact avoided, side by side.
//!
//! [`scenes`] makes the poses of any model by a rule, [`measure`] commits them. Of each limb the largest bend counts whose surfaces
//! cross no deeper than so many edges, and whose handles push nothing that they hold into each other. Nothing else is chosen.

mod measure;
mod scenes;

use crate::contact_sheet::models_under;
use crate::failure::LoadtestFailure;
use crate::models::read_model_file;
use measure::{ContactOutcome, ContactStage, open};
use pliant::asset::{FileSet, sample};
use pliant::engine::Deformer;
use pliant::pool::Pool;
use scenes::{ContactScene, FoldedShape};
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// Models with fewer or more triangles are left out.
const TRIANGLES: RangeInclusive<usize> = 1_000..=60_000;
/// How deep surfaces of limbs may be in each other, median edges.
const DEEPEST: f64 = 2.5;
/// Limbs that are to end without a pair, and in bounds, of all.
const MUST: f64 = 0.9;
/// Times the mean change of edges without,
const EDGES: f64 = 1.15;
/// and points of volume.
const VOLUME: f64 = 1.2;
/// Pairs of folded shapes that may be left, of those without.
const DEEP_PAIRS: f64 = 0.1;
/// Times what the commit takes without.
const TIME: f64 = 8.0;

/// Arguments of `loadtest contact`.
#[derive(Debug, clap::Args)]
pub(crate) struct ContactArgs {
    /// Folder of models, searched recursively, beside those that are built in
    #[arg(long, value_name = "DIR")]
    models: Option<PathBuf>,
    /// Only models with this in their names
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
}

pub(crate) fn run_contact(args: &ContactArgs) -> Result<(), LoadtestFailure> {
    let pool = Pool::new(1)?;
    let mut limbs = Vec::new();
    for files in model_files(args)? {
        let name = files.name.clone();
        match open(files, &pool) {
            Ok(deformer) if is_one_solid(&deformer) => measure_limbs(&name, deformer, &pool, &mut limbs)?,
            Ok(_) => println!("{name:<32} left out: not one closed surface of {TRIANGLES:?} triangles"),
            Err(LoadtestFailure::Usage(e) | LoadtestFailure::Server(e)) => println!("{name:<32} left out: {e}"),
        }
    }
    let mut folded = Vec::new();
    for shape in FoldedShape::all()
        .into_iter()
        .filter(|shape| shape.name.contains(&args.only))
    {
        let deformer = open(shape.files.clone(), &pool)?;
        let scene = shape.scene(deformer.mesh());
        if let Some(outcome) = ContactStage::set(deformer, &scene, &pool)?.measure(None)? {
            println!("{}", line(shape.name, &outcome));
            folded.push(outcome);
        }
    }
    let problems: Vec<String> = (totals_of_limbs(&limbs).into_iter())
        .chain(totals_of_folded(&folded))
        .filter_map(|(text, is_met)| {
            println!("{text}");
            (!is_met).then_some(text)
        })
        .collect();
    LoadtestFailure::of_problems(&problems)
}

fn model_files(args: &ContactArgs) -> Result<Vec<FileSet>, LoadtestFailure> {
    let mut all = vec![
        FileSet::single("creature.glb", sample::creature_glb().to_vec()),
        FileSet::single("body.glb", sample::body_glb().to_vec()),
    ];
    let mut paths = Vec::new();
    if let Some(folder) = &args.models {
        models_under(folder, &mut paths)?;
    }
    for path in paths {
        all.push(read_model_file(&path)?);
    }
    all.retain(|files| files.name.contains(&args.only));
    Ok(all)
}

fn is_one_solid(deformer: &Deformer) -> bool {
    let report = deformer.report();
    report.parts.len() == 1 && report.boundary_edges == 0 && TRIANGLES.contains(&report.triangles)
}

fn measure_limbs(
    name: &str,
    mut deformer: Deformer,
    pool: &Pool,
    all: &mut Vec<ContactOutcome>,
) -> Result<(), LoadtestFailure> {
    for (k, limb) in ContactScene::limbs(deformer.mesh()).iter().enumerate() {
        let mut stage = ContactStage::set(deformer, limb, pool)?;
        if let Some(outcome) = stage.measure(Some(DEEPEST))? {
            println!("{}", line(&format!("{name}, limb {}", k + 1), &outcome));
            all.push(outcome);
        }
        deformer = stage.into_deformer();
    }
    Ok(())
}

fn line(name: &str, outcome: &ContactOutcome) -> String {
    let ContactOutcome {
        degrees,
        pairs: [before, after],
        depth,
        edges,
        volume,
        seconds,
    } = outcome;
    format!(
        "{name:<32} {degrees:>4}°  {depth:>4.1} edges deep  pairs {before:>4} -> {after:>3}  edges {edges:>5.3} x  \
         volume {volume:>5.2} points  time {:>4.1} x",
        seconds[1] / seconds[0]
    )
}

/// Times without and with contact, and in how many poses it takes more than it may.
fn time_text(all: &[ContactOutcome]) -> String {
    let sum = |k: usize| all.iter().map(|one| one.seconds[k]).sum::<f64>();
    let slow = all.iter().filter(|one| one.seconds[1] > TIME * one.seconds[0]).count();
    format!("time {:.1} x, above {TIME} x in {slow}", sum(1) / sum(0))
}

/// Pairs without and with contact.
fn pairs(all: &[ContactOutcome]) -> [u64; 2] {
    [0, 1].map(|k| all.iter().map(|one| one.pairs[k]).sum())
}

/// What limbs come to, and whether that will do.
fn totals_of_limbs(all: &[ContactOutcome]) -> Option<(String, bool)> {
    let free = all.iter().filter(|one| one.pairs[1] == 0);
    let good = free
        .clone()
        .filter(|one| one.edges <= EDGES && one.volume <= VOLUME)
        .count();
    let [before, after] = pairs(all);
    let text = format!(
        "limbs: {} of {} without pairs, {good} of these within {EDGES} x edges and {VOLUME} points of volume \
         (must {:.0} %); pairs {before} -> {after}; {}",
        free.count(),
        all.len(),
        100.0 * MUST,
        time_text(all),
    );
    (!all.is_empty()).then_some((text, good as f64 >= MUST * all.len() as f64))
}

/// The same of folded shapes.
fn totals_of_folded(all: &[ContactOutcome]) -> Option<(String, bool)> {
    let [before, after] = pairs(all);
    let part = after as f64 / before.max(1) as f64;
    let text = format!(
        "folded: pairs {before} -> {after}, {:.1} % (must {:.0} %); {}",
        100.0 * part,
        100.0 * DEEP_PAIRS,
        time_text(all),
    );
    (!all.is_empty()).then_some((text, part <= DEEP_PAIRS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_that_is_folded_deep_into_itself_is_within_what_must_be() {
        let args = ContactArgs {
            models: None,
            only: "round bar".into(),
        };
        run_contact(&args).expect("few pairs are left");
    }

    #[test]
    fn totals_say_what_falls_short() {
        let outcome = |pairs, edges| ContactOutcome {
            degrees: 90.0,
            pairs,
            depth: 1.0,
            edges,
            volume: 0.5,
            seconds: [1.0, 3.0],
        };
        assert!(totals_of_limbs(&[]).is_none());
        let (text, is_met) = totals_of_limbs(&[outcome([20, 0], 1.1), outcome([30, 0], 1.2)]).expect("two poses");
        assert!(
            text.starts_with("limbs: 2 of 2 without pairs, 1 of these") && text.ends_with("time 3.0 x, above 8 x in 0")
        );
        assert!(!is_met);
        let (text, is_met) = totals_of_folded(&[outcome([90, 0], 2.0), outcome([10, 10], 1.0)]).expect("two poses");
        assert!(text.contains("pairs 100 -> 10, 10.0 %") && is_met, "{text}");
    }
}

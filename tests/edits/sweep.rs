//! Edits on every model of the data folder, hostile ones included: a result or a reason in one line, never a panic.

use crate::support::data::{data_folder, of_each};
use crate::support::gltf_sets::{file_set, models_below};
use crate::support::messages::{DeformerMessages, broken, message, unreferenced};
use crate::support::recipes;
use pliant::asset::Model;
use pliant::engine::{Deformer, DeformerLimits, ModelShape, digest};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{Error, json, pb};
use serde_json::{Value, json};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// Models with fewer triangles have no region worth the name: they are edited as a whole.
const SMALL: usize = 60;

/// Models with more vertices get two edits each, in rotation, and no inside.
const LARGE: usize = 12_000;

/// The edits of one model, each on what the one before it left.
fn edits(bench: &Deformer, k: usize) -> Vec<(&'static str, Value)> {
    let rest = bench.rest();
    if bench.geometry().triangles.len() < SMALL {
        let split = json!({"subdivide": {"scheme": "MIDPOINT"}});
        return vec![("subdivide", split), ("decimate", json!({"decimate": {"ratio": 0.6}}))];
    }
    let edge = bench.report().mean_edge_length;
    let about = |part: f64, radius: f64| {
        let t = bench.geometry().triangles[(part * (bench.geometry().triangles.len() - 1) as f64) as usize];
        let radius = (radius * bench.diagonal()).max(4.0 * edge);
        json!({"sphere": {"center": rest[t[0] as usize].to_array(), "radius": radius}})
    };
    let mut heights: Vec<f64> = rest.iter().map(|p| p.y).collect();
    heights.sort_by(f64::total_cmp);
    let plane = json!({"normal": [0.0, 1.0, 0.01], "offset": heights[heights.len() * 4 / 5] + 1e-4 * edge});
    let all = vec![
        ("subdivide", json!({"subdivide": {"region": about(0.1, 0.06)}})),
        (
            "decimate",
            json!({"decimate": {"region": about(0.4, 0.12), "ratio": 0.5}}),
        ),
        (
            "remesh",
            json!({"remesh": {"region": about(0.6, 0.08), "edgeLength": 0.8 * edge}}),
        ),
        (
            "delete+fill",
            json!({"delete": {"region": about(0.8, 0.04), "fill": true}}),
        ),
        (
            "cut+fill",
            json!({"cut": {"plane": plane, "keep": "BELOW", "fill": true}}),
        ),
        ("auto", json!({"remesh": {"auto": true, "region": about(0.3, 0.1)}})),
    ];
    match rest.len() > LARGE {
        true => [k, k + 1, k + 3].map(|i| all[i % all.len()].clone())[..2].to_vec(),
        false => all,
    }
}

/// One edit: what the table says, or what went wrong.
fn one(bench: &mut Deformer, shape: &mut ModelShape, edit: &Value, pool: &Pool) -> Result<String, String> {
    let request: pb::EditRequest = json::from_json(edit.to_string().as_bytes()).map_err(|e| e.to_string())?;
    let poses = bench.initial_poses();
    let (idle, defects, was) = (unreferenced(bench), broken(bench), digest(bench.rest()));
    match bench.edit_message(&request, shape, &poses, &Exec::new(pool, &Silent)) {
        Ok(outcome) => {
            let [before, after] = [outcome.result.before, outcome.result.after].map(Option::unwrap_or_default);
            let agree = after.vertices as usize == bench.rest().len()
                && after.faces as usize == bench.geometry().triangles.len()
                && outcome.result.digest == digest(&outcome.shape);
            if !agree {
                return Err("the result does not agree with the model".into());
            }
            if !outcome.shape.iter().all(|p| p.is_finite()) {
                return Err("a place that is not finite".into());
            }
            if unreferenced(bench) > idle {
                return Err(format!("{} vertices are left behind", unreferenced(bench) - idle));
            }
            if defects == 0 && broken(bench) > 0 {
                return Err(format!("{} places are not manifold any more", broken(bench)));
            }
            *shape = outcome.shape;
            Ok(format!("{}→{}", before.faces, after.faces))
        }
        Err(Error::Internal(problem)) => Err(problem),
        Err(e) => {
            let said = e.to_string();
            if said.is_empty() || said.contains('\n') || digest(bench.rest()) != was {
                return Err(format!("not refused in one line, or something changed: {said}"));
            }
            Ok(said)
        }
    }
}

/// A line of the table, and what went wrong.
fn try_model(path: &Path, k: usize) -> (String, Option<String>) {
    let files = file_set(path);
    let pool = Pool::new(1).expect("a thread");
    let limits = DeformerLimits {
        memory_bytes: 2 << 30,
        ..Default::default()
    };
    let mode = if files.main.len() > 1_200_000 { "OFF" } else { "AUTO" };
    let create: pb::CreateOptions = message(&json!({"volumeGraph": {"mode": mode}}));
    let mut bench = match Deformer::open(
        files,
        &pliant::wire::open_options(&create).expect("valid"),
        &limits,
        &Exec::new(&pool, &Silent),
    ) {
        Ok(bench) => bench,
        Err(e) => {
            let said = e.to_string();
            let wrong = (said.is_empty() || said.contains('\n')).then(|| format!("not one line: {said}"));
            return (format!("not opened: {said}"), wrong);
        }
    };
    let mut line = format!("{:>6} vertices", bench.rest().len());
    let mut shape = bench.rest_shape();
    for (name, edit) in edits(&bench, k) {
        match one(&mut bench, &mut shape, &edit, &pool) {
            Ok(said) => line += &format!(" | {name} {said}"),
            Err(problem) => return (line, Some(format!("{name}: {problem}"))),
        }
    }
    let format = bench.model().format;
    match bench.write(&shape, format, &Exec::new(&pool, &Silent)) {
        Err(e) => line += &format!(" | not written as {format}: {e}"),
        Ok(written) => {
            let files = recipes::file_set("written", written);
            match Model::read(files, Some(format), &limits.model) {
                Ok(back) if back.triangles.len() == bench.geometry().triangles.len() => {}
                Ok(back) => {
                    let (seen, made) = (back.triangles.len(), bench.geometry().triangles.len());
                    return (line, Some(format!("{seen} of {made} triangles are read back")));
                }
                Err(e) => return (line, Some(format!("cannot be read back: {e}"))),
            }
        }
    }
    (line, None)
}

#[test]
fn every_model_is_edited_or_says_why_not() {
    let Some(data) = data_folder("edits of every model") else {
        return;
    };
    let models = models_below(&data, &["meshes", "gltf", "hostile"]);
    let results = of_each(&models, |k, path| {
        let tried = catch_unwind(AssertUnwindSafe(|| try_model(path, k)));
        tried.unwrap_or_else(|_| (String::new(), Some("a panic".into())))
    });
    let mut wrong = Vec::new();
    for (path, (line, problem)) in models.iter().zip(&results) {
        let name = path.strip_prefix(&data).unwrap_or(path).display();
        println!("{name:<66} {line}");
        if let Some(problem) = problem {
            println!("{:<66} WRONG: {problem}", "");
            wrong.push(format!("{name}: {problem}"));
        }
    }
    let edited = results.iter().filter(|r| !r.0.starts_with("not opened")).count();
    println!("{} models: {edited} edited, {} wrong", results.len(), wrong.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(edited > results.len() / 4);
}

//! Every real model of the data folder through `pliant deform`, the way a pipeline would call it.

use crate::support::data::{data_folder, of_each};
use crate::support::gltf_sets::{models_below, read_model};
use crate::support::server::retried_here;
use crate::support::shapes::bounds;
use pliant::asset::Model;
use serde_json::json;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// What the job of the sweep may do to a model, whatever its shape: it turns one end by 29° and shifts it by a tenth of
/// the diagonal. A box of eight vertices, all of them held, loses 0.103 of its volume.
const BOUNDS: Bounds = Bounds {
    volume: 0.11,
    flipped: 0.01,
    stretch: 5.0,
};

/// How far a shape may be from its rest shape.
#[derive(Clone, Copy)]
struct Bounds {
    /// Relative change of the enclosed volume, either way.
    volume: f64,
    /// Flipped triangles as a fraction of all.
    flipped: f64,
    /// Largest singular value of any triangle's Jacobian.
    stretch: f64,
}

/// Warnings that explain any stretch: a face that is almost a line is pulled to many times its height by a motion that
/// leaves its neighbours as they are.
const THIN: [&str; 2] = ["sliver", "degenerate-face"];

/// Models that go beyond [`BOUNDS`], how far, and what it is about them.
const EXCEPTIONS: [(&str, Bounds, &str); 1] = [(
    "mode5.gltf",
    Bounds {
        flipped: 0.05,
        ..BOUNDS
    },
    "55 slivers and 101 cracks among 1,476 vertices",
)];

/// A run that takes longer hangs.
const PATIENCE: Duration = Duration::from_secs(60);

/// Runs the program with a deadline; returns (exit code, stdout, last line of stderr).
fn pliant(arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pliant"));
    let out = tempfile::tempfile().expect("a file");
    let err = tempfile::tempfile().expect("a file");
    let stdio = |f: &fs::File| Stdio::from(f.try_clone().expect("a handle"));
    let mut child = command
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(stdio(&out))
        .stderr(stdio(&err))
        .spawn()
        .expect("it starts");
    let Some(status) = retried_here(PATIENCE, || child.try_wait().expect("it can be waited for")) else {
        let _ = child.kill();
        let _ = child.wait();
        return (None, String::new(), "no result in time".into());
    };
    let text = |mut f: fs::File| {
        use std::io::{Read, Seek};
        let mut text = String::new();
        f.rewind().and_then(|()| f.read_to_string(&mut text)).expect("text");
        text
    };
    let err = text(err);
    (
        status.code(),
        text(out),
        err.trim_end().lines().last().unwrap_or_default().to_owned(),
    )
}

/// Two handles at the ends of the longest side: one stays, one is turned and shifted.
fn job_for(model: &Model) -> serde_json::Value {
    let (low, high) = bounds(&model.positions);
    let size = high - low;
    let axis = (0..3).fold(0, |best, k| if size[k] > size[best] { k } else { best });
    let normal = |sign: f64| {
        let mut n = [0.0; 3];
        n[axis] = sign;
        n
    };
    let mut turn = [0.0; 3];
    turn[(axis + 1) % 3] = 0.5;
    let mut shift = [0.0; 3];
    shift[(axis + 2) % 3] = 0.1 * size.length();
    json!({
        "handles": [
            {"id": "base", "region": {"halfSpace": {"normal": normal(-1.0), "offset": -(low[axis] + 0.15 * size[axis])}}},
            {"id": "top", "region": {"halfSpace": {"normal": normal(1.0), "offset": low[axis] + 0.85 * size[axis]}}},
        ],
        "steps": [{"pose": {"handles": [{"id": "top", "pose": {"rotationVector": turn, "translation": shift}}]}}],
    })
}

/// What became of one model: a line for the table, or what went wrong.
fn try_model(path: &Path, work: &Path) -> Result<String, String> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let extension = path.extension().unwrap_or_default().to_string_lossy().into_owned();
    let model_path = path.to_string_lossy();
    let out = work.join("out").join(&name);
    let out_text = out.to_string_lossy().into_owned();
    fs::create_dir_all(out.parent().unwrap_or(work)).map_err(|e| e.to_string())?;
    let job_path = work.join("job.json");
    let run = |job: &serde_json::Value| {
        fs::write(&job_path, job.to_string()).expect("the job is written");
        pliant(&[
            "deform",
            &model_path,
            "--job",
            &job_path.to_string_lossy(),
            "-o",
            &out_text,
            "--json",
            "--force",
            "--threads",
            "1",
        ])
    };
    let model = read_model(path);
    let begun = Instant::now();
    let job = model.as_ref().map_or_else(|| json!({"handles": []}), job_for);
    let (code, stdout, reason) = run(&job);
    let ms = begun.elapsed().as_millis();
    match code {
        None => return Err(format!("no result after {PATIENCE:?}")),
        Some(2) if reason.is_empty() || out.exists() => {
            return Err("refused without a reason, or with an output".into());
        }
        Some(2) => {
            let reason = reason.trim_start_matches("pliant: ").trim_end();
            let reply: Option<serde_json::Value> = serde_json::from_str(&stdout).ok();
            let error = json!({"error": {"kind": "input", "exitCode": 2, "message": reason}});
            return match reply == Some(error) {
                true => Ok(format!("refused: {reason}")),
                false => Err(format!("stdout does not tell the refusal \"{reason}\": {stdout}")),
            };
        }
        Some(0) => {}
        Some(code) => return Err(format!("exit code {code}: {reason}")),
    }
    let model = model.ok_or("deformed, but cannot be read")?;
    let report: serde_json::Value = serde_json::from_str(&stdout).map_err(|e| format!("stdout is not JSON: {e}"))?;
    let written = read_model(&out).ok_or("the output cannot be read again")?;
    // Not triangle by triangle: a quad that has bent may be cut along its other diagonal when it is read again.
    if written.positions.len() != model.positions.len() || written.triangles.len() != model.triangles.len() {
        return Err("the output has other vertices or triangles".into());
    }
    if !written.positions.iter().all(|p| p.is_finite()) {
        return Err("the output holds a number that is not finite".into());
    }
    if written.positions == model.positions {
        return Err("nothing moved".into());
    }
    // Without a pose the model comes back byte for byte.
    let (code, _, reason) = run(&json!({"handles": job["handles"].clone()}));
    if code != Some(0) {
        return Err(format!("without a pose: exit code {code:?}: {reason}"));
    }
    if fs::read(&out).ok() != fs::read(path).ok() {
        return Err(format!("without a pose the .{extension} changed"));
    }
    let step = &report["steps"][0];
    let measure = |name: &str| report["quality"][name].as_f64().unwrap_or_default();
    let warned = |code: &str| {
        report["warnings"]
            .as_array()
            .is_some_and(|all| all.iter().any(|w| w["code"] == code))
    };
    let thin = THIN.iter().any(|code| warned(code));
    let (volume, flipped, stretch) = (
        measure("volumeChange"),
        measure("flippedTriangles") / model.triangles.len().max(1) as f64,
        measure("maxStretch"),
    );
    let exception = EXCEPTIONS.iter().find(|e| name == e.0);
    let bounds = exception.map_or(BOUNDS, |e| e.1);
    let reply = format!("volume {volume:+.3}, flipped {flipped:.4}, stretch {stretch:.2}");
    // Written so that what is not a number is beyond every bound.
    let within = |bounds: Bounds| {
        volume.abs() <= bounds.volume && flipped <= bounds.flipped && (thin || stretch <= bounds.stretch)
    };
    if !within(bounds) {
        return Err(format!("beyond its bounds: {reply}"));
    }
    if let Some((_, _, reason)) = exception.filter(|_| within(BOUNDS)) {
        return Err(format!("needs no exception any more ({reason}): {reply}"));
    }
    Ok(format!(
        "deformed: {} vertices, {} graph, {} cycles, residual {:.0e}, {reply}, {ms} ms",
        model.positions.len(),
        report["solver"]["graphVertices"],
        step["cycles"],
        step["residual"].as_f64().unwrap_or_default(),
    ))
}

#[test]
fn every_model_is_deformed_or_refused_in_one_line() {
    let Some(data) = data_folder("deforming every model") else {
        return;
    };
    let models = models_below(&data, &["meshes", "gltf"]);
    let work = tempfile::tempdir().expect("a folder");
    let results = of_each(&models, |k, path| {
        let folder = work.path().join(k.to_string());
        let result = try_model(path, &folder);
        let _ = fs::remove_dir_all(&folder);
        result
    });
    let mut wrong = Vec::new();
    for (path, result) in models.iter().zip(&results) {
        let name = path.strip_prefix(&data).unwrap_or(path).display();
        match result {
            Ok(line) => println!("{name:<58} {line}"),
            Err(problem) => {
                println!("{name:<58} WRONG: {problem}");
                wrong.push(format!("{name}: {problem}"));
            }
        }
    }
    let refused = results
        .iter()
        .filter(|r| r.as_ref().is_ok_and(|l| l.starts_with("refused")))
        .count();
    println!(
        "{} models: {} deformed, {refused} refused, {} wrong",
        results.len(),
        results.len() - refused - wrong.len(),
        wrong.len()
    );
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

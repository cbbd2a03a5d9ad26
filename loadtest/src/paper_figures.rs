//! The paper's figures 2 and 3 from generated shapes: every way of deforming beside the others, as meshes, as one picture
//! each, and in numbers.

use crate::failure::LoadtestFailure;
use crate::models::write_obj;
use glam::{DQuat, DVec3};
use pliant::asset::{FileSet, shapes};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::render::{Camera, Picture, PictureSize, Rgb, ShadedSurface, UpAxis, ViewDirection, draw_surface};
use pliant::wire::pb;
use pliant::{batch, engine};
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// Pixels of one tile, and of the line below it.
const TILE: [u32; 2] = [300, 440];
const LABEL: u32 = 34;
const PAPER: Rgb = [255; 3];
const INK: Rgb = [40, 44, 52];
/// Turns of the spring, and how far apart they are; its radius is 1.
const TURNS: f64 = 6.0;
const PITCH: f64 = 0.25;
/// How far one of its coils is pulled.
const PULL: f64 = 1.5;
/// Radians by which the bar is twisted.
const TWIST: f64 = 0.75 * std::f64::consts::PI;

/// Arguments of `loadtest figures`.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct FiguresArgs {
    /// Output folder for meshes (obj) and pictures (png), created if missing
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
    /// Compute threads; 0 means one per core
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=1024))]
    threads: u32,
}

/// What a figure's result is like, in words.
type Judge = Box<dyn Fn(&[DVec3]) -> String>;

/// One figure: a shape, what is done to it, and how the result is judged.
struct Figure {
    name: &'static str,
    shape: shapes::Shape,
    handles: Vec<pb::Handle>,
    view: [f64; 2],
    judge: Judge,
}

/// The ways, as file names, with the options that choose them.
fn ways() -> [(&'static str, pb::Options); 4] {
    let options = |first_pass: pb::options::FirstPass, method: pb::options::Method| pb::Options {
        first_pass: first_pass as i32,
        method: method as i32,
        tolerance: 1e-6,
        refine: Some(0),
        ..Default::default()
    };
    use pb::options::{FirstPass, Method};
    [
        ("diffusion", options(FirstPass::Diffusion, Method::Graph)),
        ("harmonic", options(FirstPass::Harmonic, Method::Graph)),
        ("linear-frames", options(FirstPass::LinearFrames, Method::Graph)),
        ("spatial-rbf", options(FirstPass::Harmonic, Method::SpatialRbf)),
    ]
}

pub(crate) fn run_figures(args: &FiguresArgs) -> Result<(), LoadtestFailure> {
    let pool = Pool::new(args.threads as usize)?;
    fs::create_dir_all(&args.output)
        .map_err(|e| LoadtestFailure::Usage(format!("cannot make {}: {e}", args.output.display())))?;
    for figure in [bar(), spring()] {
        print!("{}", make(&figure, &args.output, &pool)?);
    }
    Ok(())
}

/// Writes a figure's meshes and picture; returns its table.
fn make(figure: &Figure, folder: &Path, pool: &Pool) -> Result<String, LoadtestFailure> {
    let failed = |e: &dyn std::fmt::Display| LoadtestFailure::Server(format!("{}: {e}", figure.name));
    let mut shown = vec![("rest", figure.shape.0.clone(), String::new())];
    let mut table = format!("{}, {} vertices\n", figure.name, figure.shape.0.len());
    for (name, options) in ways() {
        let job = pb::Job {
            handles: figure.handles.clone(),
            options: Some(options),
            ..Default::default()
        };
        let files = FileSet::single("shape.obj", write_obj(&figure.shape.0, &figure.shape.1));
        let limits = engine::DeformerLimits::default();
        let outcome =
            batch::run(files, &job, None, &limits, &Exec::new(pool, &Silent), &|| 0.0).map_err(|e| failed(&e))?;
        let quality = outcome.report.quality.unwrap_or_default();
        let judged = (figure.judge)(&outcome.positions);
        let _ = writeln!(
            table,
            "  {name:13} {judged}; volume {:+.1} %, largest stretch {:.2}, flipped {}",
            100.0 * quality.volume_change,
            quality.max_stretch,
            quality.flipped_triangles
        );
        shown.push((name, outcome.positions.to_vec(), judged));
    }
    for (name, positions, _) in &shown {
        let path = folder.join(format!("{}-{name}.obj", figure.name));
        write(&path, write_obj(positions, &figure.shape.1).as_bytes())?;
    }
    let picture = picture(figure, &shown, pool).map_err(|e| failed(&e))?;
    write(&folder.join(format!("{}.png", figure.name)), &picture)?;
    Ok(table)
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), LoadtestFailure> {
    fs::write(path, bytes).map_err(|e| LoadtestFailure::Usage(format!("cannot write {}: {e}", path.display())))
}

/// All shapes side by side, seen by one camera.
fn picture(
    figure: &Figure,
    shown: &[(&str, Vec<DVec3>, String)],
    pool: &Pool,
) -> Result<Vec<u8>, pliant::render::Error> {
    let mut surfaces = Vec::new();
    for (_, positions, _) in shown {
        surfaces.push(ShadedSurface::new(positions, &figure.shape.1, pool)?.with_wires());
    }
    let view = ViewDirection::new(figure.view[0], figure.view[1], UpAxis::Z)?;
    let size = PictureSize::new(TILE[0], TILE[1])?;
    let cameras = Camera::around_surfaces(&surfaces.iter().collect::<Vec<_>>(), &[view], size);
    let width = u64::from(TILE[0]) * shown.len() as u64;
    let mut picture = Picture::new(width, u64::from(TILE[1] + LABEL), PAPER)?;
    for (k, (surface, (name, _, judged))) in surfaces.iter().zip(shown).enumerate() {
        let left = k as u32 * TILE[0];
        if let Some(camera) = cameras.first() {
            picture.paste_picture(&draw_surface(surface, camera, pool), left, 0);
        }
        picture.write_text(left + 8, TILE[1] + 4, 1, name, INK);
        picture.write_text(left + 8, TILE[1] + 16, 1, judged, INK);
    }
    picture.encode_png()
}

fn handle(id: &str, shape: &shapes::Shape, keep: impl Fn(DVec3) -> bool, pose: Option<pb::HandlePose>) -> pb::Handle {
    let indices = (0u32..).zip(&shape.0).filter(|(_, p)| keep(**p)).map(|(i, _)| i);
    let list = pb::region::Vertices {
        indices: indices.collect(),
        ranges: Vec::new(),
    };
    pb::Handle {
        id: id.into(),
        region: Some(pb::Region {
            region: Some(pb::region::Region::Vertices(list)),
        }),
        pose,
        ..Default::default()
    }
}

/// A bar 4 long and 1 wide, one end of which is twisted by 135°.
fn bar() -> Figure {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(1.0, 1.0, 4.0), [12, 12, 48]);
    let positions: Vec<DVec3> = positions.iter().map(|p| *p - DVec3::new(0.5, 0.5, 0.0)).collect();
    let ideal: Vec<DVec3> = positions
        .iter()
        .map(|p| DQuat::from_rotation_z(TWIST * ((p.z - 0.25) / 3.5).clamp(0.0, 1.0)) * *p)
        .collect();
    let twisted = pb::HandlePose {
        rotation_vector: vec![0.0, 0.0, TWIST],
        pivot: vec![0.0, 0.0, 3.75],
        ..Default::default()
    };
    let shape = (positions, triangles);
    Figure {
        name: "figure2",
        handles: vec![
            handle("base", &shape, |p| p.z <= 0.25, None),
            handle("top", &shape, |p| p.z >= 3.75, Some(twisted)),
        ],
        shape,
        view: [25.0, 15.0],
        judge: Box::new(move |positions| {
            let squares: f64 = positions.iter().zip(&ideal).map(|(a, b)| a.distance_squared(*b)).sum();
            let rms = (squares / ideal.len() as f64).sqrt() / DVec3::new(1.0, 1.0, 4.0).length();
            format!("rms to even twist {rms:.4}")
        }),
    }
}

/// A spring of close coils. The wire is held at both ends and half a turn before and after the place where one coil is
/// pulled out. The coils beside that place are cut off from it along the wire, and near it in space.
fn spring() -> Figure {
    let shape = shapes::spring(1.0, 0.08, PITCH, TURNS, 12, 720);
    let turns = |p: DVec3| {
        let angle = f64::atan2(p.y, p.x) / TAU;
        (p.z / PITCH - angle).round() + angle
    };
    let near = move |p: DVec3, at: &[f64]| at.iter().any(|at| (turns(p) - at).abs() < 0.07);
    let middle = (TURNS / 2.0).round();
    let pulled = pb::HandlePose {
        translation: vec![PULL, 0.0, 0.0],
        ..Default::default()
    };
    let anchors = [0.0, middle - 0.5, middle + 0.5, TURNS];
    let beside: Vec<usize> = (0..shape.0.len())
        .filter(|&i| near(shape.0[i], &[middle - 1.0, middle + 1.0]))
        .collect();
    let rest = shape.0.clone();
    Figure {
        name: "figure3",
        handles: vec![
            handle("anchors", &shape, |p| near(p, &anchors), None),
            handle("coil", &shape, |p| near(p, &[middle]), Some(pulled)),
        ],
        shape,
        view: [20.0, 20.0],
        judge: Box::new(move |positions| {
            let along: f64 = beside.iter().map(|&i| (positions[i] - rest[i]).x / PULL).sum();
            // Adding 0 takes the sign off a rounded nothing.
            let percent = (100.0 * along / beside.len() as f64).round() + 0.0;
            format!("next coils follow {percent} %")
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_has_its_mesh_and_the_tables_order_as_in_the_paper() {
        let folder = tempfile::tempdir().expect("a folder");
        let pool = Pool::new(2).expect("threads start");
        let number = |table: &str, way: &str| -> f64 {
            let line = table.lines().find(|l| l.trim_start().starts_with(way)).expect("a line");
            let words = line.split(';').next().expect("a part").split_whitespace();
            words.filter_map(|w| w.parse().ok()).next_back().expect("a number")
        };
        let table = make(&bar(), folder.path(), &pool).expect("made");
        assert!(
            number(&table, "linear-frames") > 2.0 * number(&table, "harmonic"),
            "{table}"
        );
        assert!(
            (number(&table, "diffusion") - number(&table, "harmonic")).abs() < 2e-4,
            "{table}"
        );
        let table = make(&spring(), folder.path(), &pool).expect("made");
        assert!(
            number(&table, "spatial-rbf") > 40.0 && number(&table, "harmonic").abs() < 1.0,
            "{table}"
        );
        for figure in ["figure2", "figure3"] {
            for way in ["rest", "diffusion", "harmonic", "linear-frames", "spatial-rbf"] {
                assert!(folder.path().join(format!("{figure}-{way}.obj")).is_file());
            }
            let png = fs::read(folder.path().join(format!("{figure}.png"))).expect("a picture");
            assert!(png.starts_with(b"\x89PNG"));
        }
    }
}

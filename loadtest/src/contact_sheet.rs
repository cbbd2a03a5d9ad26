//! A contact sheet: every model of a folder, deformed by a job made for it, as one picture to look at.
//!
//! The automatic job holds the lowest 15 % along the model's longest side and turns the highest 15 % by half a radian,
//! shifted sideways by a tenth of the diagonal. Each model has three tiles: before, after, and after with edges coloured
//! by how much longer or shorter they are.

use crate::failure::LoadtestFailure;
use crate::models::{end_handles, longest_axis};
use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits, Model};
use pliant::exec::Exec;
use pliant::mesh::{BoundingBox, Mesh, Weld, self_intersections};
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::render::{
    Camera, ColourKey, ColourRamp, Picture, PictureSize, Rgb, STRETCH_RANGE, ShadedSurface, UpAxis, ViewDirection,
    draw_surface, edge_stretch,
};
use pliant::wire::pb;
use pliant::{batch, engine};
use std::fs;
use std::path::{Path, PathBuf};

/// Share of the longest side that each handle takes.
const END: f64 = 0.15;
/// Radians by which the far end turns.
const TURN: f64 = 0.5;
/// Share of the diagonal by which it moves sideways.
const SHIFT: f64 = 0.1;
/// Models with more triangles are left out unless asked for.
const LARGE: usize = 200_000;
/// Rows of pixels above the tiles of a model, and of the key.
const LABEL: u32 = 24;
const PAPER: Rgb = [255; 3];
const INK: Rgb = [40, 44, 52];
const ALARM: Rgb = [190, 20, 30];

/// Arguments of `loadtest sheet`.
#[derive(Debug, Clone, clap::Parser)]
pub(crate) struct SheetArgs {
    /// Folder with models, searched recursively
    folder: PathBuf,
    /// Output picture (.png)
    #[arg(short, long, value_name = "PICTURE")]
    output: PathBuf,
    /// Include models with more than 200000 triangles
    #[arg(long)]
    all: bool,
    /// Models per row
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=16))]
    columns: u32,
    /// Size of a tile in pixels, each way
    #[arg(long, default_value_t = 220, value_parser = clap::value_parser!(u32).range(64..=1024))]
    tile: u32,
    /// Rotation refinements of each solve [default: as for a commit]
    #[arg(long)]
    refine: Option<u32>,
    /// Compute threads; 0 means one per core
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=1024))]
    threads: u32,
}

/// One model on the sheet.
struct SheetEntry {
    name: String,
    result: Result<DeformedTiles, String>,
}

/// What is shown of a model that deformed.
struct DeformedTiles {
    tiles: [Picture; 3],
    text: String,
    /// Something that a person should look at.
    alarm: bool,
}

pub(crate) fn run_sheet(args: &SheetArgs) -> Result<(), LoadtestFailure> {
    let mut paths = Vec::new();
    models_under(&args.folder, &mut paths)?;
    if paths.is_empty() {
        return Err(LoadtestFailure::Usage(format!(
            "{} holds no models",
            args.folder.display()
        )));
    }
    let pool = Pool::new(args.threads as usize)?;
    let mut entries = Vec::new();
    for path in &paths {
        let name = path.strip_prefix(&args.folder).unwrap_or(path).display().to_string();
        let Some(result) = deform_file(path, args, &pool) else {
            println!("{name:<40} left out: more than {LARGE} triangles");
            continue;
        };
        match &result {
            Ok(shown) => println!("{name:<40} {}{}", if shown.alarm { "LOOK " } else { "" }, shown.text),
            Err(reason) => println!("{name:<40} refused: {reason}"),
        }
        entries.push(SheetEntry { name, result });
    }
    let picture = draw_sheet(&entries, args)?;
    let png = picture.encode_png()?;
    fs::write(&args.output, png)
        .map_err(|e| LoadtestFailure::Usage(format!("cannot write {}: {e}", args.output.display())))?;
    println!(
        "{} models -> {}, {}x{} pixels",
        entries.len(),
        args.output.display(),
        picture.width(),
        picture.height()
    );
    Ok(())
}

/// The models in a folder and those in it, in the order of their names.
pub(crate) fn models_under(folder: &Path, found: &mut Vec<PathBuf>) -> Result<(), LoadtestFailure> {
    let refuse = |e: std::io::Error| LoadtestFailure::Usage(format!("cannot list {}: {e}", folder.display()));
    let mut entries = Vec::new();
    for entry in fs::read_dir(folder).map_err(refuse)? {
        entries.push(entry.map_err(refuse)?.path());
    }
    entries.sort();
    for path in entries {
        if path.is_dir() {
            models_under(&path, found)?;
        } else if Format::from_file_name(&path.to_string_lossy()).is_some() {
            found.push(path);
        }
    }
    Ok(())
}

/// Reads the files of a model: for glTF with those beside it.
fn read_model_files(path: &Path) -> Result<FileSet, std::io::Error> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut files = FileSet::single(name, fs::read(path)?);
    if let Some(folder) = path.parent().filter(|_| path.extension().is_some_and(|e| e == "gltf")) {
        for entry in fs::read_dir(folder)? {
            let beside = entry?.path();
            if beside.is_file() && beside != path {
                let name = beside.file_name().unwrap_or_default().to_string_lossy().into_owned();
                files.companions.insert(name, fs::read(&beside)?.into());
            }
        }
    }
    Ok(files)
}

/// Holds one end along the longest side, turns and shifts the other.
fn automatic_job(bounds: &BoundingBox, refine: Option<u32>) -> pb::Job {
    let axis = longest_axis(bounds);
    let unit = |k: usize, x: f64| {
        let mut v = vec![0.0; 3];
        v[k % 3] = x;
        v
    };
    let mut handles = end_handles(bounds, END);
    handles[1].pose = Some(pb::HandlePose {
        rotation_vector: unit(axis + 1, TURN),
        translation: unit(axis + 2, SHIFT * bounds.diagonal()),
        ..Default::default()
    });
    let output = pb::Output {
        self_intersections: true,
        ..Default::default()
    };
    pb::Job {
        handles: handles.into(),
        options: Some(pb::Options {
            refine,
            output: Some(output),
            ..Default::default()
        }),
        ..Default::default()
    }
}

/// Finds the view in which the bend is seen best: almost along the axis of the turn.
fn bend_view(bounds: &BoundingBox) -> Option<ViewDirection> {
    let (azimuth, up) = match (longest_axis(bounds) + 1) % 3 {
        0 => (65.0, UpAxis::Y),
        // From above, where models that stand on y = 0 show more.
        1 => (205.0, UpAxis::Z),
        _ => (25.0, UpAxis::Y),
    };
    ViewDirection::new(azimuth, 15.0, up).ok()
}

/// Deforms one model; `None` when it is too large for the sheet.
fn deform_file(path: &Path, args: &SheetArgs, pool: &Pool) -> Option<Result<DeformedTiles, String>> {
    let read = || -> Result<Model, String> {
        let files = read_model_files(path).map_err(|e| e.to_string())?;
        Model::read(files, None, &Limits::default()).map_err(|e| e.to_string())
    };
    match read() {
        Ok(model) if model.triangles.len() > LARGE && !args.all => None,
        Ok(model) => Some(deform_model(&model, args, pool).map_err(|e| e.to_string())),
        Err(reason) => Some(Err(reason)),
    }
}

fn deform_model(model: &Model, args: &SheetArgs, pool: &Pool) -> Result<DeformedTiles, Box<dyn std::error::Error>> {
    let mesh = Mesh::build(&model.positions, &model.triangles, Weld::Exact)?;
    let bounds = mesh.bounds();
    let job = automatic_job(&bounds, args.refine);
    let limits = engine::DeformerLimits::default();
    let outcome = batch::run(
        model.files.clone(),
        &job,
        None,
        &limits,
        &Exec::new(pool, &Silent),
        &|| 0.0,
    )?;
    let crossed = self_intersections(&mesh.positions, &mesh.triangles, &Exec::new(pool, &Silent))?;
    let quality = outcome.report.quality.unwrap_or_default();
    let after = u64::from(quality.self_intersections.unwrap_or_default());

    let before = ShadedSurface::new(&model.positions, &model.triangles, pool)?;
    let plain = ShadedSurface::new(&outcome.positions, &model.triangles, pool)?;
    let stretch = edge_stretch(&model.positions, &outcome.positions, &model.triangles)?;
    let colours: Vec<_> = stretch
        .into_iter()
        .map(|x| ColourRamp::Stretch.linear_colour(x))
        .collect();
    let coloured = plain.clone().with_colours(&colours)?;
    let size = PictureSize::new(args.tile, args.tile)?;
    let views: Vec<ViewDirection> = bend_view(&bounds).into_iter().collect();
    let cameras = Camera::around_surfaces(&[&before, &plain], &views, size);
    let camera = cameras.first().ok_or("no view")?;
    let moved = outcome.positions.iter().zip(&model.positions).any(|(p, q)| p != q);
    let finite = outcome.positions.iter().all(|p: &DVec3| p.is_finite());
    Ok(DeformedTiles {
        tiles: [&before, &plain, &coloured].map(|surface| draw_surface(surface, camera, pool)),
        text: format!(
            "{} tri  vol {:+.1}%  area {:+.1}%  edge {:.3}  stretch {:.2}  flips {}  cross {crossed}>{after}",
            model.triangles.len(),
            100.0 * quality.volume_change,
            100.0 * quality.area_change,
            quality.edge_rms,
            quality.max_stretch,
            quality.flipped_triangles,
        ),
        alarm: quality.flipped_triangles > 0
            || quality.volume_change.abs() > 0.1
            || quality.max_stretch > 3.0
            || after > crossed + crossed / 10
            || !moved
            || !finite,
    })
}

/// Draws all models on one picture, with the key to the colours below.
fn draw_sheet(entries: &[SheetEntry], args: &SheetArgs) -> Result<Picture, LoadtestFailure> {
    let tile = args.tile;
    let (width, height) = (3 * tile + 8, tile + LABEL + 8);
    let count = u32::try_from(entries.len()).unwrap_or(u32::MAX);
    let rows = count.div_ceil(args.columns);
    let sides = [args.columns.min(count), rows].map(u64::from);
    let mut picture = Picture::new(
        sides[0] * u64::from(width),
        sides[1] * u64::from(height) + u64::from(LABEL),
        PAPER,
    )
    .map_err(LoadtestFailure::usage)?;
    for (k, entry) in entries.iter().enumerate() {
        let k = u32::try_from(k).unwrap_or(u32::MAX);
        let (x, y) = (k % args.columns * width + 4, k / args.columns * height + 4);
        picture.write_text(x, y, 1, &entry.name, INK);
        match &entry.result {
            Ok(shown) => {
                picture.write_text(x, y + 11, 1, &shown.text, if shown.alarm { ALARM } else { INK });
                for (at, tile_picture) in (0..).zip(&shown.tiles) {
                    picture.paste_picture(tile_picture, x + at * tile, y + LABEL - 2);
                }
            }
            Err(reason) => write_wrapped(&mut picture, x, y + 11, 3 * tile, reason),
        }
    }
    ColourKey::for_stretch(STRETCH_RANGE).draw_on(&mut picture, rows * height, LABEL);
    Ok(picture)
}

/// Writes a text in lines of at most `width` pixels.
fn write_wrapped(picture: &mut Picture, x: u32, y: u32, width: u32, text: &str) {
    let letter = Picture::text_size(1, "  ").0 - Picture::text_size(1, " ").0;
    let letters: Vec<char> = text.chars().collect();
    for (line, part) in (0..).zip(letters.chunks((width / letter).max(1) as usize).take(8)) {
        let part: String = part.iter().collect();
        picture.write_text(x, y + 11 * line, 1, &part, ALARM);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use pliant::asset::sample;

    fn args(folder: &Path, more: &[&str]) -> SheetArgs {
        let output = folder.join("sheet.png");
        let fixed = std::iter::once("sheet".to_owned());
        let paths = [folder.display().to_string(), "-o".into(), output.display().to_string()];
        let words = fixed.chain(paths).chain(more.iter().map(|w| (*w).to_owned()));
        SheetArgs::parse_from(words)
    }

    #[test]
    fn a_folder_becomes_one_picture_with_every_model() {
        let folder = tempfile::tempdir().expect("a folder");
        let inner = folder.path().join("inner");
        fs::create_dir(&inner).expect("a folder");
        fs::write(folder.path().join("creature.glb"), sample::creature_glb()).expect("written");
        fs::write(inner.join("broken.obj"), "v 0 0 nan\n").expect("written");
        fs::write(inner.join("notes.txt"), "no model").expect("written");
        let args = args(folder.path(), &["--tile", "64", "--columns", "2", "--refine", "0"]);
        run_sheet(&args).expect("a sheet");
        let png = fs::read(&args.output).expect("a picture");
        assert!(png.starts_with(b"\x89PNG"));
        // Two models side by side, each of three tiles with room around, and the key.
        let side = |at: usize| u32::from_be_bytes([png[at], png[at + 1], png[at + 2], png[at + 3]]);
        assert_eq!((side(16), side(20)), (2 * (3 * 64 + 8), 64 + LABEL + 8 + LABEL));
        run_sheet(&args).expect("a sheet");
        assert!(
            fs::read(&args.output).expect("a picture") == png,
            "the same bytes again"
        );
    }

    #[test]
    fn a_folder_without_models_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        assert!(matches!(
            run_sheet(&args(folder.path(), &[])),
            Err(LoadtestFailure::Usage(_))
        ));
        assert!(matches!(
            run_sheet(&args(&folder.path().join("none"), &[])),
            Err(LoadtestFailure::Usage(_))
        ));
    }
}

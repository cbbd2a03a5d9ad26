//! The command: servers side by side, and turns.

use super::args::CommitsArgs;
use super::measured_place::MeasuredPlace;
use super::report::{json_report, text_report};
use crate::failure::LoadtestFailure;
use crate::shared::drag_scene::DragScene;
use pliant::session::store::StoreLocation;

/// Turns that every server has.
const TURNS: u32 = 10;

/// Runs `loadtest commits`.
pub(crate) fn run_commits(args: &CommitsArgs) -> Result<(), LoadtestFailure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(|e| LoadtestFailure::Server(format!("cannot start threads: {e}")))?;
    runtime.block_on(measure(args))
}

async fn measure(args: &CommitsArgs) -> Result<(), LoadtestFailure> {
    let scene = DragScene::load(args.model.as_deref())?;
    let temporary = tempfile::tempdir().map_err(|e| LoadtestFailure::Server(format!("no temporary folder: {e}")))?;
    let folder = args.data_dir.clone().unwrap_or_else(|| temporary.path().to_owned());
    let mut locations = vec![
        ("memory", None),
        ("SQLite", Some(StoreLocation::in_folder(folder.join("sqlite")))),
    ];
    if let Some(url) = &args.database {
        let location = StoreLocation {
            database: Some(url.clone()),
            ..StoreLocation::in_folder(folder.join("postgres"))
        };
        locations.push(("PostgreSQL", Some(location)));
    }
    let mut places = Vec::new();
    for (name, location) in locations {
        places.push(MeasuredPlace::start(name, location, &scene, args.clients).await?);
    }
    let turn = args.commits.div_ceil(TURNS);
    // The first turn warms up, and is not counted.
    for round in 0..=TURNS {
        for place in &mut places {
            place.commit(&scene, turn, round > 0).await?;
            place.drag(&scene, turn, round > 0).await?;
        }
    }
    let mut rows = Vec::new();
    for place in places {
        rows.push(place.finish().await?);
    }
    match args.json {
        true => println!("{}", json_report(&rows, &scene, args)),
        false => print!("{}", text_report(&rows, &scene, args)),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn every_place_has_its_row_and_all_commits_are_counted() {
        let scene = DragScene::load(None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let mut rows = Vec::new();
        for (name, location) in [
            ("memory", None),
            ("SQLite", Some(StoreLocation::in_folder(folder.path()))),
        ] {
            let mut place = MeasuredPlace::start(name, location, &scene, 2).await.unwrap();
            place.commit(&scene, 3, false).await.unwrap();
            place.commit(&scene, 3, true).await.unwrap();
            place.drag(&scene, 4, true).await.unwrap();
            rows.push(place.finish().await.unwrap());
        }
        for row in &rows {
            assert_eq!((row.commits.len(), row.drags.len()), (6, 4));
            assert!(row.commits.iter().all(|c| c.solve_ms <= c.total_ms));
        }
        let args = CommitsArgs {
            model: None,
            commits: 10,
            clients: 2,
            data_dir: None,
            database: None,
            json: false,
        };
        let text = text_report(&rows, &scene, &args);
        assert!(text.contains("memory") && text.contains("SQLite"), "{text}");
        let json = json_report(&rows, &scene, &args);
        assert_eq!(json["places"][1]["commits"], 6);
    }
}

//! Row 7: the same bits for any number of threads and any range, and after a run that was killed.

use super::ballet::{BALLET, RATE};
use super::stage::{MotionFigure, MotionFolders, figure, solve};
use crate::failure::LoadtestFailure;
use crate::measurements::time_once;
use pliant::engine::digest;
use pliant::pool::Pool;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Frames of the whole, and the range that is solved alone.
const WHOLE: usize = 200;
const PART: Range<usize> = 64..128;
/// Frames of the run that is killed, and how many of them it must have written before.
const KILLED: usize = 80;
const BEFORE: u64 = 8;

/// Row 7.
pub(super) fn measure_equality(folders: &MotionFolders<'_>, most: usize) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let digests = |threads: usize, range: &dyn Fn(usize) -> Range<usize>| -> Result<Vec<String>, LoadtestFailure> {
        let pool = Pool::new(threads)?;
        let stage = folders.stage(BALLET, 0, &pool)?;
        let times = stage.times(RATE, usize::MAX);
        let animation = stage.animation(times, None, &pool)?;
        let mut all = Vec::new();
        let range = range(times.count);
        solve(&animation, range, &pool, &mut |frame| {
            all.push(digest(&frame.positions))
        })?;
        Ok(all)
    };
    let whole = |count: usize| 0..count.min(WHOLE).min(most);
    let one = digests(1, &whole)?;
    let two = digests(2, &whole)?;
    let differ = |a: &[String], b: &[String]| a.iter().zip(b).filter(|(a, b)| a != b).count() as f64;
    let mut figures = vec![
        figure(
            7,
            format!("1 and 2 threads, 0:{}: frames that differ", one.len()),
            differ(&one, &two),
            "",
        )
        .at_most(0.0, None),
    ];
    if one.len() > PART.start {
        let part = digests(2, &|count| PART.start..PART.end.min(count).min(one.len()))?;
        let off = differ(&part, &one[PART.start..]);
        figures.push(figure(7, "64:64 alone: frames that differ", off, "").at_most(0.0, None));
    }
    if let Some(off) = killed_run(folders)? {
        figures.push(figure(7, "killed and resumed: files that differ", off, "").at_most(0.0, None));
    }
    Ok(figures)
}

/// Kills a run of the command line beside this program, resumes it, and compares; `None` where there is no such program.
fn killed_run(folders: &MotionFolders<'_>) -> Result<Option<f64>, LoadtestFailure> {
    let own = std::env::current_exe()?;
    let pliant = own.with_file_name("pliant");
    if !pliant.is_file() {
        eprintln!(
            "row 7: {} is not there, so no run is killed; cargo build --release makes it",
            pliant.display()
        );
        return Ok(None);
    }
    let folder = std::env::temp_dir().join(format!("pliant-motion-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let compared = compare_killed(folders, &pliant, &folder);
    // What stays costs room, and nothing else.
    let _ = std::fs::remove_dir_all(&folder);
    compared.map(|is_same| Some(f64::from(u8::from(!is_same))))
}

fn compare_killed(folders: &MotionFolders<'_>, pliant: &Path, folder: &Path) -> Result<bool, LoadtestFailure> {
    let [model, rig, clip] = BALLET;
    let paths: [PathBuf; 3] = [
        folders.data.join("meshes").join(model),
        folders.data.join("bvh").join(clip),
        folders.rigs.join(rig),
    ];
    let command = |name: &str, more: &[&str]| {
        let mut command = Command::new(pliant);
        command
            .arg("animate")
            .arg(&paths[0])
            .arg("--bvh")
            .arg(&paths[1])
            .arg("--rig")
            .arg(&paths[2]);
        command
            .args(["--fps", "30", "--frames", &format!("0:{KILLED}"), "-o"])
            .arg(folder.join(name))
            .args(more);
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command
    };
    let succeeded = |mut command: Command| -> Result<(), LoadtestFailure> {
        let status = command.status()?;
        status
            .success()
            .then_some(())
            .ok_or_else(|| LoadtestFailure::Server(format!("{command:?} ended with {status}")))
    };
    succeeded(command("whole.pc2", &[]))?;
    let whole = std::fs::read(folder.join("whole.pc2"))?;
    let frame = whole.len() as u64 / KILLED as u64;
    let mut run = command("killed.pc2", &[]).spawn()?;
    let part = folder.join("killed.pc2.part");
    let begun = Instant::now();
    while std::fs::metadata(&part).map_or(0, |m| m.len()) < BEFORE * frame {
        if run.try_wait()?.is_some() || begun.elapsed() > Duration::from_secs(600) {
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    run.kill()?;
    run.wait()?;
    if folder.join("killed.pc2").exists() {
        return Err(LoadtestFailure::Server(
            "row 7: the run ended before it was killed".into(),
        ));
    }
    succeeded(command("killed.pc2", &["--resume"]))?;
    Ok(std::fs::read(folder.join("killed.pc2"))? == whole)
}

/// Frames that are timed at the paper's size, after one that is not: a first frame has no other to go on from.
const LARGE_FRAMES: usize = 8;

/// Row 5: the dance on two threads.
pub(super) fn measure_rates(folders: &MotionFolders<'_>, most: usize) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let pool = Pool::new(2)?;
    let stage = folders.stage(BALLET, 0, &pool)?;
    let times = stage.times(RATE, most);
    let mut figures = Vec::new();
    for (refinement, what, bounds) in [
        (None, "two threads, carried: frames a second", (8.0, 15.0)),
        (Some(0), "two threads, refine 0: frames a second", (15.0, 25.0)),
    ] {
        let animation = stage.animation(times, refinement, &pool)?;
        let (solved, seconds) = time_once(|| solve(&animation, 0..times.count, &pool, &mut |_| {}));
        solved?;
        figures.push(figure(5, what, times.count as f64 / seconds, "").at_least(bounds.0, bounds.1));
    }
    Ok(figures)
}

/// Row 6: the armadillo with four times its triangles, on one thread.
pub(super) fn measure_large(folders: &MotionFolders<'_>) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let pool = Pool::new(1)?;
    let stage = folders.stage(BALLET, 1, &pool)?;
    let times = stage.times(RATE, LARGE_FRAMES + 1);
    let (animation, prepared) = time_once(|| stage.animation(times, Some(0), &pool));
    let animation = animation?;
    let clock = std::time::Instant::now();
    let mut ends = Vec::new();
    solve(&animation, 0..times.count, &pool, &mut |_| {
        ends.push(clock.elapsed().as_secs_f64())
    })?;
    let seconds = match ends[..] {
        [first, .., last] => (last - first) / (ends.len() - 1) as f64,
        _ => clock.elapsed().as_secs_f64(),
    };
    let nodes = stage.deformer.body().nodes();
    Ok(vec![
        figure(
            6,
            format!("{nodes} nodes, 1 thread, refine 0: seconds a frame"),
            seconds,
            " s",
        )
        .at_most(0.6, 0.3),
        figure(6, "handles and fields, once", prepared, " s"),
    ])
}

//! Where reports and goldens go, looked at before any case is run.

use super::suite::LoadedSuite;
use crate::cli::failure::CliFailure;
use crate::cli::input_files::folder_of;
use crate::cli::model_files::read_model;
use crate::cli::output_files::{OutputPermission, is_same_target, spare_companions};
use std::path::{Path, PathBuf};

/// Refuses reports that would replace a file of the suite or each other, and places where nothing can be written. Each report has the
/// name of its option; `blesses` says that goldens are to be written too.
///
/// # Errors
/// Which path cannot be written, and why.
pub(super) fn check_targets(
    reports: &[(&str, &Path)],
    suite: &LoadedSuite,
    permission: OutputPermission,
    blesses: bool,
) -> Result<(), CliFailure> {
    for (k, (option, path)) in reports.iter().enumerate() {
        let refuse = |problem: String| {
            let text = format!("{option}: cannot write {}: {problem}", path.display());
            Err(CliFailure::Input(text))
        };
        if let Some((other, _)) = reports[..k].iter().find(|(_, there)| is_same_target(there, path)) {
            return refuse(format!("{other} names it too; each report needs a file of its own"));
        }
        let goldens = suite.cases.iter().map(|case| case.golden_path.as_path());
        let mut files = suite.files.iter().map(PathBuf::as_path).chain(goldens);
        if files.any(|file| is_same_target(file, path)) {
            return refuse("it is a file of the suite, which no report replaces; name another file".into());
        }
        spare_models(path, &suite.models).map_err(|e| e.in_place(option))?;
    }
    for (_, path) in reports {
        permission.try_target(path)?;
    }
    if blesses {
        let goldens = permission.for_goldens();
        (suite.cases.iter()).try_for_each(|case| goldens.try_target(&case.golden_path))?;
    }
    Ok(())
}

/// Refuses a report that would replace a file that a model names beside itself.
fn spare_models(report: &Path, models: &[PathBuf]) -> Result<(), CliFailure> {
    // Only a file that is there can be one, and those of a model lie below its folder: no other model is read for it.
    let Ok(report) = report.canonicalize() else {
        return Ok(());
    };
    for model in models {
        let folder = folder_of(model).canonicalize();
        if !folder.is_ok_and(|folder| report.starts_with(folder)) {
            continue;
        }
        // A model that cannot be read is told by its case.
        if let Ok(files) = read_model(model) {
            spare_companions(&report, model, &files)?;
        }
    }
    Ok(())
}

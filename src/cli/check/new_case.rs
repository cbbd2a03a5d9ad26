//! `pliant check --new`: the file of a case, from a model and a job.

use super::super::output_files::OutputPermission;
use super::super::terminal::{CliFailure, say};
use crate::check::{CASE_SUFFIX, SuiteCase};
use clap::Args;
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};

/// The case that a suite gets.
#[derive(Debug, Args)]
pub(super) struct NewCaseArgs {
    /// Start this case: write NAME.case.json, run it, and store its result as its golden
    #[arg(
        long,
        value_name = "NAME",
        requires_all = ["model", "job"],
        conflicts_with_all = ["chosen", "shard", "merge", "server", "bless"]
    )]
    pub new: Option<String>,
    /// Model of the new case: a file below the suite's folder, data:PATH or sample:creature
    #[arg(long, value_name = "MODEL", requires = "new")]
    model: Option<String>,
    /// Job of the new case: a JSON file below the suite's folder
    #[arg(long, value_name = "FILE", requires = "new")]
    job: Option<String>,
}

impl NewCaseArgs {
    /// Writes the file of the case into a suite; its place. Nothing is replaced, and nothing is written where something is wrong.
    ///
    /// # Errors
    /// Which argument is wrong, and what is allowed.
    pub(super) fn write(&self, suite: &Path, name: &str) -> Result<PathBuf, CliFailure> {
        let [model, job] = [&self.model, &self.job].map(|text| text.as_deref().unwrap_or_default());
        let model = match model.starts_with("data:") || model.starts_with("sample:") {
            true => model.to_owned(),
            false => place_below(suite, model, "--model")?,
        };
        let case = json!({"title": "", "model": model, "job": place_below(suite, job, "--job")?});
        let text = format!("{case:#}\n");
        let file = format!("{name}{CASE_SUFFIX}");
        SuiteCase::from_file(&file, text.as_bytes()).map_err(|e| CliFailure::Input(format!("--new: {e}")))?;
        let path = suite.join(file);
        if path.symlink_metadata().is_ok() {
            let problem = "is there already; --bless --case stores its result";
            return Err(CliFailure::Input(format!("--new: the case \"{name}\" {problem}")));
        }
        OutputPermission::default().write_file(&path, text.as_bytes())?;
        Ok(path)
    }
}

/// A file as a case names it: by its path below the suite's folder, from which or from the working folder it is given.
fn place_below(suite: &Path, given: &str, flag: &str) -> Result<String, CliFailure> {
    if suite.join(given).is_file() && !Path::new(given).is_absolute() {
        return Ok(given.to_owned());
    }
    let refuse = |problem: &str| CliFailure::Input(format!("{flag}: {given} {problem}"));
    let [file, folder] = [fs::canonicalize(given), fs::canonicalize(suite)];
    let (Ok(file), Ok(folder)) = (file, folder) else {
        return Err(refuse(&format!(
            "is neither below {} nor a file of the working folder",
            suite.display()
        )));
    };
    let below = file.strip_prefix(&folder).ok().and_then(Path::to_str);
    let below = below.ok_or_else(|| refuse(&format!("is not below {}; copy it there first", suite.display())))?;
    Ok(below.to_owned())
}

/// Takes the file of a case back whose run failed.
pub(super) fn take_back(path: &Path) {
    match fs::remove_file(path) {
        Ok(()) => say!("{} is taken back", path.display()),
        Err(e) => say!("{} cannot be taken back: {e}", path.display()),
    }
}

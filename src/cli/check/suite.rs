//! A suite from disk: its cases with their jobs and goldens. Models are read when a case is run.

use crate::asset::{FileSet, sample};
use crate::check::{CASE_SUFFIX, Case, GOLDEN_SUFFIX, Golden, JobSource, Source};
use crate::cli::Failure;
use crate::cli::files::{read, read_model};
use crate::cli::job::{read_job, read_merged};
use crate::job::pb;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// A case ready to be run.
pub(super) struct Loaded {
    /// What its file says.
    pub case: Case,
    /// Its job, with the models that it merges.
    pub job: pb::Job,
    /// What its golden holds, or why that cannot be read; `None` without a golden.
    pub golden: Option<Result<Golden, String>>,
    /// Where its golden lies, or would.
    pub golden_path: PathBuf,
    model: Model,
}

enum Model {
    Sample,
    File(PathBuf),
    /// A file of the shared data that is not here, and why.
    Absent(String),
}

/// Reads a suite. `data` is the folder of shared data. Cases come in the order of their names.
///
/// # Errors
/// What is wrong with the suite, where, and what is allowed.
pub(super) fn load(suite: &Path, data: Option<&Path>) -> Result<Vec<Loaded>, Failure> {
    let unreadable = |e: std::io::Error| Failure::Input(format!("cannot read the suite {}: {e}", suite.display()));
    let mut cases = BTreeSet::new();
    let mut goldens = BTreeSet::new();
    for entry in fs::read_dir(suite).map_err(unreadable)? {
        let name = entry.map_err(unreadable)?.file_name().to_string_lossy().into_owned();
        if name.ends_with(CASE_SUFFIX) {
            cases.insert(name);
        } else if let Some(of) = name.strip_suffix(GOLDEN_SUFFIX) {
            goldens.insert(of.to_owned());
        }
    }
    if cases.is_empty() {
        let problem = format!("holds no case; a case is a file whose name ends with {CASE_SUFFIX}");
        return Err(Failure::Input(format!("the suite {} {problem}", suite.display())));
    }
    let loaded = cases.iter().map(|file| load_case(suite, file, data));
    let loaded: Vec<Loaded> = loaded.collect::<Result<_, _>>()?;
    if let Some(lost) = goldens.iter().find(|g| loaded.iter().all(|l| l.case.name != **g)) {
        let path = suite.join(format!("{lost}{GOLDEN_SUFFIX}"));
        let problem = "is a golden without a case; delete it, or bring back its case";
        return Err(Failure::Input(format!("{} {problem}", path.display())));
    }
    Ok(loaded)
}

fn load_case(suite: &Path, file: &str, data: Option<&Path>) -> Result<Loaded, Failure> {
    let path = suite.join(file);
    let in_suite = |e: crate::check::SuiteError| Failure::Input(format!("{}: {}", path.display(), e.problem));
    let in_case = |e: Failure| match e {
        Failure::Input(text) => Failure::Input(format!("{}: {text}", path.display())),
        other => other,
    };
    let case = Case::read(file, &read(&path)?).map_err(in_suite)?;
    let job = match &case.job {
        JobSource::Inline(job) => {
            let mut job = job.as_ref().clone();
            read_merged(&mut job, &path).map_err(in_case)?;
            job
        }
        JobSource::File(name) => read_job(&suite.join(name)).map_err(in_case)?,
    };
    let model = match &case.model {
        Source::Sample => Model::Sample,
        Source::Suite(name) => {
            let model = suite.join(name);
            if !model.is_file() {
                let problem = format!("{}: model: there is no file {}", path.display(), model.display());
                return Err(Failure::Input(problem));
            }
            Model::File(model)
        }
        Source::Data(name) => match data.map(|d| d.join(name)) {
            None => Model::Absent(format!("data:{name} is absent: PLIANT_DATA names no folder")),
            Some(path) if path.is_file() => Model::File(path),
            Some(_) => Model::Absent(format!("data:{name} is absent from the folder of PLIANT_DATA")),
        },
    };
    let golden_path = suite.join(case.golden_file());
    let golden = match golden_path.is_file() {
        true => {
            let read = Golden::read(&case.golden_file(), &read(&golden_path)?);
            Some(read.map_err(|e| e.to_string()))
        }
        false => None,
    };
    Ok(Loaded {
        case,
        job,
        golden,
        golden_path,
        model,
    })
}

impl Loaded {
    /// Why the case cannot be run here; `None` when it can.
    pub fn absent(&self) -> Option<&str> {
        match &self.model {
            Model::Absent(why) => Some(why),
            _ => None,
        }
    }

    /// Its model's files.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn files(&self) -> Result<FileSet, String> {
        match &self.model {
            Model::Sample => Ok(FileSet::single("creature.glb", sample::creature_glb())),
            Model::File(path) => read_model(path).map_err(|e| e.text().to_owned()),
            Model::Absent(why) => Err(why.clone()),
        }
    }
}

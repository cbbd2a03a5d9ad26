//! A suite from disk: its cases with their jobs and goldens. Models are read when a case is run.

use crate::asset::{FileSet, sample};
use crate::check::{CASE_SUFFIX, Case, GOLDEN_SUFFIX, Golden, JobSource, Source};
use crate::cli::Failure;
use crate::cli::files::{read, read_model};
use crate::cli::job::{read_job, read_merged};
use crate::wire::pb;
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

/// A suite ready to be run.
pub(super) struct Suite {
    /// In the order of their names.
    pub cases: Vec<Loaded>,
    /// What someone should know of its folder.
    pub notes: Vec<String>,
}

enum Model {
    Sample,
    File(PathBuf),
    /// A file of the shared data that is not here, and why.
    Absent(String),
}

/// Reads a suite. `data` is the folder of shared data.
///
/// # Errors
/// What is wrong with the suite, where, and what is allowed.
pub(super) fn load(suite: &Path, data: Option<&Path>) -> Result<Suite, Failure> {
    let unreadable = |e: std::io::Error| Failure::Input(format!("cannot read the suite {}: {e}", suite.display()));
    let mut cases = BTreeSet::new();
    let mut goldens = BTreeSet::new();
    let mut deeper = BTreeSet::new();
    for entry in fs::read_dir(suite).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.ends_with(CASE_SUFFIX) {
            cases.insert(name);
        } else if name.to_ascii_lowercase().ends_with(CASE_SUFFIX) {
            let path = entry.path();
            let problem = format!("is no name of a case; one ends with {CASE_SUFFIX}, in small letters");
            return Err(Failure::Input(format!("{} {problem}", path.display())));
        } else if let Some(of) = name.strip_suffix(GOLDEN_SUFFIX) {
            goldens.insert(of.to_owned());
        } else if entry.file_type().is_ok_and(|t| t.is_dir()) {
            deeper.extend(cases_in(&entry.path()).into_iter().map(|case| format!("{name}/{case}")));
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
    let notes = deeper.first().map(|first| {
        let many = deeper.len();
        format!("cases in folders of the suite are not run, {many} are there, the first is {first}")
    });
    Ok(Suite {
        cases: loaded,
        notes: notes.into_iter().collect(),
    })
}

/// Names of cases in a folder; none in one that cannot be read.
fn cases_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|e| e.file_name().to_string_lossy().into_owned());
    names.filter(|name| name.ends_with(CASE_SUFFIX)).collect()
}

/// Refuses what is there and is neither a file nor a link to one: reading a pipe may never end.
fn need_file(path: &Path) -> Result<(), Failure> {
    match fs::metadata(path) {
        Ok(facts) if !facts.is_file() => {
            let what = if facts.is_dir() { "a folder" } else { "no regular file" };
            Err(Failure::Input(format!(
                "{} is {what}, a file is needed",
                path.display()
            )))
        }
        // What cannot be opened is told by who reads it.
        _ => Ok(()),
    }
}

fn load_case(suite: &Path, file: &str, data: Option<&Path>) -> Result<Loaded, Failure> {
    let path = suite.join(file);
    let in_suite = |e: crate::check::SuiteError| Failure::Input(format!("{}: {}", path.display(), e.problem));
    let in_case = |e: Failure| match e {
        Failure::Input(text) => Failure::Input(format!("{}: {text}", path.display())),
        other => other,
    };
    let in_model = |e: Failure| match e {
        Failure::Input(text) => in_case(Failure::Input(format!("model: {text}"))),
        other => other,
    };
    need_file(&path)?;
    let case = Case::read(file, &read(&path)?).map_err(in_suite)?;
    let job = match &case.job {
        JobSource::Inline(job) => {
            let mut job = job.as_ref().clone();
            read_merged(&mut job, &path).map_err(in_case)?;
            job
        }
        JobSource::File(name) => {
            let file = suite.join(name);
            need_file(&file).map_err(in_case)?;
            let job = read_job(&file).map_err(in_case)?;
            let checked = job.expect.as_ref().map_or(Ok(()), |expect| expect.check("expect"));
            checked.map_err(|e| in_case(Failure::Input(format!("{}: {e}", file.display()))))?;
            job
        }
    };
    let model = match &case.model {
        Source::Sample => Model::Sample,
        Source::Suite(name) => {
            let model = suite.join(name);
            need_file(&model).map_err(in_model)?;
            if !model.is_file() {
                return Err(in_model(Failure::Input(format!(
                    "there is no file {}",
                    model.display()
                ))));
            }
            Model::File(model)
        }
        Source::Data(name) => match data {
            None => Model::Absent(format!("data:{name} is absent: PLIANT_DATA names no folder")),
            // A folder that was named and is not there is a slip, not data that this machine does not have.
            Some(data) if !data.is_dir() => {
                let problem = format!("--data (or PLIANT_DATA) is {}, which is no folder", data.display());
                return Err(in_model(Failure::Input(problem)));
            }
            Some(data) => {
                let model = data.join(name);
                need_file(&model).map_err(in_model)?;
                match model.is_file() {
                    true => Model::File(model),
                    false => Model::Absent(format!("data:{name} is absent from the folder of PLIANT_DATA")),
                }
            }
        },
    };
    let golden_path = suite.join(case.golden_file());
    need_file(&golden_path)?;
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

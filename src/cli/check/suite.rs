//! A suite from disk: its cases with their jobs and goldens. Models are read when a case is run.

use crate::asset::{FileSet, sample};
use crate::check::{AnimationCase, CASE_SUFFIX, GOLDEN_SUFFIX, Golden, JobSource, ModelSource, SuiteCase, job_hash};
use crate::cli::failure::CliFailure;
use crate::cli::job_file::{read_job, read_merged_models};
use crate::cli::model_files::{read_file, read_model};
use crate::wire::pb;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// A loaded case is ready to be run.
pub(super) struct LoadedCase {
    /// What its file says.
    pub case: SuiteCase,
    /// Its job, with the models that it merges; an empty one of an animation.
    pub job: pb::Job,
    /// Its animation, with the bytes of its clip.
    pub animation: Option<AnimationCase>,
    /// What its golden holds, or why that cannot be read; `None` without a golden.
    pub golden: Option<Result<Golden, String>>,
    /// Where its golden lies, or would.
    pub golden_path: PathBuf,
    model: CaseModel,
}

/// A loaded suite is ready to be run.
pub(super) struct LoadedSuite {
    /// In the order of their names.
    pub cases: Vec<LoadedCase>,
    /// What someone should know of its folder.
    pub notes: Vec<String>,
}

enum CaseModel {
    Sample,
    File(PathBuf),
    /// A file of the shared data that is not here, and why.
    Absent(String),
}

/// Reads a suite. `data` is the folder of shared data.
///
/// # Errors
/// What is wrong with the suite, where, and what is allowed.
pub(super) fn load_suite(suite: &Path, data: Option<&Path>) -> Result<LoadedSuite, CliFailure> {
    let unreadable = |e: std::io::Error| CliFailure::Input(format!("cannot read the suite {}: {e}", suite.display()));
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
            return Err(CliFailure::Input(format!("{} {problem}", path.display())));
        } else if let Some(of) = name.strip_suffix(GOLDEN_SUFFIX) {
            goldens.insert(of.to_owned());
        } else if entry.file_type().is_ok_and(|t| t.is_dir()) {
            deeper.extend(
                case_names_in(&entry.path())
                    .into_iter()
                    .map(|case| format!("{name}/{case}")),
            );
        }
    }
    if cases.is_empty() {
        let problem = format!("holds no case; a case is a file whose name ends with {CASE_SUFFIX}");
        return Err(CliFailure::Input(format!("the suite {} {problem}", suite.display())));
    }
    let loaded = cases.iter().map(|file| load_case(suite, file, data));
    let loaded: Vec<LoadedCase> = loaded.collect::<Result<_, _>>()?;
    if let Some(lost) = goldens.iter().find(|g| loaded.iter().all(|l| l.case.name != **g)) {
        let path = suite.join(format!("{lost}{GOLDEN_SUFFIX}"));
        let problem = "is a golden without a case; delete it, or bring back its case";
        return Err(CliFailure::Input(format!("{} {problem}", path.display())));
    }
    let notes = deeper.first().map(|first| {
        let many = deeper.len();
        format!("cases in folders of the suite are not run, {many} are there, the first is {first}")
    });
    Ok(LoadedSuite {
        cases: loaded,
        notes: notes.into_iter().collect(),
    })
}

/// Lists the names of cases in a folder; none in one that cannot be read.
fn case_names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|e| e.file_name().to_string_lossy().into_owned());
    names.filter(|name| name.ends_with(CASE_SUFFIX)).collect()
}

/// Refuses what is there and is neither a file nor a link to one: reading a pipe may never end.
fn need_regular_file(path: &Path) -> Result<(), CliFailure> {
    match fs::metadata(path) {
        Ok(facts) if !facts.is_file() => {
            let what = if facts.is_dir() { "a folder" } else { "no regular file" };
            Err(CliFailure::Input(format!(
                "{} is {what}, a file is needed",
                path.display()
            )))
        }
        // What cannot be opened is told by who reads it.
        _ => Ok(()),
    }
}

fn load_case(suite: &Path, file: &str, data: Option<&Path>) -> Result<LoadedCase, CliFailure> {
    let path = suite.join(file);
    let in_suite = |e: crate::check::SuiteError| CliFailure::Input(format!("{}: {}", path.display(), e.problem));
    let in_case = |e: CliFailure| match e {
        CliFailure::Input(text) => CliFailure::Input(format!("{}: {text}", path.display())),
        other => other,
    };
    let in_model = |e: CliFailure| match e {
        CliFailure::Input(text) => in_case(CliFailure::Input(format!("model: {text}"))),
        other => other,
    };
    need_regular_file(&path)?;
    let case = SuiteCase::from_file(file, &read_file(&path)?).map_err(in_suite)?;
    let job = match &case.job {
        JobSource::Inline(job) => {
            let mut job = job.as_ref().clone();
            read_merged_models(&mut job, &path).map_err(in_case)?;
            job
        }
        JobSource::File(name) => {
            let file = suite.join(name);
            need_regular_file(&file).map_err(in_case)?;
            let job = read_job(&file).map_err(in_case)?;
            let checked = job.expect.as_ref().map_or(Ok(()), |expect| expect.check("expect"));
            checked.map_err(|e| in_case(CliFailure::Input(format!("{}: {e}", file.display()))))?;
            job
        }
        JobSource::Animation(_) => pb::Job::default(),
    };
    let animation = match &case.job {
        JobSource::Animation(animation) => Some(load_animation(animation, suite).map_err(in_case)?),
        _ => None,
    };
    let model = match &case.model {
        ModelSource::Sample => CaseModel::Sample,
        ModelSource::Suite(name) => {
            let model = suite.join(name);
            need_regular_file(&model).map_err(in_model)?;
            if !model.is_file() {
                return Err(in_model(CliFailure::Input(format!(
                    "there is no file {}",
                    model.display()
                ))));
            }
            CaseModel::File(model)
        }
        ModelSource::Data(name) => match data {
            None => CaseModel::Absent(format!("data:{name} is absent: PLIANT_DATA names no folder")),
            // A folder that was named and is not there is a slip, not data that this machine does not have.
            Some(data) if !data.is_dir() => {
                let problem = format!("--data (or PLIANT_DATA) is {}, which is no folder", data.display());
                return Err(in_model(CliFailure::Input(problem)));
            }
            Some(data) => {
                let model = data.join(name);
                need_regular_file(&model).map_err(in_model)?;
                match model.is_file() {
                    true => CaseModel::File(model),
                    false => CaseModel::Absent(format!("data:{name} is absent from the folder of PLIANT_DATA")),
                }
            }
        },
    };
    let golden_path = suite.join(case.golden_file());
    need_regular_file(&golden_path)?;
    let golden = match golden_path.is_file() {
        true => {
            let read = Golden::from_file(&case.golden_file(), &read_file(&golden_path)?);
            Some(read.map_err(|e| e.to_string()))
        }
        false => None,
    };
    Ok(LoadedCase {
        case,
        job,
        animation,
        golden,
        golden_path,
        model,
    })
}

/// Reads the clip of an animation into its options.
fn load_animation(animation: &AnimationCase, suite: &Path) -> Result<AnimationCase, CliFailure> {
    let mut animation = animation.clone();
    if let Some(name) = &animation.bvh {
        let file = suite.join(name);
        need_regular_file(&file)?;
        animation.options.source = Some(pb::animate_options::Source::Bvh(read_file(&file)?.into()));
    }
    Ok(animation)
}

impl LoadedCase {
    /// Tells what its result depends on beside the model.
    pub fn job_hash(&self) -> String {
        match &self.animation {
            Some(animation) => animation.input_hash(),
            None => job_hash(&self.job),
        }
    }

    /// Tells why the case cannot be run here; `None` when it can.
    pub fn absent_reason(&self) -> Option<&str> {
        match &self.model {
            CaseModel::Absent(why) => Some(why),
            _ => None,
        }
    }

    /// Reads the files of the case's model.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn model_files(&self) -> Result<FileSet, String> {
        match &self.model {
            CaseModel::Sample => Ok(FileSet::single("creature.glb", sample::creature_glb())),
            CaseModel::File(path) => read_model(path).map_err(|e| e.message().to_owned()),
            CaseModel::Absent(why) => Err(why.clone()),
        }
    }
}

//! A suite from disk: its cases with their jobs and goldens. Models are read when a case is run.

use crate::asset::{FileSet, sample};
use crate::check::{
    AnimationCase, CASE_SUFFIX, CaseWork, GOLDEN_SUFFIX, Golden, JobSource, ModelSource, SuiteCase, digest_texts,
    job_hash,
};
use crate::cli::deform::{job_from_text, largest_named, read_named_models};
use crate::cli::input_files::{AllowedFolders, NamedFiles, UnreadFile, folder_of, with_companions};
use crate::cli::terminal::{CliFailure, listed};
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
    /// Digest of what the suite holds of it: its file, its job with what that names, and its golden; not of its model.
    pub content: String,
    model: CaseModel,
}

/// A loaded suite is ready to be run.
pub(super) struct LoadedSuite {
    /// In the order of their names.
    pub cases: Vec<LoadedCase>,
    /// What someone should know of its folder.
    pub notes: Vec<String>,
    /// The files that it was read from, without links, those of cases that were not chosen too.
    pub files: BTreeSet<PathBuf>,
    /// The models among them, which may have files of their own.
    pub models: Vec<PathBuf>,
}

enum CaseModel {
    Sample,
    File {
        name: String,
        path: PathBuf,
        /// The folders that it may lie in.
        files: NamedFiles,
        /// Bytes of the file, where it is the suite's own.
        bytes: Option<u64>,
    },
    /// A file of the shared data that is not here, and why.
    Absent(String),
}

/// The folders that the files of a suite lie in.
struct SuiteFolders<'a> {
    suite: &'a Path,
    /// What the suite may name.
    files: NamedFiles,
    /// The folder of shared data.
    data: Option<&'a Path>,
    allowed: &'a AllowedFolders,
}

/// Reads a suite, or the cases of it that are `chosen` by name. `data` is the folder of shared data.
///
/// Whatever it names lies below its folder, that of the data, or one that is allowed, once links have been followed.
///
/// # Errors
/// What is wrong with the suite, where, and what is allowed.
pub(super) fn load_suite(
    suite: &Path,
    data: Option<&Path>,
    allowed: &AllowedFolders,
    chosen: &[String],
) -> Result<LoadedSuite, CliFailure> {
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
            let problem = format!("is not the name of a case; one ends with {CASE_SUFFIX}, in small letters");
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
    let folders = SuiteFolders {
        suite,
        files: NamedFiles::new(suite, allowed)?,
        data,
        allowed,
    };
    let wanted = choose_cases(suite, &cases, chosen)?;
    let mut loaded = Vec::with_capacity(wanted.len());
    let mut models = Vec::new();
    for file in &cases {
        // Problems of cases that are not selected are not reported; their files still belong to the suite.
        let case = match (load_case(file, &folders), wanted.contains(file.as_str())) {
            (Ok(case), _) => case,
            (Err(_), false) => continue,
            (Err(e), true) => return Err(e),
        };
        models.extend(case.model_path().map(Path::to_owned));
        if wanted.contains(file.as_str()) {
            loaded.push(case);
        }
    }
    if let Some(lost) = goldens.iter().find(|g| !cases.contains(&format!("{g}{CASE_SUFFIX}"))) {
        let path = suite.join(format!("{lost}{GOLDEN_SUFFIX}"));
        let problem = "is a golden without a case; delete it, or bring back its case";
        return Err(CliFailure::Input(format!("{} {problem}", path.display())));
    }
    let mut notes = Vec::new();
    if loaded.len() < cases.len() {
        notes.push(format!("{} of the suite's {} cases are run", loaded.len(), cases.len()));
    }
    notes.extend(deeper.first().map(|first| {
        let many = deeper.len();
        format!("cases in folders of the suite are not run, {many} are there, the first is {first}")
    }));
    let mut files = folders.files.opened();
    files.extend(models.iter().cloned());
    files.extend(cases.iter().map(|file| suite.join(file)));
    files.extend(
        goldens
            .iter()
            .map(|golden| suite.join(format!("{golden}{GOLDEN_SUFFIX}"))),
    );
    Ok(LoadedSuite {
        files,
        models,
        cases: loaded,
        notes,
    })
}

/// Lists the names of cases in a folder; none in one that cannot be read.
fn case_names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|e| e.file_name().to_string_lossy().into_owned());
    names.filter(|name| name.ends_with(CASE_SUFFIX)).collect()
}

fn load_case(file: &str, folders: &SuiteFolders<'_>) -> Result<LoadedCase, CliFailure> {
    let SuiteFolders { suite, files, .. } = folders;
    let path = suite.join(file);
    let in_suite = |e: crate::check::SuiteError| CliFailure::Input(format!("{}: {}", path.display(), e.problem));
    let in_case = |e: CliFailure| e.in_place(path.display());
    let text = files.read_named(file, largest_named())?;
    let case = SuiteCase::from_file(file, &text).map_err(in_suite)?;
    let job = match &case.job {
        JobSource::Inline(job) => {
            let mut job = job.as_ref().clone();
            read_named_models(&mut job, "job.", files).map_err(in_case)?;
            job
        }
        JobSource::File(name) => {
            let file = suite.join(name);
            let read = files.read_named(name, largest_named()).map_err(CliFailure::from);
            let read = read.and_then(|text| job_from_text(&text, &file, &files.beginning_in(folder_of(&file))));
            let job = read.map_err(in_case)?;
            let checked = job.expect.as_ref().map_or(Ok(()), |expect| expect.check("expect"));
            checked.map_err(|e| in_case(CliFailure::Input(format!("{}: {e}", file.display()))))?;
            job
        }
        JobSource::Animation(_) => pb::Job::default(),
    };
    let animation = match &case.job {
        JobSource::Animation(animation) => Some(load_animation(animation, files).map_err(in_case)?),
        _ => None,
    };
    let model = find_model(&case.model, folders).map_err(|e| in_case(e.in_place("model")))?;
    let stored = match files.read_named(&case.golden_file(), largest_named()) {
        Ok(text) => Some(text),
        Err(UnreadFile::Absent { .. }) => None,
        Err(e) => return Err(e.into()),
    };
    let golden = stored.as_ref().map(|text| Golden::from_file(&case.golden_file(), text));
    let golden = golden.map(|golden| golden.map_err(|e| e.to_string()));
    let hash = hash_of(&job, animation.as_ref());
    let parts = [Some(text.as_slice()), Some(hash.as_bytes()), stored.as_deref()];
    Ok(LoadedCase {
        golden_path: suite.join(case.golden_file()),
        content: digest_texts(parts.into_iter().flatten()),
        case,
        job,
        animation,
        golden,
        model,
    })
}

/// Hashes what a result depends on beside the model.
fn hash_of(job: &pb::Job, animation: Option<&AnimationCase>) -> String {
    match animation {
        Some(animation) => animation.input_hash(),
        None => job_hash(job),
    }
}

/// Finds a case's model and opens it once: a missing file fails before any case runs.
fn find_model(model: &ModelSource, folders: &SuiteFolders<'_>) -> Result<CaseModel, CliFailure> {
    let absent = |name: &str, why: &str| Ok(CaseModel::Absent(format!("data:{name} is absent{why}")));
    let (name, folder, files) = match (model, folders.data) {
        (ModelSource::Sample, _) => return Ok(CaseModel::Sample),
        (ModelSource::Suite(name), _) => (name, folders.suite, folders.files.clone()),
        (ModelSource::Data(name), None) => return absent(name, ": PLIANT_DATA names no folder"),
        // A folder that was named and is not there is a slip, not data that this machine does not have.
        (ModelSource::Data(_), Some(data)) if !data.is_dir() => {
            let problem = format!("--data (or PLIANT_DATA) is {}, which is not a folder", data.display());
            return Err(CliFailure::Input(problem));
        }
        (ModelSource::Data(name), Some(data)) => (name, data, NamedFiles::new(data, folders.allowed)?),
    };
    let is_own = matches!(model, ModelSource::Suite(_));
    let path = folder.join(name);
    match files.open_named(name, largest_named()) {
        Ok(file) => Ok(CaseModel::File {
            bytes: file.metadata().map(|facts| facts.len()).ok().filter(|_| is_own),
            name: name.clone(),
            path,
            files,
        }),
        Err(UnreadFile::Absent { .. }) if is_own => {
            Err(CliFailure::Input(format!("there is no file {}", path.display())))
        }
        Err(UnreadFile::Absent { .. }) => absent(name, " from the folder of PLIANT_DATA"),
        Err(e) => Err(e.into()),
    }
}

/// Reads the clip of an animation into its options.
fn load_animation(animation: &AnimationCase, files: &NamedFiles) -> Result<AnimationCase, CliFailure> {
    let mut animation = animation.clone();
    if let Some(name) = &animation.bvh {
        let clip = files.read_named(name, largest_named());
        let clip = clip.map_err(|e| CliFailure::from(e).in_place("animate.bvh"))?;
        animation.options.source = Some(pb::animate_options::Source::Bvh(clip.into()));
    }
    Ok(animation)
}

impl LoadedCase {
    /// Hashes what its result depends on beside the model.
    pub fn job_hash(&self) -> String {
        hash_of(&self.job, self.animation.as_ref())
    }

    /// Returns what is known of its work, from the suite alone: other files, which some machines lack, do not count.
    pub fn work(&self) -> CaseWork<'_> {
        let frames = |animation: &AnimationCase| Some(animation.options.count as usize).filter(|n| *n > 0);
        CaseWork {
            golden: self.golden.as_ref().and_then(|g| g.as_ref().ok()),
            model_bytes: match &self.model {
                CaseModel::File { bytes, .. } => *bytes,
                _ => None,
            },
            rounds: match &self.animation {
                Some(animation) => frames(animation),
                None => Some(self.job.steps.len().max(1)),
            },
        }
    }

    /// Why the case cannot be run here; `None` when it can.
    pub fn absent_reason(&self) -> Option<&str> {
        match &self.model {
            CaseModel::Absent(why) => Some(why),
            _ => None,
        }
    }

    /// Where the case's model lies; `None` without a file.
    fn model_path(&self) -> Option<&Path> {
        match &self.model {
            CaseModel::File { path, .. } => Some(path),
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
            CaseModel::File { name, path, files, .. } => {
                let read = files.read_named(name, largest_named()).map_err(CliFailure::from);
                let read = read.and_then(|main| with_companions(path, main));
                read.map_err(|e| e.message().to_owned())
            }
            CaseModel::Absent(why) => Err(why.clone()),
        }
    }
}

/// Which of the case files are chosen by names, in which `*` stands for any letters; all of them where there are none.
///
/// # Errors
/// A name that no case has, with those that there are.
pub(super) fn choose_cases<'a>(
    suite: &Path,
    files: &'a BTreeSet<String>,
    names: &[String],
) -> Result<BTreeSet<&'a str>, CliFailure> {
    if names.is_empty() {
        return Ok(files.iter().map(String::as_str).collect());
    }
    let mut chosen = BTreeSet::new();
    for name in names {
        let fitting = files.iter().filter(|file| fits(name, case_name(file)));
        let fitting: Vec<&str> = fitting.map(String::as_str).collect();
        if fitting.is_empty() {
            let there = listed(files.iter().map(|file| case_name(file)), "");
            let problem = format!("no case of the suite {} is named so; {there}", suite.display());
            return Err(CliFailure::Input(format!("--case {name}: {problem}")));
        }
        chosen.extend(fitting);
    }
    Ok(chosen)
}

/// The name of the case in a file.
fn case_name(file: &str) -> &str {
    file.strip_suffix(CASE_SUFFIX).unwrap_or(file)
}

/// Whether a name fits a pattern, in which `*` stands for any letters, none too.
fn fits(pattern: &str, name: &str) -> bool {
    let Some((first, rest)) = pattern.split_once('*') else {
        return pattern == name;
    };
    let Some(mut left) = name.strip_prefix(first) else {
        return false;
    };
    let mut parts: Vec<&str> = rest.split('*').collect();
    let last = parts.pop().unwrap_or_default();
    for part in parts {
        match left.find(part) {
            Some(at) => left = &left[at + part.len()..],
            None => return false,
        }
    }
    left.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::fits;

    #[test]
    fn a_star_stands_for_any_letters() {
        for (pattern, name, wanted) in [
            ("bend", "bend", true),
            ("bend", "bend-2", false),
            ("bend*", "bend", true),
            ("*-2", "bend-2", true),
            ("b*d*2", "bend-2", true),
            ("b*x*2", "bend-2", false),
            ("*", "bend", true),
            ("be*end", "bend", false),
            ("bend*bend", "bend", false),
        ] {
            assert_eq!(fits(pattern, name), wanted, "{pattern} {name}");
        }
    }
}

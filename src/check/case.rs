//! One case of a suite: a model, a job, and how far the result may be from its golden.
//!
//! Reads the JSON of cases and goldens; an error names its place.

use super::metric::{ToleranceEntry, Tolerances};
use crate::render::{UpAxis, ViewDirection};
use crate::wire;
use crate::wire::pb;
use prost::Message as _;

use serde::Deserialize;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde_json::value::RawValue;
use sha2::{Digest as _, Sha256};
use std::fmt;
use std::marker::PhantomData;

/// What ends the name of a case's file.
pub const CASE_SUFFIX: &str = ".case.json";
/// What ends the name of its golden, which lies beside it.
pub const GOLDEN_SUFFIX: &str = ".golden.json";
/// The built-in model.
const SAMPLE: &str = "creature";

/// A suite case is what the file of a case says.
#[derive(Debug, Clone)]
pub struct SuiteCase {
    /// From the name of its file.
    pub name: String,
    /// What it shows, for people; maybe empty.
    pub title: String,
    /// Its model.
    pub model: ModelSource,
    /// Its job, or where that is.
    pub job: JobSource,
    /// How far its result may be from the golden.
    pub tolerances: Tolerances,
    /// From where its pictures are taken; `None` = chosen.
    pub view: Option<ViewDirection>,
    /// The axis that points up in its pictures.
    pub up: UpAxis,
}

/// A model source says where a case's model comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ModelSource {
    /// The built-in creature.
    Sample,
    /// A file below the suite's folder.
    Suite(String),
    /// A file below the folder of shared data, which not every machine has.
    Data(String),
}

/// A job source says where a case's job comes from.
#[derive(Debug, Clone)]
pub enum JobSource {
    /// The case itself.
    Inline(Box<pb::Job>),
    /// A file below the suite's folder.
    File(String),
    /// No job: an animation of the model, of which every frame is kept by its digest.
    Animation(Box<AnimationCase>),
}

/// An animation case says how a clip drives its model.
#[derive(Debug, Clone)]
pub struct AnimationCase {
    /// How the session is built that a server makes of the model.
    pub create: pb::CreateOptions,
    /// How the clip drives it.
    pub options: pb::AnimateOptions,
    /// A recorded clip: a BVH file below the suite's folder.
    pub bvh: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CaseFile<'a> {
    #[serde(default)]
    title: String,
    model: String,
    #[serde(borrow)]
    job: Option<&'a RawValue>,
    #[serde(borrow)]
    animate: Option<JsonObject<AnimationFields<'a>>>,
    #[serde(default)]
    tolerances: Vec<JsonObject<ToleranceEntry>>,
    view: Option<JsonObject<ViewAngles>>,
    up: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct AnimationFields<'a> {
    #[serde(borrow)]
    create: Option<&'a RawValue>,
    #[serde(borrow)]
    options: Option<&'a RawValue>,
    bvh: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ViewAngles {
    azimuth: f64,
    elevation: f64,
}

impl SuiteCase {
    /// Reads the file of a case. `file` is its name in the suite's folder.
    ///
    /// ```
    /// use pliant::check::{ModelSource, SuiteCase};
    ///
    /// let case = SuiteCase::from_file("bend.case.json", br#"{"model": "sample:creature", "job": {"handles": []}}"#)?;
    /// assert_eq!((case.name.as_str(), case.model), ("bend", ModelSource::Sample));
    /// # Ok::<(), pliant::check::SuiteError>(())
    /// ```
    ///
    /// # Errors
    /// What is wrong with it and where.
    pub fn from_file(file: &str, text: &[u8]) -> Result<Self, SuiteError> {
        let refuse = |place: &str, problem: String| suite_error(file, place, problem);
        let name = file.strip_suffix(CASE_SUFFIX).unwrap_or_default();
        check_case_name(name).map_err(|problem| refuse("its name", problem))?;
        let read: CaseFile<'_> = from_json_object(file, text)?;
        let model = ModelSource::from_text(&read.model).map_err(|problem| refuse("model", problem))?;
        let job = match (read.job, read.animate) {
            (Some(job), None) => JobSource::from_json(job),
            (None, Some(JsonObject(fields))) => AnimationCase::from_fields(&fields),
            (None, None) => Err((
                "job".into(),
                "missing field `job`; a case has either job or animate".into(),
            )),
            (Some(_), Some(_)) => Err(("animate".into(), "a case has either job or animate".into())),
        };
        let job = job.map_err(|(place, problem)| refuse(&place, problem))?;
        let tolerances: Vec<ToleranceEntry> = read.tolerances.into_iter().map(|t| t.0).collect();
        let tolerances = Tolerances::from_entries(&tolerances).map_err(|(place, problem)| refuse(&place, problem))?;
        let up = match read.up.as_deref() {
            None | Some("y") => UpAxis::Y,
            Some("z") => UpAxis::Z,
            Some(other) => return Err(refuse("up", format!("\"{other}\" is not an axis, allowed are y and z"))),
        };
        let view = read
            .view
            .map(|JsonObject(v)| ViewDirection::new(v.azimuth, v.elevation, up));
        Ok(Self {
            name: name.to_owned(),
            title: read.title,
            model,
            job,
            tolerances,
            view: view.transpose().map_err(|e| refuse("view", e.to_string()))?,
            up,
        })
    }

    /// The name of its golden.
    pub fn golden_file(&self) -> String {
        format!("{}{GOLDEN_SUFFIX}", self.name)
    }
}

impl ModelSource {
    fn from_text(text: &str) -> Result<Self, String> {
        let allowed = "allowed are a path below the suite's folder, \"data:\" and a path below the folder of PLIANT_DATA, and \"sample:creature\"";
        if let Some(name) = text.strip_prefix("sample:") {
            return match name {
                SAMPLE => Ok(Self::Sample),
                _ => Err(format!("\"{text}\" is not built in; {allowed}")),
            };
        }
        let (source, path): (fn(String) -> Self, &str) = match text.strip_prefix("data:") {
            Some(path) => (Self::Data, path),
            None => (Self::Suite, text),
        };
        match stays_below(path) {
            true => Ok(source(path.to_owned())),
            false => Err(format!(
                "\"{text}\" is not a path that stays below its folder; {allowed}"
            )),
        }
    }
}

impl std::fmt::Display for ModelSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sample => write!(f, "sample:{SAMPLE}"),
            Self::Suite(path) => f.write_str(path),
            Self::Data(path) => write!(f, "data:{path}"),
        }
    }
}

impl JobSource {
    fn from_json(raw: &RawValue) -> Result<Self, (String, String)> {
        let text = raw.get();
        if text.starts_with('"') {
            let path: String = serde_json::from_str(text).map_err(|e| ("job".into(), e.to_string()))?;
            check_below(&path, "job")?;
            return Ok(Self::File(path));
        }
        let read = wire::json::from_json(text.as_bytes()).and_then(|job: pb::Job| {
            job.expect.as_ref().map_or(Ok(()), |expect| expect.check("expect"))?;
            Ok(job)
        });
        let job = read.map_err(|e| problem_below("job", e))?;
        Ok(Self::Inline(Box::new(job)))
    }
}

/// The place and the problem of an error of the schema, in a field of the case.
fn problem_below(field: &str, error: wire::Error) -> (String, String) {
    match error {
        wire::Error::Malformed { field: place, problem } if place == "body" => (field.into(), problem),
        wire::Error::Malformed { field: place, problem } | wire::Error::Invalid { field: place, problem } => {
            (format!("{field}.{place}"), problem)
        }
        other => (field.into(), other.to_string()),
    }
}

/// Rejects a path that leaves the suite's folder.
fn check_below(path: &str, field: &str) -> Result<(), (String, String)> {
    if stays_below(path) {
        return Ok(());
    }
    let problem = format!("\"{path}\" is not a path that stays below the suite's folder");
    Err((field.into(), problem))
}

impl AnimationCase {
    fn from_fields(fields: &AnimationFields<'_>) -> Result<JobSource, (String, String)> {
        let text = |raw: Option<&RawValue>| raw.map_or("{}", RawValue::get).as_bytes().to_vec();
        let create = wire::json::from_json(&text(fields.create)).map_err(|e| problem_below("animate.create", e))?;
        let options = wire::animate_options_from_json(&text(fields.options));
        let options = options.map_err(|e| problem_below("animate.options", e))?;
        if let Some(path) = &fields.bvh {
            check_below(path, "animate.bvh")?;
        }
        Ok(JobSource::Animation(Box::new(Self {
            create,
            options,
            bvh: fields.bvh.clone(),
        })))
    }

    /// Computes the SHA-256 of what it asks for in lower-case hexadecimal. The clip's bytes must be in the options.
    pub fn input_hash(&self) -> String {
        let parts = [self.create.encode_to_vec(), self.options.encode_to_vec()];
        sha256_hex(b"", parts.iter().map(Vec::as_slice))
    }
}

/// Rejects an invalid case name.
pub(super) fn check_case_name(name: &str) -> Result<(), String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    if name.is_empty() || name.starts_with('.') || name.len() > 100 || !name.chars().all(plain) {
        let problem =
            "is not the name of a case; letters, digits, \".\", \"_\" and \"-\" are allowed, 100 of them at most";
        return Err(format!("\"{name}\" {problem}"));
    }
    Ok(())
}

/// Whether a path is relative, made of plain names with "/" between them.
fn stays_below(path: &str) -> bool {
    let plain = |part: &str| !part.is_empty() && part != "." && part != "..";
    !path.contains(['\\', ':', '\0']) && path.split('/').all(plain)
}

/// Computes the SHA-256 of a job in lower-case hexadecimal, without what it expects, which changes no result. Models to merge must be
/// in it.
pub fn job_hash(job: &pb::Job) -> String {
    let bare = pb::Job {
        expect: None,
        ..job.clone()
    };
    sha256_hex(&bare.encode_to_vec(), std::iter::empty())
}

/// Computes the SHA-256 of a model in lower-case hexadecimal: of its file; with companions also of their names and bytes.
pub fn model_hash(files: &crate::asset::FileSet) -> String {
    let companions = files.companions.iter();
    let companions = companions.flat_map(|(name, bytes)| [name.as_bytes(), bytes.as_ref()]);
    sha256_hex(&files.main, companions)
}

/// Computes the SHA-256 of a beginning and of texts, each with its length, so that no two lists are alike.
pub(super) fn sha256_hex<'a>(beginning: &[u8], texts: impl Iterator<Item = &'a [u8]>) -> String {
    let mut hash = Sha256::new_with_prefix(beginning);
    for text in texts {
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    }
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

/// What some editors put before UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// A suite error is a mistake in a suite's file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct SuiteError {
    /// The file, from the suite's folder.
    pub file: String,
    /// What is wrong, where in the file, and what is allowed.
    pub problem: String,
}

/// A value that is written as a JSON object. What serde derives would also take the fields as a list, without names.
#[derive(Debug)]
pub(super) struct JsonObject<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for JsonObject<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ObjectVisitor<T>(PhantomData<T>);

        impl<'de, T: Deserialize<'de>> Visitor<'de> for ObjectVisitor<T> {
            type Value = T;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a JSON object")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<T, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map))
            }
        }

        deserializer.deserialize_map(ObjectVisitor(PhantomData)).map(Self)
    }
}

/// Makes the error of something that is wrong in a file. `file` is its name in the suite's folder; without a place it is the
/// file itself that is wrong.
pub(super) fn suite_error(file: &str, place: &str, problem: impl fmt::Display) -> SuiteError {
    SuiteError {
        file: file.to_owned(),
        problem: match place {
            "" => problem.to_string(),
            place => format!("{place}: {problem}"),
        },
    }
}

/// Reads a file that is one JSON object.
///
/// # Errors
/// What is wrong with it and where.
pub(super) fn from_json_object<'a, T: Deserialize<'a>>(file: &str, text: &'a [u8]) -> Result<T, SuiteError> {
    if text.starts_with(BYTE_ORDER_MARK) {
        let problem = "begins with a byte order mark, UTF-8 without one is needed";
        return Err(suite_error(file, "", problem));
    }
    let mut json = serde_json::Deserializer::from_slice(text);
    let read: JsonObject<T> = serde_path_to_error::deserialize(&mut json)
        .map_err(|e| suite_error(file, readable_path(&e.path().to_string()), e.inner()))?;
    json.end().map_err(|e| suite_error(file, "", e))?;
    Ok(read.0)
}

/// Writes a path as people read it: where a text breaks off, its last part is not known. Empty for the file itself.
fn readable_path(path: &str) -> &str {
    path.trim_end_matches(['.', '?'])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        SuiteCase::from_file("bend.case.json", text.as_bytes())
            .expect_err(text)
            .to_string()
    }

    #[test]
    fn a_case_says_model_job_and_what_may_differ() {
        let text = r#"{"title": "A bend", "model": "models/bar.obj", "job": {"handles": []}, "view": {"azimuth": 0, "elevation": 10},
            "up": "z", "tolerances": [{"metrics": ["bytes"], "most": 100, "reason": "padding"}]}"#;
        let case = SuiteCase::from_file("bend.case.json", text.as_bytes()).expect("a case");
        assert_eq!(
            (case.name.as_str(), case.golden_file().as_str()),
            ("bend", "bend.golden.json")
        );
        assert_eq!(case.model, ModelSource::Suite("models/bar.obj".into()));
        assert!(matches!(case.job, JobSource::Inline(_)) && case.up == UpAxis::Z && case.view.is_some());
        for (text, source) in [
            ("sample:creature", ModelSource::Sample),
            ("data:meshes/arm.off", ModelSource::Data("meshes/arm.off".into())),
        ] {
            let read = ModelSource::from_text(text).expect("a source");
            assert_eq!((read.to_string().as_str(), read), (text, source));
        }
    }

    #[test]
    fn what_is_wrong_is_reported_with_file_and_place() {
        let job = r#""job": {}"#;
        let reported = refused(&format!(r#"{{"model": "a.obj", {job}, "tolerance": 1}}"#));
        assert!(
            reported.starts_with("bend.case.json: ")
                && reported.contains("tolerance")
                && reported.contains("tolerances"),
            "{reported}"
        );
        assert!(refused(&format!(r#"{{{job}}}"#)).contains("missing field `model`"));
        assert!(refused(r#"{"model": "a.obj", "job": {"handels": []}}"#).contains("job.handels"));
        assert!(refused(r#"{"model": "a.obj", "job": 3}"#).contains("job: "));
        assert!(refused(r#"{"model": "a.obj", "job": "../job.json"}"#).contains("below"));
        for model in [
            "../a.obj",
            "/etc/passwd",
            "a/../../b",
            "",
            "sample:dog",
            "http://x/y",
            "a\\\\b",
        ] {
            let reported = refused(&format!(r#"{{"model": "{model}", {job}}}"#));
            assert!(
                reported.contains("model: ") && reported.contains("PLIANT_DATA"),
                "{reported}"
            );
        }
        assert!(refused(&format!(r#"{{"model": "a.obj", {job}, "up": "x"}}"#)).contains("allowed are y and z"));
        let steep = r#""view": {"azimuth": 0, "elevation": 100}"#;
        assert!(refused(&format!(r#"{{"model": "a.obj", {job}, {steep}}}"#)).contains("-90 to 90"));
        let loose = r#""tolerances": [{"metrics": ["bytes"], "most": 1}]"#;
        assert!(refused(&format!(r#"{{"model": "a.obj", {job}, {loose}}}"#)).contains("tolerances[0].reason"));
        for bound in [r#""maxDistance": "NaN""#, r#""volumeChange": -1"#] {
            let reported = refused(&format!(r#"{{"model": "a.obj", "job": {{"expect": {{{bound}}}}}}}"#));
            assert!(
                reported.contains("job.expect.") && reported.contains("at least 0"),
                "{reported}"
            );
        }
        assert!(
            SuiteCase::from_file("a b.case.json", b"{}")
                .expect_err("a space")
                .to_string()
                .contains("not the name of a case")
        );
    }

    #[test]
    fn an_animation_stands_in_place_of_a_job() {
        let text = r#"{"model": "figure.glb", "animate": {"options": {"clip": "walk", "count": 5}, "create": {"label": "x"}}}"#;
        let case = SuiteCase::from_file("walk.case.json", text.as_bytes()).expect("a case");
        let JobSource::Animation(animation) = case.job else {
            panic!("no animation")
        };
        assert_eq!((animation.options.count, animation.create.label.as_str()), (5, "x"));
        let mut other = animation.as_ref().clone();
        assert_eq!(other.input_hash(), animation.input_hash());
        other.options.first = 1;
        assert_ne!(other.input_hash(), animation.input_hash());
        for (animate, reported) in [
            (r#"{"options": {"speed": 1}}"#, "animate.options.speed"),
            (r#"{"create": {"labl": 1}}"#, "animate.create.labl"),
            (r#"{"bvh": "../clip.bvh"}"#, "animate.bvh"),
            (r#"{"clip": "walk"}"#, "animate"),
        ] {
            let said = refused(&format!(r#"{{"model": "a.glb", "animate": {animate}}}"#));
            assert!(said.contains(reported), "{said} lacks {reported}");
        }
        assert!(refused(r#"{"model": "a.obj"}"#).contains("either job or animate"));
        assert!(refused(r#"{"model": "a.obj", "job": {}, "animate": {}}"#).contains("either job or animate"));
    }

    #[test]
    fn lists_are_no_cases_no_tolerances_and_no_views() {
        for (text, place) in [
            (r#"["t", "a.obj", {}, [], null, null]"#, ""),
            ("[]", ""),
            (
                r#"{"model": "a.obj", "job": {}, "tolerances": [[["bytes"], 0, ""]]}"#,
                "tolerances[0]: ",
            ),
            (r#"{"model": "a.obj", "job": {}, "view": [0, 10]}"#, "view: "),
        ] {
            let reported = refused(text);
            let start = format!("bend.case.json: {place}invalid type: sequence, expected a JSON object");
            assert!(reported.starts_with(&start), "{reported}");
        }
        let reported = refused(r#"{"model": "a.obj", "job": {"handles": ["#);
        assert!(reported.starts_with("bend.case.json: job: EOF"), "{reported}");
    }

    #[test]
    fn what_is_expected_is_no_input() {
        let job = |text: &str| wire::json::from_json::<pb::Job>(text.as_bytes()).expect("a job");
        let plain = job(r#"{"handles": [{"id": "a"}]}"#);
        assert_eq!(
            job_hash(&plain),
            job_hash(&job(r#"{"handles": [{"id": "a"}], "expect": {"flippedTriangles": 0}}"#))
        );
        assert_ne!(job_hash(&plain), job_hash(&job(r#"{"handles": [{"id": "b"}]}"#)));
    }
}

#[cfg(test)]
mod suite_json_tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Pair {
        left: u32,
        right: u32,
    }

    fn refused(text: &[u8]) -> String {
        from_json_object::<Pair>("x.json", text)
            .expect_err("refused")
            .to_string()
    }

    #[test]
    fn an_object_is_an_object() {
        assert_eq!(
            from_json_object("x.json", br#"{"left": 1, "right": 2}"#),
            Ok(Pair { left: 1, right: 2 })
        );
        for list in ["[1, 2]", "[]", "3", "null", "\"x\""] {
            let reported = refused(list.as_bytes());
            assert!(
                reported.starts_with("x.json: invalid type") && reported.contains("a JSON object"),
                "{reported}"
            );
        }
    }

    #[test]
    fn a_place_is_reported_wherever_a_text_breaks_off() {
        for text in ["", "{", r#"{"left"#, r#"{"left": 1, "ri"#, r#"{"left": 1"#] {
            let reported = refused(text.as_bytes());
            assert!(reported.starts_with("x.json: EOF while parsing"), "{text}: {reported}");
        }
        assert!(refused(br#"{"left": "#).starts_with("x.json: left: EOF while parsing"));
        assert!(refused(br#"{"left": 1, "right": 2} x"#).starts_with("x.json: trailing"));
    }

    #[test]
    fn a_byte_order_mark_is_named() {
        let reported = refused(b"\xef\xbb\xbf{\"left\": 1, \"right\": 2}");
        assert!(
            reported.contains("byte order mark") && reported.contains("without one"),
            "{reported}"
        );
    }
}

//! Goldens: what is kept of a result that people have looked at and found right.

use super::case_result::{CaseResult, TopologyDigests};
use super::metric::Metric;
use super::quantized::{QuantizedPositions, QuantizedPositionsText, read_triangles, triangles_text};
use super::suite_json::{self, SuiteError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The version of the file's layout.
const LAYOUT: u32 = 1;
/// Most vertices and triangles that a golden may speak of.
const MOST: usize = 40_000_000;

/// A golden is a stored result.
#[derive(Debug, Clone, PartialEq)]
pub struct Golden {
    /// What it was made from.
    pub inputs: InputHashes,
    /// Digest of its positions.
    pub digest: String,
    /// Its counts and connections.
    pub topology: TopologyDigests,
    /// The engine's numbers.
    pub numbers: BTreeMap<Metric, f64>,
    /// Its positions, up to the cells of a grid.
    pub positions: QuantizedPositions,
    /// Its triangles, where they are not the model's.
    pub triangles: Option<Vec<[u32; 3]>>,
    /// Of an animation, digests of all frames; the rest is then of the last one.
    pub frames: Vec<String>,
}

/// Input hashes name what a result depends on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputHashes {
    /// See [`super::model_hash`].
    pub model: String,
    /// See [`super::job_hash`].
    pub job: String,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct GoldenFile {
    layout: u32,
    inputs: InputHashes,
    digest: String,
    topology: TopologyDigests,
    metrics: BTreeMap<String, f64>,
    positions: QuantizedPositionsText,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    triangles: Option<Vec<String>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    frames: Vec<String>,
}

impl Golden {
    /// Makes the golden of a result whose numbers are all finite.
    pub fn from_result(found: &CaseResult, inputs: InputHashes) -> Self {
        Self {
            inputs,
            digest: found.digest.clone(),
            topology: TopologyDigests::from_triangles(found.positions.len(), &found.triangles),
            numbers: found.numbers.clone(),
            positions: QuantizedPositions::from_positions(&found.positions),
            triangles: (found.triangles != found.before.1).then(|| found.triangles.clone()),
            frames: found.frames.clone(),
        }
    }

    /// Writes the text of the golden's file.
    ///
    /// # Errors
    /// In words; never for finite numbers.
    pub fn to_text(&self) -> Result<String, String> {
        let file = GoldenFile {
            layout: LAYOUT,
            inputs: self.inputs.clone(),
            digest: self.digest.clone(),
            topology: self.topology.clone(),
            metrics: self.numbers.iter().map(|(m, x)| (m.name().to_owned(), *x)).collect(),
            positions: self.positions.to_text(),
            triangles: self.triangles.as_deref().map(triangles_text),
            frames: self.frames.clone(),
        };
        let text = serde_json::to_string_pretty(&file).map_err(|e| e.to_string())?;
        Ok(text + "\n")
    }

    /// Reads a golden. `file` names it in texts.
    ///
    /// # Errors
    /// What is wrong with it and where.
    pub fn from_file(file: &str, text: &[u8]) -> Result<Self, SuiteError> {
        let refuse = |place: &str, problem: String| suite_json::suite_error(file, place, problem);
        let read: GoldenFile = suite_json::from_json_object(file, text)?;
        if read.layout != LAYOUT {
            let problem = format!("is {}, this version reads {LAYOUT}", read.layout);
            return Err(refuse("layout", problem));
        }
        let (vertices, triangles) = (read.topology.vertices, read.topology.triangles);
        if vertices.max(triangles) > MOST {
            let problem = format!("{vertices} vertices and {triangles} triangles, at most {MOST} are allowed");
            return Err(refuse("topology", problem));
        }
        let mut numbers = BTreeMap::new();
        for (name, value) in read.metrics {
            let Some(metric) = Metric::from_name(&name) else {
                return Err(refuse("metrics", format!("\"{name}\" is not a metric of this version")));
            };
            numbers.insert(metric, value);
        }
        let positions = QuantizedPositions::from_text(&read.positions, vertices).map_err(|e| refuse("positions", e))?;
        let triangles = read.triangles.map(|text| read_triangles(&text, triangles, vertices));
        Ok(Self {
            inputs: read.inputs,
            digest: read.digest,
            topology: read.topology,
            numbers,
            positions,
            triangles: triangles.transpose().map_err(|e| refuse("triangles", e))?,
            frames: read.frames,
        })
    }

    /// Describes why the golden belongs to another case; `None` when it belongs to this one.
    pub fn stale_reason(&self, inputs: &InputHashes) -> Option<String> {
        let changed: Vec<&str> = [
            ("model", self.inputs.model != inputs.model),
            ("job", self.inputs.job != inputs.job),
        ]
        .into_iter()
        .filter_map(|(name, changed)| changed.then_some(name))
        .collect();
        let have = if changed.len() > 1 { "have" } else { "has" };
        let problem = "changed since the golden was stored; look at the result and bless it";
        (!changed.is_empty()).then(|| {
            format!(
                "the golden is stale: the case's {} {have} {problem}",
                changed.join(" and its ")
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn golden() -> Golden {
        let found = CaseResult {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            digest: "xxh3:0011223344556677".into(),
            frames: vec!["xxh3:01".into(), "xxh3:0011223344556677".into()],
            numbers: [(Metric::EdgeRms, 0.1 + 0.2), (Metric::Cycles, 7.0)].into(),
            ..Default::default()
        };
        let inputs = InputHashes {
            model: "a".into(),
            job: "b".into(),
        };
        Golden::from_result(&found, inputs)
    }

    #[test]
    fn a_golden_comes_back_to_the_bit() {
        let golden = golden();
        let text = golden.to_text().expect("finite");
        assert_eq!(Golden::from_file("x.golden.json", text.as_bytes()), Ok(golden));
    }

    #[test]
    fn a_broken_one_says_where() {
        let text = golden().to_text().expect("finite");
        let refused = |from: &str, to: &str, words: &str| {
            let broken = text.replacen(from, to, 1);
            assert_ne!(broken, text, "{from}");
            let told = Golden::from_file("x.golden.json", broken.as_bytes())
                .expect_err(from)
                .to_string();
            assert!(told.starts_with("x.golden.json: ") && told.contains(words), "{told}");
        };
        refused("\"layout\": 1", "\"layout\": 2", "layout");
        refused("\"vertices\": 4", "\"vertices\": 5", "positions");
        refused("\"vertices\": 4", "\"vertices\": 99999999999", "at most");
        refused("\"cycles\"", "\"turns\"", "turns");
        refused("\"digest\"", "\"digset\"", "digset");
    }

    #[test]
    fn a_stale_one_says_what_has_changed() {
        let golden = golden();
        assert_eq!(golden.stale_reason(&golden.inputs), None);
        let other = InputHashes {
            model: "c".into(),
            job: "d".into(),
        };
        let told = golden.stale_reason(&other).expect("stale");
        assert!(told.contains("stale") && told.contains("model and its job"), "{told}");
    }
}

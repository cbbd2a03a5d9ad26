//! The golden of a case: what is stored of its result, with positions in whole steps.

use super::case::{SuiteError, from_json_object, suite_error};
use super::case_result::{CaseResult, TopologyDigests};
use super::metric::Metric;
use super::named::Named as _;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};

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
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
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
        let refuse = |place: &str, problem: String| suite_error(file, place, problem);
        let read: GoldenFile = from_json_object(file, text)?;
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

/// Grid steps along each side of the box.
const STEPS: f64 = 65535.0;
/// Characters of a line of base64.
const LINE: usize = 120;

/// Quantized positions lie on a grid: each is known up to half a step of it.
#[derive(Debug, Clone, PartialEq)]
pub struct QuantizedPositions {
    /// The corner with the smallest coordinates.
    pub min: DVec3,
    /// The corner with the largest coordinates.
    pub max: DVec3,
    cells: Vec<[u16; 3]>,
}

/// [`QuantizedPositions`] in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct QuantizedPositionsText {
    min: [f64; 3],
    max: [f64; 3],
    data: Vec<String>,
}

impl QuantizedPositions {
    /// Finds the cells in which finite positions lie.
    pub fn from_positions(positions: &[DVec3]) -> Self {
        let bounds = crate::mesh::BoundingBox::of(positions);
        let places = Self {
            min: bounds.min,
            max: bounds.max,
            cells: Vec::new(),
        };
        let step = places.grid_step();
        let cell = |p: &DVec3| {
            // A flat box has no steps along its thin side; the cast takes what is not a number as 0.
            let at = (*p - places.min) / step;
            [at.x, at.y, at.z].map(|x| x.round().clamp(0.0, STEPS) as u16)
        };
        Self {
            cells: positions.iter().map(cell).collect(),
            ..places
        }
    }

    /// The number of positions.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether there are no positions.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// The length of the box's diagonal.
    pub fn diagonal(&self) -> f64 {
        (self.max - self.min).length()
    }

    /// No stored position is further from the true one than this, as a share of the diagonal: half of a cell's diagonal.
    pub fn resolution(&self) -> f64 {
        0.5 / STEPS
    }

    fn grid_step(&self) -> DVec3 {
        (self.max - self.min) / STEPS
    }

    fn cell_center(&self, cell: [u16; 3]) -> DVec3 {
        self.min + DVec3::from_array(cell.map(f64::from)) * self.grid_step()
    }

    /// The middles of the cells.
    pub fn cell_centers(&self) -> Vec<DVec3> {
        self.cells.iter().map(|&c| self.cell_center(c)).collect()
    }

    /// The stored positions as near to `positions` as their cells allow, each cell wider by `slack` times the size of the
    /// coordinates. What is left between the two is a difference that is certain; what rounding to the grid may have
    /// made is not counted. With another number of positions, the middles.
    pub fn nearest_to(&self, positions: &[DVec3], slack: f64) -> Vec<DVec3> {
        if positions.len() != self.cells.len() {
            return self.cell_centers();
        }
        // One part in 10¹² more, for the arithmetic of the grid itself.
        let reach = self.min.abs().max(self.max.abs()) * (slack + 1e-12) + self.grid_step() * 0.5;
        let pairs = self.cells.iter().zip(positions);
        pairs
            .map(|(&cell, &p)| {
                let middle = self.cell_center(cell);
                p.max(middle - reach).min(middle + reach)
            })
            .collect()
    }

    pub(super) fn to_text(&self) -> QuantizedPositionsText {
        let mut bytes = Vec::with_capacity(self.cells.len() * 6);
        for axis in 0..3 {
            let deltas: Vec<u16> = (0..self.cells.len())
                .map(|i| {
                    let before = i.checked_sub(1).map_or(0, |j| self.cells[j][axis]);
                    let delta = self.cells[i][axis].wrapping_sub(before);
                    // Small steps either way become small numbers.
                    delta << 1 ^ if delta >> 15 == 1 { 0xffff } else { 0 }
                })
                .collect();
            bytes.extend(deltas.iter().map(|d| *d as u8));
            bytes.extend(deltas.iter().map(|d| (d >> 8) as u8));
        }
        QuantizedPositionsText {
            min: self.min.to_array(),
            max: self.max.to_array(),
            data: to_base64_lines(&bytes),
        }
    }

    /// Reads what [`QuantizedPositions::to_text`] wrote.
    pub(super) fn from_text(text: &QuantizedPositionsText, vertices: usize) -> Result<Self, String> {
        let (min, max) = (DVec3::from_array(text.min), DVec3::from_array(text.max));
        if !(min.is_finite() && max.is_finite() && (max - min).is_finite() && min.cmple(max).all()) {
            return Err(format!("the box from {min} to {max} is none"));
        }
        let wanted = vertices.checked_mul(6).ok_or("has too many vertices")?;
        let bytes = from_base64_lines(&text.data, wanted)?;
        if bytes.len() != wanted {
            return Err(format!(
                "{} bytes of positions for {vertices} vertices, {wanted} are needed",
                bytes.len()
            ));
        }
        let mut cells = vec![[0u16; 3]; vertices];
        for axis in 0..3 {
            let (low, high) = bytes[axis * 2 * vertices..(axis + 1) * 2 * vertices].split_at(vertices);
            let mut at = 0u16;
            for ((cell, low), high) in cells.iter_mut().zip(low).zip(high) {
                let folded = u16::from_le_bytes([*low, *high]);
                at = at.wrapping_add(folded >> 1 ^ if folded & 1 == 1 { 0xffff } else { 0 });
                cell[axis] = at;
            }
        }
        Ok(Self { min, max, cells })
    }
}

/// Triangles as lines of base64: each index as the difference from the one before, deflated.
pub(super) fn triangles_text(triangles: &[[u32; 3]]) -> Vec<String> {
    let mut bytes = Vec::with_capacity(triangles.len() * 6);
    let mut before = 0i64;
    for &index in triangles.as_flattened() {
        let delta = i64::from(index) - before;
        before = i64::from(index);
        let mut folded = (delta << 1 ^ delta >> 63) as u64;
        while folded >= 0x80 {
            bytes.push(folded as u8 | 0x80);
            folded >>= 7;
        }
        bytes.push(folded as u8);
    }
    to_base64_lines(&bytes)
}

/// Reads what [`triangles_text`] wrote.
pub(super) fn read_triangles(text: &[String], triangles: usize, vertices: usize) -> Result<Vec<[u32; 3]>, String> {
    let most = triangles.checked_mul(15).ok_or("has too many triangles")?;
    let bytes = from_base64_lines(text, most)?;
    let mut found = Vec::new();
    let (mut at, mut folded, mut shift) = (0i64, 0u64, 0u32);
    for byte in bytes {
        if shift > 35 {
            return Err("an index of a triangle is too large".into());
        }
        folded |= u64::from(byte & 0x7f) << shift;
        shift += 7;
        if byte & 0x80 == 0 {
            at += (folded >> 1) as i64 ^ -((folded & 1) as i64);
            match u32::try_from(at) {
                Ok(index) if (index as usize) < vertices => found.push(index),
                _ => return Err(format!("a triangle names vertex {at}, there are {vertices}")),
            }
            (folded, shift) = (0, 0);
        }
    }
    let (whole, rest) = found.as_chunks::<3>();
    if !rest.is_empty() || shift > 0 || whole.len() != triangles {
        return Err(format!("{} triangles are stored, {triangles} are needed", whole.len()));
    }
    Ok(whole.to_vec())
}

fn to_base64_lines(bytes: &[u8]) -> Vec<String> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
    // Writing to memory does not fail; a result that were cut short would be refused when read.
    let _ = encoder.write_all(bytes);
    let text = STANDARD.encode(encoder.finish().unwrap_or_default());
    let chunks = text.as_bytes().chunks(LINE);
    chunks.map(|c| String::from_utf8_lossy(c).into_owned()).collect()
}

/// The bytes behind lines of base64, at most `most` of them.
fn from_base64_lines(lines: &[String], most: usize) -> Result<Vec<u8>, String> {
    let packed = STANDARD
        .decode(lines.concat())
        .map_err(|e| format!("is not base64: {e}"))?;
    let mut found = Vec::new();
    let mut reader = DeflateDecoder::new(packed.as_slice()).take(most as u64 + 1);
    reader
        .read_to_end(&mut found)
        .map_err(|e| format!("cannot be inflated: {e}"))?;
    if found.len() > most {
        return Err(format!("holds more than the {most} bytes that its counts allow"));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

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
            let reported = Golden::from_file("x.golden.json", broken.as_bytes())
                .expect_err(from)
                .to_string();
            assert!(
                reported.starts_with("x.golden.json: ") && reported.contains(words),
                "{reported}"
            );
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
        let reported = golden.stale_reason(&other).expect("stale");
        assert!(
            reported.contains("stale") && reported.contains("model and its job"),
            "{reported}"
        );
    }

    proptest! {
        #[test]
        fn positions_come_back_within_half_a_step(points in prop::collection::vec(prop::array::uniform3(-1e3f64..1e3), 0..200)) {
            let points: Vec<DVec3> = points.into_iter().map(DVec3::from_array).collect();
            let places = QuantizedPositions::from_positions(&points);
            let again = QuantizedPositions::from_text(&places.to_text(), points.len()).expect("readable");
            prop_assert_eq!(&again, &places);
            for (p, q) in points.iter().zip(again.cell_centers()) {
                prop_assert!(p.distance(q) <= again.resolution() * again.diagonal() * (1.0 + 1e-9) + 1e-12);
            }
            // What was stored is not a difference at all.
            prop_assert_eq!(again.nearest_to(&points, 0.0), points);
        }

        #[test]
        fn triangles_come_back(triangles in prop::collection::vec(prop::array::uniform3(0u32..5000), 0..300)) {
            let text = triangles_text(&triangles);
            prop_assert_eq!(read_triangles(&text, triangles.len(), 5000), Ok(triangles));
        }

        #[test]
        fn no_text_is_a_panic(lines in prop::collection::vec("[A-Za-z0-9+/=]{0,40}", 0..4), count in 0usize..100) {
            let text = QuantizedPositionsText { min: [0.0; 3], max: [1.0; 3], data: lines.clone() };
            let _ = QuantizedPositions::from_text(&text, count);
            let _ = read_triangles(&lines, count, count);
        }
    }

    #[test]
    fn a_move_beyond_the_cell_is_reported_and_one_inside_is_not() {
        let points = [DVec3::ZERO, DVec3::new(2.0, 1.0, 0.5), DVec3::new(1.0, 0.5, 0.25)];
        let places = QuantizedPositions::from_positions(&points);
        let step = 2.0 / STEPS;
        let moved = |by: f64| {
            let mut now = points;
            now[2].x += by;
            let stored = places.nearest_to(&now, 0.0);
            now[2].distance(stored[2])
        };
        assert_eq!(moved(0.0), 0.0);
        assert!(moved(1e-3) > 1e-3 - 1.01 * step && moved(1e-3) <= 1e-3);
        assert!(moved(step * 0.01) < step);
    }

    #[test]
    fn a_bomb_is_not_unpacked() {
        let lines = to_base64_lines(&vec![0u8; 10_000_000]);
        assert!(from_base64_lines(&lines, 600).expect_err("too much").contains("600"));
    }
}

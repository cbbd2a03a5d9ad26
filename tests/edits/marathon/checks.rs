//! What holds after every edit, done or refused.

use crate::support::bench::pool;
use crate::support::messages::{DeformerMessages, EditedByMessage, broken, unreferenced};
use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits, Model};
use pliant::engine::{Deformer, TopologyState, digest};
use pliant::exec::Exec;
use pliant::progress::Silent;
use pliant::wire::{Error, pb};
use serde_json::Value;
use std::collections::BTreeSet;

/// A bench before an edit.
pub struct Before {
    facts: pb::Session,
    handles: pb::SetHandlesRequest,
    rest: String,
    triangles: Vec<[u32; 3]>,
    trail: TopologyState,
    manifold: bool,
    closed: bool,
    unreferenced: usize,
    /// The shape that the edit works on.
    shape: Vec<DVec3>,
}

impl Before {
    pub fn of(bench: &Deformer, shape: &[DVec3]) -> Self {
        Self {
            facts: bench.facts_message(),
            handles: bench.handles_message(),
            rest: digest(bench.rest()),
            triangles: bench.geometry().triangles.clone(),
            trail: bench.topology_state(),
            manifold: broken(bench) == 0,
            closed: bench.report().closed,
            unreferenced: unreferenced(bench),
            shape: shape.to_vec(),
        }
    }

    /// A refusal changes nothing and is one that a client can understand.
    pub fn refused(&self, bench: &Deformer, error: &Error) {
        assert!(
            matches!(
                error,
                Error::Invalid { .. } | Error::Precondition(_) | Error::TooLarge { .. } | Error::Asset(_)
            ),
            "{error:?}"
        );
        let said = error.to_string();
        assert!(!said.is_empty() && !said.contains('\n'), "one line: {said}");
        assert_eq!(bench.facts_message(), self.facts, "{said}");
        assert_eq!(bench.handles_message(), self.handles, "{said}");
        assert_eq!(digest(bench.rest()), self.rest, "{said}");
        assert_eq!(bench.geometry().triangles, self.triangles, "{said}");
        assert!(bench.topology_state().is_same(&self.trail), "{said}");
    }

    /// An edit that was done.
    pub fn done(&self, bench: &Deformer, edit: &Value, outcome: &EditedByMessage) {
        let result = &outcome.result;
        let (before, after) = (result.before.expect("counts"), result.after.expect("counts"));
        let (rest, triangles) = (bench.rest(), &bench.geometry().triangles);
        assert_eq!(
            (before.vertices as usize, before.faces as usize),
            (self.shape.len(), self.triangles.len())
        );
        assert_eq!(
            (after.vertices as usize, after.faces as usize),
            (rest.len(), triangles.len())
        );
        assert_eq!(outcome.shape.len(), rest.len());
        assert_eq!(result.digest, digest(&outcome.shape));
        assert!(rest.iter().chain(outcome.shape.iter()).all(|p| p.is_finite()));
        let ids: Vec<&str> = bench.handles().handles.iter().map(|h| h.id.as_str()).collect();
        assert_eq!(result.handles_kept, ids);
        assert_eq!(outcome.poses.0.len(), ids.len());
        self.topology(bench, edit);
        self.kept(bench, edit, outcome);
        curve(bench, &result.curve);
        let geometry = bench.geometry();
        if !geometry.normals.is_empty() {
            assert_eq!(geometry.normals.len(), rest.len());
        }
        assert!(geometry.normals.iter().all(|n| n.is_finite()), "normals");
        assert!(geometry.tangents.iter().all(|t| t.is_finite()), "tangents");
        let mut first = 0;
        for (k, p) in geometry.primitives.iter().enumerate() {
            assert_eq!(p.first_vertex, first, "primitive {k} follows the one before it");
            first += p.vertex_count;
        }
        assert_eq!(first as usize, rest.len());
    }

    fn topology(&self, bench: &Deformer, edit: &Value) {
        assert!(
            unreferenced(bench) <= self.unreferenced,
            "an edit leaves no vertex behind: {edit}"
        );
        if self.manifold {
            let report = bench.report();
            let counts = [
                report.non_manifold_edges,
                report.non_manifold_vertices,
                report.winding_conflicts,
            ];
            assert!(broken(bench) == 0, "manifold stays manifold: {counts:?} after {edit}");
        }
        let opens = edit["cut"].is_object() || edit["delete"].is_object();
        if self.manifold && self.closed && !opens {
            assert!(bench.report().closed, "closed stays closed: {edit}");
        }
    }

    /// Runs rise, lie within both models, and what lies outside the region keeps its bits.
    fn kept(&self, bench: &Deformer, edit: &Value, outcome: &EditedByMessage) {
        let region = ["subdivide", "decimate", "remesh", "delete"]
            .iter()
            .find_map(|op| edit[op]["region"].as_object());
        let ball = region.map(|r| {
            let center: Vec<f64> = serde_json::from_value(r["sphere"]["center"].clone()).expect("a place");
            (
                DVec3::from_slice(&center),
                r["sphere"]["radius"].as_f64().expect("a radius"),
            )
        });
        let still =
            ball.is_some() || edit["insertCurve"].is_object() || edit["cut"].is_object() || edit["fill"].is_object();
        let mut next = 0;
        let mut used = BTreeSet::new();
        for run in &outcome.result.kept {
            assert!(run.count > 0 && run.was >= next, "runs rise: {run:?}");
            next = run.was + run.count;
            assert!(next as usize <= self.shape.len() && (run.now + run.count) as usize <= bench.rest().len());
            for k in 0..run.count {
                assert!(
                    used.insert(run.now + k),
                    "two old vertices are vertex {} now",
                    run.now + k
                );
                let (was, now) = (self.shape[(run.was + k) as usize], bench.rest()[(run.now + k) as usize]);
                let outside = ball.is_none_or(|(center, radius)| was.distance(center) > radius);
                // A cut takes vertices that almost touch its plane for its own.
                let slack = if edit["cut"].is_object() {
                    1e-4 * bench.diagonal()
                } else {
                    0.0
                };
                let moved = was.distance(now);
                assert!(
                    !(still && outside) || moved <= slack,
                    "vertex {} moved by {moved}: {edit}",
                    run.was + k
                );
            }
        }
    }
}

/// Consecutive vertices of an inserted curve are joined by edges.
fn curve(bench: &Deformer, curve: &[u32]) {
    let rest = bench.rest();
    assert!(curve.iter().all(|&v| (v as usize) < rest.len()));
    if curve.len() < 2 {
        return;
    }
    let key = |v: u32| rest[v as usize].to_array().map(f64::to_bits);
    let mut edges = BTreeSet::new();
    for t in &bench.geometry().triangles {
        for i in 0..3 {
            let (a, b) = (key(t[i]), key(t[(i + 1) % 3]));
            edges.insert((a.min(b), a.max(b)));
        }
    }
    for pair in curve.windows(2) {
        let (a, b) = (key(pair[0]), key(pair[1]));
        assert!(edges.contains(&(a.min(b), a.max(b))), "{pair:?} is not an edge");
    }
}

/// What is written is read back, and all its numbers are finite.
pub fn written(bench: &Deformer, shape: &[DVec3]) {
    let written = bench
        .write(shape, Format::GLB, &Exec::new(&pool(1), &Silent))
        .expect("written");
    finite(&written.main);
    let files = FileSet::single("back.glb", written.main);
    let back = Model::read(files, Some(Format::GLB), &Limits::default()).expect("read back");
    assert_eq!(back.triangles.len(), bench.geometry().triangles.len());
    assert_eq!(back.positions.len(), shape.len());
}

/// Every number of every float accessor of a GLB.
fn finite(glb: &[u8]) {
    let glb = gltf::binary::Glb::from_slice(glb).expect("a GLB");
    let json: Value = serde_json::from_slice(&glb.json).expect("JSON");
    let bin = glb.bin.unwrap_or_default();
    let number = |v: &Value| v.as_u64().unwrap_or(0) as usize;
    for accessor in json["accessors"].as_array().into_iter().flatten() {
        let Some(view) = accessor["bufferView"].as_u64() else {
            continue;
        };
        let view = &json["bufferViews"][view as usize];
        if accessor["componentType"] != 5126 || number(&view["buffer"]) != 0 {
            continue;
        }
        let components = match accessor["type"].as_str() {
            Some("VEC2") => 2,
            Some("VEC3") => 3,
            Some("VEC4") => 4,
            Some("MAT4") => 16,
            _ => 1,
        };
        let stride = view["byteStride"].as_u64().map_or(4 * components, |s| s as usize);
        let start = number(&view["byteOffset"]) + number(&accessor["byteOffset"]);
        for k in 0..number(&accessor["count"]) {
            let at = start + k * stride;
            for c in bin[at..at + 4 * components].chunks_exact(4) {
                let x = f32::from_le_bytes([c[0], c[1], c[2], c[3]]);
                assert!(x.is_finite(), "{accessor}: element {k} holds {x}");
            }
        }
    }
}

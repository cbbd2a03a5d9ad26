//! Models that are drawn, with what texts call them.

use crate::asset::{Model, Primitive, is_hidden};
use crate::cli::drawing::{DrawnShape, NormalChoice};
use crate::cli::input_files::{in_file, open_model};
use crate::cli::terminal::{CliFailure, listed, say};
use glam::DVec3;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A model to draw, with the path that it came from, for texts.
pub(super) struct ModelToDraw<'a> {
    pub(super) path: &'a Path,
    pub(super) model: Model,
    pub(super) shape: DrawnShape,
}

impl<'a> ModelToDraw<'a> {
    pub(super) fn open(path: &'a PathBuf, normals: NormalChoice) -> Result<Self, CliFailure> {
        let model = open_model(path)?;
        let shape = DrawnShape::of_model(&model, normals).map_err(|e| in_file(path, e))?;
        Ok(Self { path, model, shape })
    }

    /// Draws it in its own base colours from now on, where it has any.
    pub(super) fn wear_materials(&mut self) -> Result<(), CliFailure> {
        let faults = self.shape.wear_materials().map_err(|e| in_file(self.path, e))?;
        for fault in faults {
            say!("warning: {}: {fault}", self.path.display());
        }
        Ok(())
    }

    /// Leaves out all primitives but those that are named; where none is, those that are not for the eye, if there are others.
    pub(super) fn keep_primitives(&mut self, names: &[String]) -> Result<(), CliFailure> {
        let primitives = &self.model.primitives;
        let chosen = if names.is_empty() {
            let is_shown = |k: &usize| !is_hidden(&primitives[*k].name);
            let shown: Vec<usize> = (0..primitives.len()).filter(is_shown).collect();
            if shown.is_empty() || shown.len() == primitives.len() {
                return Ok(());
            }
            let hidden: Vec<&str> = (primitives.iter().map(|p| p.name.as_str()))
                .filter(|name| is_hidden(name))
                .collect();
            say!(
                "{}: coarser levels of detail and hulls are not drawn, {}; --primitive draws what it names",
                self.path.display(),
                listed(hidden.iter(), ", which pliant inspect --json lists")
            );
            shown
        } else {
            choose_primitives(primitives, names).map_err(|e| e.in_place(self.path.display()))?
        };
        let mut kept = vec![false; self.model.triangles.len()];
        let mut first = 0;
        for (k, (_, run)) in self.model.triangles_of_primitives().enumerate() {
            kept[first..first + run.len()].fill(chosen.contains(&k));
            first += run.len();
        }
        self.shape.keep_triangles(|t| kept[t]);
        Ok(())
    }

    pub(super) fn vertex_count(&self) -> usize {
        self.model.positions.len()
    }

    /// The nodes of its file that have names, and where they are.
    pub(super) fn nodes(&self) -> Result<Vec<(String, DVec3)>, CliFailure> {
        let nodes = self.model.nodes().map_err(|e| in_file(self.path, e))?;
        // The node of a mesh says less of where that is than the mesh itself.
        let is_mesh = |name: &str| self.model.primitives.iter().any(|p| p.name == name);
        let named = nodes
            .into_iter()
            .flatten()
            .filter(|n| !n.name.is_empty() && !is_mesh(&n.name));
        Ok(named.map(|n| (n.name, n.world_from_node.translation)).collect())
    }
}

/// The primitives that are named, in the order of the model; a number, as `pliant inspect` counts them, where none is named so.
///
/// # Errors
/// A name that none has, with those that there are; primitives without a triangle.
fn choose_primitives(primitives: &[Primitive], names: &[String]) -> Result<Vec<usize>, CliFailure> {
    let refuse = |name: &str, problem: String| CliFailure::Input(format!("--primitive {name}: {problem}"));
    let mut chosen = BTreeSet::new();
    for name in names {
        let mut named: Vec<usize> = (0..primitives.len()).filter(|&k| primitives[k].name == *name).collect();
        if named.is_empty() {
            named.extend(name.parse::<usize>().ok().filter(|&k| k < primitives.len()));
        }
        if named.is_empty() {
            let names = primitives
                .iter()
                .enumerate()
                .map(|(k, p)| format!("{k} \"{}\"", p.name));
            let there = listed(names, ", which pliant inspect --json lists");
            return Err(refuse(name, format!("no primitive is named so; {there}")));
        }
        if named.iter().all(|&k| primitives[k].index_count == 0) {
            return Err(refuse(name, "it has no triangle to draw".into()));
        }
        chosen.extend(named);
    }
    Ok(chosen.into_iter().collect())
}

//! Meshes under several nodes, and the copies that part them.

use super::super::changes::DeformedAttributes;
use super::super::document::GltfDocument;
use super::super::read::GltfNotes;
use super::mesh_ref::MeshRef;
use std::collections::{BTreeMap, BTreeSet};

/// A copy of a mesh, to be appended.
pub(in super::super) struct MeshCopy {
    /// The mesh it starts from.
    pub(in super::super) of: usize,
    /// The nodes that are pointed at it.
    pub(in super::super) nodes: Vec<usize>,
}

/// The shapes that each mesh is wanted in.
pub(super) struct MeshVariants {
    pub(super) copies: Vec<MeshCopy>,
    /// Rows with changes, each with the mesh that shows them; one row for every shape.
    pub(super) changed_rows: Vec<(MeshRef, usize)>,
    /// Rows that stand for the shapes of each (mesh, primitive): one per shape.
    pub(super) rows_of: BTreeMap<(usize, usize), Vec<usize>>,
    /// Rows that also stand for the rest shape, which nodes outside the scene draw.
    staying: BTreeSet<usize>,
}

impl MeshVariants {
    /// Whether a row also stands for nodes with the rest shape.
    pub(super) fn is_also_unchanged(&self, row: usize) -> bool {
        self.staying.contains(&row)
    }
}

/// Finds the shapes of every mesh. Nodes that want the same shape share it.
pub(super) fn divide_meshes(doc: &GltfDocument<'_>, notes: &GltfNotes, wanted: &[DeformedAttributes]) -> MeshVariants {
    let mut variants = MeshVariants {
        copies: Vec::new(),
        changed_rows: Vec::new(),
        rows_of: BTreeMap::new(),
        staying: BTreeSet::new(),
    };
    // Rows come node by node, so a node's rows are neighbours.
    let mut nodes_of: BTreeMap<usize, Vec<(usize, Vec<usize>)>> = BTreeMap::new();
    for (i, row) in notes.rows.iter().enumerate() {
        let nodes = nodes_of.entry(row.mesh).or_default();
        match nodes.last_mut().filter(|(node, _)| *node == row.node) {
            Some((_, rows)) => rows.push(i),
            None => nodes.push((row.node, vec![i])),
        }
    }
    let mut outsiders: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, node) in doc.nodes.values.iter().enumerate() {
        if let Some(mesh) = node.mesh.filter(|_| notes.placed.binary_search(&i).is_err()) {
            outsiders.entry(mesh.index()).or_default().push(i);
        }
    }
    for (mesh, nodes) in nodes_of {
        let outside = outsiders.remove(&mesh).unwrap_or_default();
        variants.add_variants(notes, wanted, mesh, nodes, outside);
    }
    variants
}

impl MeshVariants {
    fn add_variants(
        &mut self,
        notes: &GltfNotes,
        wanted: &[DeformedAttributes],
        mesh: usize,
        nodes: Vec<(usize, Vec<usize>)>,
        outside: Vec<usize>,
    ) {
        let same = |a: &[usize], b: &[usize]| a.iter().zip(b).all(|(&a, &b)| wanted[a].is_same(&wanted[b]));
        let at_rest = |rows: &[usize]| !rows.iter().any(|&row| wanted[row].is_changed());
        // The first node of the scene keeps the mesh, whatever shape it wants.
        let mut shapes: Vec<(Vec<usize>, Vec<usize>)> = Vec::new();
        // Thousands of instances may each have a shape of their own.
        let mut known: BTreeMap<Vec<u64>, Vec<usize>> = BTreeMap::new();
        for (node, rows) in nodes {
            let alike = known
                .entry(rows.iter().map(|&row| wanted[row].fingerprint()).collect())
                .or_default();
            match alike.iter().find(|&&i| same(&shapes[i].0, &rows)) {
                Some(&i) => shapes[i].1.push(node),
                None => {
                    alike.push(shapes.len());
                    shapes.push((rows, vec![node]));
                }
            }
        }
        // Nodes outside the scene were not deformed.
        let mut rest_copy = None;
        if !outside.is_empty() {
            match shapes.iter_mut().find(|(shape, _)| at_rest(shape)) {
                Some((_, users)) => users.extend(outside),
                None => rest_copy = Some(outside),
            }
        }
        for (i, (rows, users)) in shapes.into_iter().enumerate() {
            let at = if i == 0 {
                MeshRef::Original(mesh)
            } else {
                self.copies.push(MeshCopy { of: mesh, nodes: users });
                MeshRef::Copy(self.copies.len() - 1)
            };
            for row in rows {
                self.rows_of
                    .entry((mesh, notes.rows[row].primitive))
                    .or_default()
                    .push(row);
                if wanted[row].is_changed() {
                    self.changed_rows.push((at, row));
                }
                if i == 0 && rest_copy.is_some() {
                    self.staying.insert(row);
                }
            }
        }
        if let Some(nodes) = rest_copy {
            self.copies.push(MeshCopy { of: mesh, nodes });
        }
    }
}

//! Graphs of real meshes; needs the data folder.

use crate::support::data::data_bytes;
use glam::DVec3;
use pliant::exec::Exec;
use pliant::graph::volume;
use pliant::mesh::{Adjacency, mean_edge_length};
use pliant::pool::Pool;
use pliant::progress::Silent;
use shapes::Shape;

use crate::support::shapes;

#[test]
fn real_meshes_get_the_node_counts_of_the_paper() {
    let Some(bytes) = data_bytes("meshes/armadillo.obj") else {
        return;
    };
    let text = String::from_utf8(bytes).expect("a text");
    let mut shape: Shape = Default::default();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let c: Vec<f64> = words.map(|w| w.parse().expect("a coordinate")).collect();
                shape.0.push(DVec3::new(c[0], c[1], c[2]));
            }
            Some("f") => {
                let index = |w: &str| {
                    w.split('/')
                        .next()
                        .and_then(|i| i.parse::<u32>().ok())
                        .expect("an index")
                        - 1
                };
                let c: Vec<u32> = words.map(index).collect();
                shape.1.push([c[0], c[1], c[2]]);
            }
            _ => {}
        }
    }
    let mesh = shapes::mesh(&shape);
    let graph = volume(
        &mesh,
        &shapes::paper_graph(),
        &Exec::new(&Pool::new(2).expect("threads start"), &Silent),
    )
    .expect("valid options")
    .expect("an inside");
    shapes::check_graph(&graph, &mesh);
    assert_eq!((graph.surface, graph.components), (43_243, 1));
    assert!((125_000..132_000).contains(&graph.nodes()), "{} nodes", graph.nodes());
    let degree = graph.neighbours.len() as f64 / graph.nodes() as f64;
    assert!((11.4..11.9).contains(&degree), "{degree} neighbours per node");
    let report = shapes::report(&shape.0, &shape.1);
    assert!(report.closed && report.warnings.is_empty() && (graph.stats.enclosed_volume - report.volume).abs() < 1e-12);
    let edges = Adjacency::build(mesh.positions.len(), &mesh.triangles).edges;
    assert_eq!(graph.stats.shell_offset, mean_edge_length(&mesh.positions, &edges));
}

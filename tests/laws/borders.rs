//! What is free leaves a hard handle in its direction.

use crate::support::bench;
use crate::support::messages::DeformerMessages;

use bench::*;
use glam::{DQuat, DVec3};
use pliant::asset::shapes;
use pliant::deform::exp_rotation;
use pliant::engine::{HandlePoses, Recipe, SolveMode, SolveSettings};
use pliant::exec::Exec;
use pliant::progress::Silent;

/// The distance of two rows of vertices.
const ROW: f64 = 0.05;

/// A round bar of 60 rows, and one with a neck and a head like a chess pawn's.
fn bar_and_head() -> [Shape; 2] {
    let bar = shapes::cylinder(0.5, 60.0 * ROW, 40, 60, true);
    let width = |z: f64| 1.0 - 0.5 * f64::exp(-((z - 1.2) / 0.35).powi(2));
    let narrowed = |p: &DVec3| DVec3::new(p.x * width(p.z), p.y * width(p.z), p.z);
    let head = (bar.0.iter().map(narrowed).collect(), bar.1.clone());
    [bar, head]
}

/// An edge between a row and the one below it.
struct Rung {
    /// The row of its upper end.
    row: i32,
    middle: DVec3,
    /// How long it is to what it was.
    stretch: f64,
    /// How far it is from the handle's direction, to its length.
    strain: f64,
}

fn rungs((rest, faces): &Shape, now: &[DVec3], turned: DQuat) -> Vec<Rung> {
    let row = |v: u32| (rest[v as usize].z / ROW).round() as i32;
    let edges = faces.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
    let rungs = edges.filter(|&(a, b)| row(a) == row(b) + 1);
    rungs
        .map(|(a, b)| {
            let [was, is] = [rest.as_slice(), now].map(|at| at[a as usize] - at[b as usize]);
            Rung {
                row: row(a),
                middle: (rest[a as usize] + rest[b as usize]) * 0.5,
                stretch: is.length() / was.length(),
                strain: is.distance(turned * was) / was.length(),
            }
        })
        .collect()
}

#[test]
fn what_is_free_leaves_a_hard_handle_in_its_direction() {
    let [bar, head] = bar_and_head();
    // What is free, as rows, and how the upper end is turned.
    let cases = [
        (&bar, [10, 50], DVec3::X * 1.75),
        (&head, [16, 32], DVec3::Z * 1.05),
        (&head, [16, 32], DVec3::X * 0.8),
    ];
    for (shape, [from, to], turned) in cases {
        let mut bench = bench(shape);
        let height = |row: i32| f64::from(row) * ROW;
        let handles = [
            handle("base", below(height(from) + 0.01)),
            handle("top", above(height(to) - 0.01)),
        ];
        set(&mut bench, handles.into());
        let pivot = DVec3::Z * height(from + to) * 0.5;
        let poses = bench.change_poses_message(&bench.initial_poses(), &pose(&[("top", turn(turned, pivot))]));
        let poses: HandlePoses = poses.expect("a pose");
        let threads = pool(2);
        let mut commit = |recipe: Recipe| {
            let settings = SolveSettings {
                recipe,
                ..SolveSettings::default()
            };
            let exec = Exec::new(&threads, &Silent);
            let solved = bench.solve(&poses, &settings, SolveMode::Commit, &exec, &mut |_| true);
            solved.expect("solved").positions.to_vec()
        };
        let [now, before] = [Recipe::SmoothBorders, Recipe::Unbuckled].map(&mut commit);
        let rotation = exp_rotation(turned);
        let held = shape.0.iter().zip(&now).filter(|(p, _)| p.z > height(to) - 0.01);
        let off = held.map(|(p, x)| x.distance(pivot + rotation * (*p - pivot)));
        assert!(off.fold(0.0, f64::max) < 1e-9, "what is held is where it is to be");

        let [now, before] = [now, before].map(|at| rungs(shape, &at, rotation));
        let at_row = |rungs: &[Rung], row: i32| {
            let strains = rungs.iter().filter(|r| r.row == row).map(|r| r.strain);
            strains.clone().sum::<f64>() / strains.count() as f64
        };
        let [at_edge, further] = [to, to - 2].map(|row| at_row(&now, row) / at_row(&before, row));
        println!("{turned}: strain of border edges {at_edge:.2} of what it was, two rows further {further:.2}");
        assert!(at_edge < 0.6, "{turned}: {at_edge} of the strain is left at the edge");
        assert!(further < 1.25, "{turned}: {further} of the strain two rows further");
        for border in now.iter().filter(|r| r.row == to) {
            let near = now
                .iter()
                .filter(|r| r.row == to - 2 && r.middle.distance(border.middle) < 4.0 * ROW);
            let most = near.map(|r| r.stretch).fold(0.0, f64::max);
            assert!(border.stretch < 1.1 * most, "{} beside {most}", border.stretch);
        }
    }
}

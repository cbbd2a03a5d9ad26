//! The promises of levels on graphs without any order, large enough for several threads: what parallel sweeps and their unsafe
//! code rely on, after a build and after each repair.

use super::tests::{EditableRows, RowsCast, check_levels, difference};
use crate::build::hierarchy::Hierarchy;
use crate::options::Constraints;
use crate::repair::change::GraphChange;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Silent;
use std::collections::BTreeMap;

/// Numbers that look random and are the same everywhere.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, end: u32) -> u32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % u64::from(end)) as u32
    }

    /// From 0 to 1.
    fn share(&mut self) -> f64 {
        f64::from(self.below(1 << 24)) / f64::from(1 << 24)
    }
}

/// Vertices anywhere in a box, denser to one side, each with edges to what is near; some with hundreds of edges across the
/// whole box, some with none; weights over six decades.
fn irregular(seed: u64, vertices: u32) -> EditableRows {
    let mut numbers = Numbers(seed);
    let positions: Vec<[f64; 3]> = (0..vertices)
        .map(|_| {
            let x = numbers.share();
            [30.0 * x * x, 30.0 * numbers.share(), 30.0 * numbers.share()]
        })
        .collect();
    let cell = |p: &[f64; 3]| p.map(|c| c as i32);
    let mut cells: BTreeMap<[i32; 3], Vec<u32>> = BTreeMap::new();
    for (i, p) in (0u32..).zip(&positions) {
        cells.entry(cell(p)).or_default().push(i);
    }
    let mut edges = BTreeMap::new();
    let mut connect = |a: u32, b: u32, weight: f32| {
        if a != b && !a.is_multiple_of(997) && !b.is_multiple_of(997) {
            edges.insert((a, b), weight);
            edges.insert((b, a), weight);
        }
    };
    for (a, p) in (0u32..).zip(&positions) {
        let [x, y, z] = cell(p);
        let beside = [[x, y, z], [x + 1, y, z], [x, y + 1, z], [x, y, z + 1]];
        for near in beside.iter().filter_map(|c| cells.get(c)) {
            let b = near[numbers.below(near.len() as u32) as usize];
            connect(a, b, 10f64.powf(6.0 * numbers.share() - 3.0) as f32);
        }
    }
    for _ in 0..8 {
        let hub = numbers.below(vertices);
        for _ in 0..300 {
            connect(hub, numbers.below(vertices), 1.0);
        }
    }
    EditableRows::new(positions, edges)
}

fn repair(hierarchy: &mut Hierarchy, before: &RowsCast, after: &RowsCast, pool: &Pool) -> bool {
    let (new_from_old, touched) = difference(before, after);
    let change = GraphChange {
        new_from_old: &new_from_old,
        touched: &touched,
    };
    let exec = Exec::new(pool, &Silent);
    !hierarchy
        .repair(&after.view(), &change, &exec)
        .expect("repaired")
        .rebuilt
}

/// Sweeps every row once, on several threads and on one: the same bits, which a row that is written while it is read would spoil.
fn sweeps_agree(hierarchy: &Hierarchy, cast: &RowsCast, pools: &[Pool; 2]) {
    let n = cast.positions.len();
    let fixed: Vec<bool> = (0..n).map(|i| i % 50 == 0).collect();
    let constraints = Constraints {
        fixed: &fixed,
        stiffness: None,
    };
    let rhs: Vec<f64> = (0..n).map(|i| (i % 13) as f64 - 6.0).collect();
    let solved = pools.each_ref().map(|pool| {
        let system = hierarchy.constrain(&constraints, pool).expect("a system");
        let mut x = vec![0.0; n];
        let solving = system.equations(hierarchy, 1, &rhs).solve(
            &mut x,
            &Default::default(),
            &mut Default::default(),
            &Exec::new(pool, &Silent),
            &mut |_| crate::solve::group::SolveControl::Continue,
        );
        solving.expect("solved");
        x.iter().map(|x| x.to_bits()).collect::<Vec<u64>>()
    });
    assert!(solved[0] == solved[1]);
}

#[test]
fn graphs_without_order_keep_the_promises_through_builds_and_repairs_on_several_threads() {
    let pools = [Pool::new(4).expect("four threads"), Pool::new(1).expect("one thread")];
    for seed in [1, 2] {
        let mut clay = irregular(seed, 24_000);
        let mut before = clay.cast();
        let build = |cast: &RowsCast| {
            Hierarchy::build(&cast.view(), &Default::default(), &Exec::new(&pools[0], &Silent)).expect("built")
        };
        let mut hierarchy = build(&before);
        assert!(
            hierarchy.levels.iter().filter(|l| l.rows() >= 8192).count() >= 2,
            "levels that threads share"
        );
        check_levels(&hierarchy, &before.view());
        sweeps_agree(&hierarchy, &before, &pools);
        let mut numbers = Numbers(seed + 100);
        let mut repaired = 0;
        for step in 0..6 {
            let p = [0; 3].map(|_| 30.0 * numbers.share());
            match step % 3 {
                0 => clay.bite(p, 2.0 + 3.0 * numbers.share()),
                1 => (0..40).for_each(|k| clay.grow([p[0], p[1], p[2] + 0.1 * f64::from(k)], 1.5)),
                _ => clay.disconnect(p),
            }
            let after = clay.cast();
            repaired += usize::from(repair(&mut hierarchy, &before, &after, &pools[0]));
            check_levels(&hierarchy, &after.view());
            before = after;
        }
        assert!(repaired >= 4, "{repaired} of 6 were repaired, not rebuilt");
        sweeps_agree(&hierarchy, &before, &pools);
    }
}

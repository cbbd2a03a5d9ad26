//! Laws of the operators, and what cycles of the several readings do.

use crate::build::hierarchy::Hierarchy;
use crate::lanes::{WIDTH, WideLanes};
use crate::options::{BuildOptions, CoarseOperators, Constraints, InitialGuess, SolveMethod, SolveOptions, SolveStats};
use crate::paper::hierarchy::PaperHierarchy;
use crate::paper::iterate::{PaperVectors, vectors};
use crate::paper::level::LevelEquations;
use crate::paper::restrict::{
    EdgeOffsets, OperatorReading, add_correction_from, prolong, restrict_defect, restricted_constants,
};
use crate::paper::smooth::defect;
use crate::paper::testing::{held, lattice, paper, path, sheet};
use crate::solve::group::{SolveControl, Workspace};
use crate::testing::{BoxLattice, pool};
use pliant_exec::Exec;
use pliant_exec::progress::Silent;

/// Reproducible numbers between −1 and 1.
fn noise(count: usize) -> Vec<WideLanes> {
    let mut state = 1u64;
    let mut next = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as f64 / f64::from(1u32 << 30) - 1.0
    };
    (0..count).map(|_| std::array::from_fn(|_| next())).collect()
}

/// d that a field of positions satisfies exactly.
struct FieldOffsets<'a>(&'a [WideLanes]);

impl EdgeOffsets for FieldOffsets<'_> {
    fn d(&self, _: usize, i: usize, j: usize) -> WideLanes {
        std::array::from_fn(|c| self.0[i][c] - self.0[j][c])
    }
}

/// d that were stored.
struct KeptOffsets(Vec<WideLanes>);

impl EdgeOffsets for KeptOffsets {
    fn d(&self, e: usize, _: usize, _: usize) -> WideLanes {
        self.0[e]
    }
}

fn apart(a: &[WideLanes], b: &[WideLanes]) -> f64 {
    let far = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs());
    far.fold(0.0, f64::max)
}

fn norm(v: &[WideLanes]) -> f64 {
    v.iter().flatten().map(|v| v * v).sum::<f64>().sqrt()
}

#[test]
fn weights_are_symmetric_and_nothing_is_negative() {
    let (_, system) = held(&lattice(7).weighted(), 10);
    let paper = paper(&system);
    assert!(paper.levels.len() > 2);
    for (s, chain) in paper.chains.iter().enumerate() {
        for (k, equations) in chain.iter().enumerate() {
            let level = &paper.levels[s + k];
            assert!(equations.alphas.iter().all(|a| *a >= 0.0));
            for i in 0..level.vertices() {
                for (e, j) in level.edges(i) {
                    let back = level.edges(j).find(|(_, k)| *k == i).unwrap().0;
                    assert!(equations.weights[e] > 0.0);
                    assert_eq!(equations.weights[e].to_bits(), equations.weights[back].to_bits());
                }
            }
        }
    }
}

#[test]
fn holding_neighbours_at_zero_makes_stiffer_and_less_joined_equations() {
    let (_, system) = held(&lattice(7), 10);
    let paper = paper(&system);
    let (pruned, still) = (&paper.chains[1][0], &paper.chains[0][1]);
    assert!(pruned.weights.iter().zip(&still.weights).all(|(p, h)| h <= p));
    assert!(pruned.alphas.iter().zip(&still.alphas).all(|(p, h)| h >= p));
    // α of the pruned equations comes from the constraints alone, here one plane.
    let total = |e: &LevelEquations| e.alphas.iter().sum::<f64>() / e.weights.iter().sum::<f64>();
    assert!(
        total(still) > 0.3 && total(pruned) < 0.2,
        "{} {}",
        total(still),
        total(pruned)
    );
}

#[test]
fn a_field_that_satisfies_all_d_survives_restriction_and_prolongation() {
    // (14), (18) to (22): any field, not only affine ones, as long as d and β are its own.
    let (_, system) = held(&lattice(6).weighted(), 10);
    let paper = paper(&system);
    let (level, coarse) = (&paper.levels[0], &paper.levels[1]);
    let (fine, restricted) = (&paper.chains[0][0], &paper.chains[1][0]);
    let field = noise(level.vertices());
    let beta: Vec<WideLanes> = field.iter().zip(&fine.alphas).map(|(x, a)| x.map(|x| a * x)).collect();
    let offsets = FieldOffsets(&field);
    let (b, d) = restricted_constants(level, fine, &beta, &offsets, coarse, restricted);
    let elevated: Vec<WideLanes> = level.seeds.iter().map(|&j| field[j as usize]).collect();
    let kept = KeptOffsets(d);
    for (c, b) in b.iter().enumerate() {
        // Each difference is met on its own, and so is what the constraints ask.
        for (e, k) in coarse.edges(c) {
            let want = FieldOffsets(&elevated).d(e, c, k);
            assert!(apart(&[kept.d(e, c, k)], &[want]) < 1e-12);
        }
        assert!(apart(&[*b], &[elevated[c].map(|x| restricted.alphas[c] * x)]) < 1e-11);
    }
    let mut back = vec![[0.0; WIDTH]; level.vertices()];
    prolong(level, fine, &beta, &offsets, &elevated, &mut back);
    assert!(apart(&back, &field) < 1e-12);
}

#[test]
fn without_constraints_near_by_constants_are_prolonged_and_corrections_are_damped() {
    let (_, system) = held(&lattice(6), 10);
    let paper = paper(&system);
    let (level, fine) = (&paper.levels[0], &paper.chains[0][0]);
    let (ones, zero) = (
        vec![[1.0; WIDTH]; paper.levels[1].vertices()],
        vec![[0.0; WIDTH]; level.vertices()],
    );
    let (mut harmonic, mut correction) = (zero.clone(), zero.clone());
    prolong(level, fine, &zero, &super::iterate::ZeroOffsets, &ones, &mut harmonic);
    add_correction_from(level, fine, OperatorReading::Held, &ones, &zero, &mut correction);
    for i in (0..level.vertices()).filter(|&i| fine.alphas[i] == 0.0) {
        assert!((harmonic[i][0] - 1.0).abs() < 1e-15, "(14) keeps constants");
        let all = level.to_retained(i).count() == 0 || level.elevated[i] != crate::paper::level::RETAINED;
        assert!(
            correction[i][0] <= 1.0 + 1e-15 && (all || correction[i][0] < 1.0),
            "(17) does not"
        );
    }
}

#[test]
fn restriction_of_defects_is_the_transpose_of_their_prolongation() {
    let (_, system) = held(&lattice(6).weighted(), 10);
    let paper = paper(&system);
    let (level, fine) = (&paper.levels[0], &paper.chains[0][0]);
    for reading in [OperatorReading::Held, OperatorReading::Pruned] {
        let (zeta, e) = (noise(level.vertices()), noise(paper.levels[1].vertices()));
        let mut down = vec![[0.0; WIDTH]; e.len()];
        restrict_defect(level, fine, reading, &zeta, &mut down);
        let (still, mut up) = (vec![[0.0; WIDTH]; zeta.len()], vec![[0.0; WIDTH]; zeta.len()]);
        add_correction_from(level, fine, reading, &e, &still, &mut up);
        let product = |a: &[WideLanes], b: &[WideLanes]| a.iter().zip(b).map(|(a, b)| a[0] * b[0]).sum::<f64>();
        assert!((product(&down, &e) - product(&zeta, &up)).abs() < 1e-10);
    }
}

/// Residuals of the finest equations over b after each of `cycles` cycles from 0.
fn residuals(paper: &PaperHierarchy, reading: OperatorReading, cycles: usize) -> Vec<f64> {
    let mut levels: Vec<PaperVectors> = vectors(paper);
    let (level, equations) = (&paper.levels[0], &paper.chains[0][0]);
    let b = noise(level.vertices());
    levels[0].b.clone_from(&b);
    let mut r = vec![[0.0; WIDTH]; b.len()];
    let mut history = vec![1.0];
    for _ in 0..cycles {
        paper.descend(0, 0, reading, &mut levels, &Silent).unwrap();
        defect(level, equations, &b, &levels[0].x, &mut r);
        history.push(norm(&r) / norm(&b));
    }
    history
}

/// Mean factor over the last half of a history.
fn factor(history: &[f64]) -> f64 {
    let half = history.len() / 2;
    let (from, to) = (history[half], history[history.len() - 1]);
    libm::pow(to / from, 1.0 / (history.len() - 1 - half) as f64)
}

#[test]
fn on_a_path_nothing_is_simplified_and_one_cycle_is_exact() {
    let block = path(1001);
    let (_, system) = held(&block, 10);
    let history = residuals(paper(&system), OperatorReading::Held, 2);
    assert!(history[1] < 1e-10, "{history:?}");
}

#[test]
fn cycles_hardly_reduce_smooth_errors_of_volumes_and_surfaces() {
    let (_, system) = held(&lattice(16), 50);
    let volume = factor(&residuals(paper(&system), OperatorReading::Held, 40));
    assert!((0.95..0.99).contains(&volume), "{volume}");
    let (_, system) = held(&sheet(60), 50);
    let surface = factor(&residuals(paper(&system), OperatorReading::Held, 40));
    assert!((0.95..0.995).contains(&surface), "{surface}");
}

#[test]
fn with_the_pruned_operators_for_defects_cycles_diverge_on_volume_graphs() {
    let (_, mut system) = held(&lattice(16), 50);
    let mut paper = system.paper.take().unwrap();
    // The restricted originals become the one chain.
    let originals = paper
        .chains
        .iter_mut()
        .map(|chain| std::mem::take(&mut chain[0]))
        .collect();
    paper.chains = vec![originals];
    let last = paper.inverses.pop().unwrap();
    paper.inverses = vec![last];
    let pruned = factor(&residuals(&paper, OperatorReading::Pruned, 6));
    assert!(pruned > 10.0, "{pruned}");
    // (17) for the transfer but (19) as printed: slow here, and it diverges on larger graphs.
    let mixed = factor(&residuals(&paper, OperatorReading::Held, 20));
    assert!(mixed > 0.9, "{mixed}");
}

/// Solves for the map x → R x + t, prescribed where vertices are fixed, with frames that say the same.
fn rigid(block: &BoxLattice, start: bool, most: usize) -> (f64, SolveStats) {
    let (hierarchy, system) = held(block, 10);
    let (s, c) = (libm::sin(1.1), libm::cos(1.1));
    // Frames are single precision; so must be what they are compared with.
    let (s, c) = (s as f32, c as f32);
    let frames = vec![[c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0]; block.positions.len()];
    let turn = |v: [f64; 3]| {
        [
            f64::from(c) * v[0] - f64::from(s) * v[1],
            f64::from(s) * v[0] + f64::from(c) * v[1],
            v[2],
        ]
    };
    let want: Vec<f64> = block.positions.iter().flat_map(|&p| turn(p).map(|v| v + 7.0)).collect();
    let (mut rhs, mut x) = (vec![0.0; want.len()], vec![0.0; want.len()]);
    for (i, p) in block.positions.iter().enumerate() {
        for e in block.offsets[i] as usize..block.offsets[i + 1] as usize {
            let q = block.positions[block.neighbours[e] as usize];
            let w = block.weights.as_ref().map_or(1.0, |w| f64::from(w[e]));
            let d = turn([p[0] - q[0], p[1] - q[1], p[2] - q[2]]);
            (0..3).for_each(|k| rhs[3 * i + k] += w * d[k]);
        }
        if p[0] == 0.0 {
            x[3 * i..3 * i + 3].copy_from_slice(&want[3 * i..3 * i + 3]);
        }
    }
    let options = SolveOptions {
        start: match start {
            true => InitialGuess::FullMultigrid {
                frames: Some(&frames),
                rest: None,
            },
            false => InitialGuess::Zero,
        },
        max_iterations: most,
        ..SolveOptions::default()
    };
    let mut go_on = |_: &crate::IterationReport<'_>| SolveControl::Continue;
    let mut workspace = Workspace::default();
    let stats = system
        .equations(&hierarchy, 3, &rhs)
        .solve(
            &mut x,
            &options,
            &mut workspace,
            &Exec::new(&pool(), &Silent),
            &mut go_on,
        )
        .unwrap();
    let far = x.iter().zip(&want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    (far, stats)
}

#[test]
fn full_multigrid_begins_with_a_rigid_motion_exactly() {
    for block in [lattice(7), lattice(7).weighted()] {
        let (far, stats) = rigid(&block, true, 0);
        assert!(far < 1e-10 && stats.residual < 1e-12, "{far} {stats:?}");
        let (far, _) = rigid(&block, false, 0);
        assert!(far > 1.0, "the test asks something");
    }
}

#[test]
fn levels_are_reported_and_shrink_as_the_paper_says() {
    let (hierarchy, system) = held(&lattice(14), 100);
    let facts = system.level_sizes().unwrap();
    assert_eq!(facts[0].vertices, system.free_count());
    for pair in facts.windows(2) {
        let ratio = pair[0].vertices as f64 / pair[1].vertices as f64;
        assert!((2.5..9.0).contains(&ratio), "{facts:?}");
    }
    assert!(facts[facts.len() - 1].vertices <= 100);
    assert_eq!(
        hierarchy.vertices(),
        2 * 14 * 14 * 14,
        "the hierarchy itself has all vertices"
    );
}

#[test]
fn few_free_vertices_are_solved_directly() {
    let block = BoxLattice::new(5, 5, 5);
    let options = BuildOptions {
        operators: CoarseOperators::Paper,
        ..BuildOptions::default()
    };
    let hierarchy = Hierarchy::build(&block.view(), &options, &Exec::new(&pool(), &Silent)).unwrap();
    let fixed: Vec<bool> = block.positions.iter().map(|p| p[0] == 0.0).collect();
    let constraints = Constraints {
        fixed: &fixed,
        stiffness: None,
    };
    let system = hierarchy.constrain(&constraints, &pool()).unwrap();
    assert!(system.level_sizes().is_none());
    let (n, mut workspace) = (block.positions.len(), Workspace::default());
    let mut x = vec![0.0; n];
    let stats = system
        .equations(&hierarchy, 1, &vec![1.0; n])
        .solve(
            &mut x,
            &SolveOptions::default(),
            &mut workspace,
            &Exec::new(&pool(), &Silent),
            &mut |_| SolveControl::Continue,
        )
        .unwrap();
    assert!(stats.converged && stats.method == SolveMethod::Direct);
}

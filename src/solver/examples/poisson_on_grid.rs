//! Solves a Poisson equation on a cubic grid, prints every iteration, and shows how a solve is cancelled.
//!
//! `cargo run --release -p pliant-solver --example poisson_on_grid -- 60` solves 60³ unknowns.

use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::{CancelFlag, Progress};
use pliant_solver::{
    BuildOptions, Constraints, Error, Hierarchy, SolveControl, SolveOptions, WeightedGraph, Workspace,
};

/// Prints stages as they begin and end.
struct PrintedStages;

impl Progress for PrintedStages {
    fn report(&self, stage: &'static str, fraction: f32) {
        println!("{stage}: {:.0} %", 100.0 * fraction);
    }
}

/// Rows of the seven-point Laplacian on `side`³ vertices, and the positions of these.
fn build_grid(side: usize) -> (Vec<u32>, Vec<u32>, Vec<[f64; 3]>) {
    let number = |x: usize, y: usize, z: usize| ((x * side + y) * side + z) as u32;
    let (mut offsets, mut neighbours, mut positions) = (vec![0], Vec::new(), Vec::new());
    for x in 0..side {
        for y in 0..side {
            for z in 0..side {
                positions.push([x as f64, y as f64, z as f64]);
                // Rows list their neighbours in rising order.
                let below = [
                    (x > 0).then(|| number(x - 1, y, z)),
                    (y > 0).then(|| number(x, y - 1, z)),
                    (z > 0).then(|| number(x, y, z - 1)),
                ];
                let above = [
                    (z + 1 < side).then(|| number(x, y, z + 1)),
                    (y + 1 < side).then(|| number(x, y + 1, z)),
                    (x + 1 < side).then(|| number(x + 1, y, z)),
                ];
                neighbours.extend(below.into_iter().chain(above).flatten());
                offsets.push(neighbours.len() as u32);
            }
        }
    }
    (offsets, neighbours, positions)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let side = std::env::args().nth(1).map_or(Ok(24), |side| side.parse::<usize>())?;
    let (offsets, neighbours, positions) = build_grid(side);
    let graph = WeightedGraph {
        offsets: &offsets,
        neighbours: &neighbours,
        weights: None,
        positions: Some(&positions),
    };
    let pool = Pool::new(0)?;
    let exec = Exec::new(&pool, &PrintedStages);
    let hierarchy = Hierarchy::build(&graph, &BuildOptions::default(), &exec)?;
    for (level, size) in hierarchy.level_sizes().iter().enumerate() {
        println!("level {level}: {} vertices, {} edges", size.vertices, size.edges);
    }

    // The floor of the box is held at 0, a unit load pulls everywhere else.
    let fixed: Vec<bool> = positions.iter().map(|p| p[2] == 0.0).collect();
    let constraints = Constraints {
        fixed: &fixed,
        stiffness: None,
    };
    let system = hierarchy.constrain(&constraints, &pool)?;
    let (rhs, mut x) = (vec![1.0; fixed.len()], vec![0.0; fixed.len()]);
    let options = SolveOptions {
        tolerance: Some(1e-8),
        ..SolveOptions::default()
    };
    let mut workspace = Workspace::default();
    let stats =
        system
            .equations(&hierarchy, 1, &rhs)
            .solve(&mut x, &options, &mut workspace, &exec, &mut |iteration| {
                println!("iteration {}: residual {:.1e}", iteration.index, iteration.residual);
                SolveControl::Continue
            })?;
    let highest = x.iter().copied().fold(0.0, f64::max);
    println!("{} iterations, largest value {highest:.3}", stats.iterations);

    // Another thread may raise the flag at any time; here it is up already.
    let flag = CancelFlag::default();
    flag.cancel();
    let cancelled = Exec::new(&pool, &flag);
    let answer = system
        .equations(&hierarchy, 1, &rhs)
        .solve(&mut x, &options, &mut workspace, &cancelled, &mut |_| {
            SolveControl::Continue
        });
    assert_eq!(answer, Err(Error::Cancelled));
    Ok(())
}

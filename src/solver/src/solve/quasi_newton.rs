//! Limited-memory quasi-Newton steps (Nocedal's L-BFGS) on the rows of one level, with a multigrid cycle as the first guess of the
//! inverse: what Liu, Bouaziz and Kavan (2017) do with a factorisation.

use crate::lanes::Lanes;

/// Steps that are remembered.
const DEPTH: usize = 5;

/// The last few steps and what they did to the residual.
#[derive(Debug, Default)]
pub(crate) struct StepMemory {
    pairs: Vec<StepPair>,
    last: Option<(Vec<Lanes>, Vec<Lanes>)>,
    /// What the cycle is short of, pair by pair.
    factors: Vec<f64>,
}

#[derive(Debug)]
struct StepPair {
    step: Vec<Lanes>,
    /// The residual before, less that after.
    fall: Vec<Lanes>,
    product: f64,
}

impl StepMemory {
    /// Forgets all steps.
    pub(crate) fn forget(&mut self) {
        self.pairs.clear();
        self.last = None;
    }

    /// Takes note of a residual at x, and makes of it what the cycle is to be given.
    pub(crate) fn before_cycle(&mut self, x: &[Lanes], residual: &[Lanes], right: &mut [Lanes]) {
        if let Some((last_x, last_residual)) = self.last.take() {
            let difference =
                |a: &[Lanes], b: &[Lanes]| -> Vec<Lanes> { a.iter().zip(b).map(|(a, b)| *a - *b).collect() };
            let (step, fall) = (difference(x, &last_x), difference(&last_residual, residual));
            let product = inner_product(&step, &fall);
            if product > 0.0 {
                if self.pairs.len() == DEPTH {
                    self.pairs.remove(0);
                }
                self.pairs.push(StepPair { step, fall, product });
            }
        }
        self.last = Some((x.to_vec(), residual.to_vec()));
        right.copy_from_slice(residual);
        self.factors.clear();
        self.factors.resize(self.pairs.len(), 0.0);
        for (pair, factor) in self.pairs.iter().zip(&mut self.factors).rev() {
            *factor = inner_product(&pair.step, right) / pair.product;
            add_times(right, -*factor, &pair.fall);
        }
    }

    /// Makes a step of what the cycle has made.
    pub(crate) fn after_cycle(&self, step: &mut [Lanes]) {
        for (pair, factor) in self.pairs.iter().zip(&self.factors) {
            let beta = inner_product(&pair.fall, step) / pair.product;
            add_times(step, factor - beta, &pair.step);
        }
    }
}

fn inner_product(a: &[Lanes], b: &[Lanes]) -> f64 {
    // In pieces, each in single precision but for its sum.
    const PIECE: usize = 64;
    let pieces = a.chunks(PIECE).zip(b.chunks(PIECE));
    let of_piece = |(a, b): (&[Lanes], &[Lanes])| {
        let mut sum = Lanes::ZERO;
        a.iter().zip(b).for_each(|(a, b)| sum += *a * *b);
        let [x, y, z, _] = sum.to_wide();
        x + y + z
    };
    pieces.map(of_piece).sum()
}

fn add_times(to: &mut [Lanes], factor: f64, what: &[Lanes]) {
    to.iter_mut()
        .zip(what)
        .for_each(|(to, what)| *to += *what * factor as f32);
}

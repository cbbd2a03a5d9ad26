//! The smallest value of wᵀ G w over weights that are not negative and add up to one, for up to five of them.

/// The most weights.
pub(super) const MOST: usize = 5;

/// A Gram matrix of up to five; only the first few rows and columns are read.
pub(super) type SmallGram = [[f64; MOST]; MOST];

/// Weights, and the value that they reach.
#[derive(Debug, Clone, Copy)]
pub(super) struct SimplexFit {
    pub(super) weights: [f64; MOST],
    pub(super) value: f64,
}

/// Finds them by an active-set method (Lawson and Hanson 1974) from a weight of one on the first.
/// `G` must be positive definite, if only by a ridge.
pub(super) fn fit_on_simplex(gram: &SmallGram, count: usize) -> SimplexFit {
    let mut best = 0;
    for k in 1..count {
        if gram[k][k] < gram[best][best] {
            best = k;
        }
    }
    let mut w = [0.0; MOST];
    w[best] = 1.0;
    let mut active = [false; MOST];
    active[best] = true;
    for _ in 0..4 * MOST {
        // The optimum on the active ones, or as far towards it as no weight turns negative.
        let Some(z) = equal_multipliers(gram, count, &active) else {
            break;
        };
        let mut step = 1.0f64;
        let mut leaving = None;
        for k in (0..count).filter(|&k| active[k]) {
            if z[k] <= 0.0 {
                let ratio = w[k] / (w[k] - z[k]);
                if ratio < step || leaving.is_none() {
                    step = ratio.min(step);
                    leaving = Some(k);
                }
            }
        }
        for k in (0..count).filter(|&k| active[k]) {
            w[k] += step * (z[k] - w[k]);
        }
        if let Some(k) = leaving {
            w[k] = 0.0;
            active[k] = false;
            continue;
        }
        let (value, gradient) = evaluate(gram, count, &w);
        let mut entering = None;
        let mut least = value - 1e-12 * value.abs();
        for k in (0..count).filter(|&k| !active[k]) {
            if gradient[k] < least {
                least = gradient[k];
                entering = Some(k);
            }
        }
        match entering {
            Some(k) => active[k] = true,
            None => break,
        }
    }
    let sum: f64 = w[..count].iter().sum();
    w[..count].iter_mut().for_each(|x| *x /= sum);
    SimplexFit {
        value: evaluate(gram, count, &w).0,
        weights: w,
    }
}

fn evaluate(gram: &SmallGram, count: usize, w: &[f64; MOST]) -> (f64, [f64; MOST]) {
    let mut gradient = [0.0; MOST];
    let mut value = 0.0;
    for k in 0..count {
        gradient[k] = (0..count).map(|j| gram[k][j] * w[j]).sum();
        value += w[k] * gradient[k];
    }
    (value, gradient)
}

/// Weights of the active ones, of any sign, that add up to one and see equal gradients: G z = 1, scaled.
fn equal_multipliers(gram: &SmallGram, count: usize, active: &[bool; MOST]) -> Option<[f64; MOST]> {
    let mut rows = [0; MOST];
    let mut m = 0;
    for k in (0..count).filter(|&k| active[k]) {
        rows[m] = k;
        m += 1;
    }
    let mut l = [[0.0; MOST]; MOST];
    let mut y = [0.0; MOST];
    for a in 0..m {
        let mut rhs = 1.0;
        for b in 0..=a {
            let mut sum = gram[rows[a]][rows[b]];
            for c in 0..b {
                sum -= l[a][c] * l[b][c];
            }
            if a == b {
                if sum <= 0.0 || !sum.is_finite() {
                    return None;
                }
                l[a][a] = sum.sqrt();
            } else {
                l[a][b] = sum / l[b][b];
                rhs -= l[a][b] * y[b];
            }
        }
        y[a] = rhs / l[a][a];
    }
    let mut z = [0.0; MOST];
    let mut sum = 0.0;
    for a in (0..m).rev() {
        let mut value = y[a];
        for b in a + 1..m {
            value -= l[b][a] * z[rows[b]];
        }
        z[rows[a]] = value / l[a][a];
        sum += z[rows[a]];
    }
    if sum <= 0.0 || !sum.is_finite() {
        return None;
    }
    z.iter_mut().for_each(|x| *x /= sum);
    Some(z)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The Gram matrix of points in the plane: the fit is the point of their hull nearest to the origin.
    fn gram(points: &[[f64; 2]]) -> SmallGram {
        let mut g = [[0.0; MOST]; MOST];
        for (a, p) in points.iter().enumerate() {
            for (b, q) in points.iter().enumerate() {
                g[a][b] = p[0] * q[0] + p[1] * q[1] + if a == b { 1e-13 } else { 0.0 };
            }
        }
        g
    }

    #[test]
    fn the_nearest_point_of_a_hull_is_found_inside_on_an_edge_and_at_a_corner() {
        let around = [[2.0, 0.0], [-1.0, 1.0], [-1.0, -1.0], [5.0, 5.0], [-3.0, 0.0]];
        let inside = fit_on_simplex(&gram(&around), 5);
        assert!(inside.value < 1e-10);
        let edge = fit_on_simplex(&gram(&[[1.0, 3.0], [1.0, -1.0], [4.0, 0.0]]), 3);
        assert!((edge.value - 1.0).abs() < 1e-9 && edge.weights[2] == 0.0);
        assert!((edge.weights[0] - 0.25).abs() < 1e-9 && (edge.weights[1] - 0.75).abs() < 1e-9);
        let corner = fit_on_simplex(&gram(&[[3.0, 3.0], [1.0, 1.0], [2.0, 0.5 + 1.0]]), 3);
        assert!(corner.weights[1] == 1.0 && (corner.value - 2.0).abs() < 1e-9);
    }

    #[test]
    fn equal_points_share_the_weight() {
        let same = fit_on_simplex(&gram(&[[1.0, 0.0]; 4]), 4);
        assert!((same.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12 && (same.value - 1.0).abs() < 1e-9);
    }
}

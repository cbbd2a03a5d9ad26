//! Full multigrid (figure 4): the original equations, restricted to the coarsest level, solved and brought back up.

use crate::lanes::{WIDTH, WideLanes};
use crate::paper::cycle::PaperVectors;
use crate::paper::hierarchy::PaperHierarchy;
use crate::paper::restrict::{EdgeOffsets, add, prolong, restricted_constants};
use crate::progress::{Cancelled, Progress};

/// d of the finest level, ½ (F_i + F_j) (p_i − p_j) per unit of the columns; equation (6) in terms of the linear maps F.
pub(super) struct FrameOffsets<'a> {
    /// Vertex of the caller's arrays for each vertex of the level.
    pub(super) vertices: &'a [u32],
    pub(super) frames: &'a [[f32; 9]],
    pub(super) rest: &'a [[f64; 3]],
    pub(super) unit: WideLanes,
}

impl EdgeOffsets for FrameOffsets<'_> {
    fn d(&self, _: usize, i: usize, j: usize) -> WideLanes {
        let (i, j) = (self.vertices[i] as usize, self.vertices[j] as usize);
        let (f, g) = (&self.frames[i], &self.frames[j]);
        let v: [f64; 3] = std::array::from_fn(|c| self.rest[i][c] - self.rest[j][c]);
        let mut d = [0.0; WIDTH];
        for row in 0..3 {
            let at = |column: usize| f64::from(f[3 * column + row]) + f64::from(g[3 * column + row]);
            d[row] = 0.5 * (at(0) * v[0] + at(1) * v[1] + at(2) * v[2]) / self.unit[row];
        }
        d
    }
}

/// d of a coarser level, one per entry.
struct StoredOffsets(Vec<WideLanes>);

impl EdgeOffsets for StoredOffsets {
    fn d(&self, e: usize, _: usize, _: usize) -> WideLanes {
        self.0[e]
    }
}

/// No d: each vertex wants to lie where its neighbours do, as in the Laplace equation (1).
pub(super) struct ZeroOffsets;

impl EdgeOffsets for ZeroOffsets {
    fn d(&self, _: usize, _: usize, _: usize) -> WideLanes {
        [0.0; WIDTH]
    }
}

impl PaperHierarchy {
    /// Leaves a first solution of the finest equations in `vectors[0].x`, whose right-hand side b is in `vectors[0].b`:
    /// restricts β and d to the coarsest level, solves there, and on the way back prolongs by (14), with one V-cycle on
    /// every level in between. The finest level's own cycles are the caller's.
    pub(super) fn full_multigrid(
        &self,
        finest: &dyn EdgeOffsets,
        vectors: &mut [PaperVectors],
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let last = self.levels.len() - 1;
        let mut betas = vec![self.with_offsets(0, finest, -1.0, &vectors[0].b)];
        let mut stored: Vec<StoredOffsets> = Vec::new();
        for l in 0..last {
            let offsets: &dyn EdgeOffsets = if l == 0 { finest } else { &stored[l - 1] };
            let (beta, d) = restricted_constants(
                (&self.levels[l], &self.chains[l][0], &betas[l], offsets),
                (&self.levels[l + 1], &self.chains[l + 1][0]),
            );
            stored.push(StoredOffsets(d));
            vectors[l + 1].b = self.with_offsets(l + 1, &stored[l], 1.0, &beta);
            betas.push(beta);
        }
        self.solve_coarsest(last, &mut vectors[last]);
        for l in (0..last).rev() {
            let (fine, coarse) = vectors.split_at_mut(l + 1);
            let offsets: &dyn EdgeOffsets = if l == 0 { finest } else { &stored[l - 1] };
            prolong(
                (&self.levels[l], &self.chains[l][0], &betas[l], offsets),
                &coarse[0].x,
                &mut fine[l].x,
            );
            if l > 0 {
                // The cycle overwrites the vectors below, which have served.
                self.cycle(l, &mut vectors[l..], progress)?;
            }
        }
        Ok(())
    }

    /// v_i + sign · Σ_j w_ij d_ji on level `l`: from β to b and back.
    fn with_offsets(&self, l: usize, offsets: &dyn EdgeOffsets, sign: f64, v: &[WideLanes]) -> Vec<WideLanes> {
        let (level, equations) = (&self.levels[l], &self.chains[l][0]);
        let mut out = v.to_vec();
        for (i, out) in out.iter_mut().enumerate() {
            for (e, j) in level.edges(i) {
                add(out, sign * equations.weights[e], offsets.d(e, i, j));
            }
        }
        out
    }
}

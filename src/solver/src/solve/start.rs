//! The full-multigrid start: the original equations solved from the coarsest level down (paper section 5, figure 4).
//!
//! The paper prolongs by equation (14): a vertex lies where its coarse neighbours predict it through d. The same idea
//! on aggregates: a coarse vertex carries its members along as an affine patch, x_i = x_I + F_I (p_i − c_I), with F_I
//! the mean of the members' maps s_i R_i. Equation (12) keeps its form on every level, with
//! d_IJ = ½ (F_I + F_J) (c_I − c_J) and β_I summed over the members. Without maps the patches are rigid points.

use crate::build::draft::UnitBoxMap;
use crate::constrain::mask::tie_share;
use crate::lanes::{Lanes, NO_ROW, SharedRows, WIDTH, WideLanes, add_wide};
use crate::solve::coarse_fits::CoarseFits;
use crate::solve::cycle::MultigridCycle;
use crate::solve::frame_rows::FrameRows;
use crate::solve::group::Workspace;
use crate::solve::patches::{AffinePatches, PatchMap};
use crate::solve::problem::ColumnGroup;
use crate::solve::sweep::MaskedLevel;
use crate::threads::{piece_count, piece_rows};
use pliant_exec::progress::{Cancelled, check};

/// Rows that one piece of work handles.
const PIECE: usize = 1024;
/// Aggregates whose members are asked of memory before they are needed.
const AHEAD: usize = 4;

/// The maps that carry rows along.
#[derive(Clone, Copy)]
pub(crate) enum StartMaps<'a> {
    /// By vertex, in the caller's order, with the rest positions that they belong to; without maps rows are rigid points.
    ByVertex(Option<&'a [[f32; 9]]>, Option<&'a [[f64; 3]]>),
    /// Those of the problem's own pose.
    Posed(FrameRows<'a>),
}

/// Fills the free rows of `workspace.x`, whose masked rows hold their values, with the full-multigrid start. With `fits`,
/// rotations are fitted on every coarse level.
pub(crate) fn full_multigrid(
    problem: &ColumnGroup<'_>,
    cycle: &MultigridCycle<'_>,
    maps: StartMaps<'_>,
    workspace: &mut Workspace,
    mut fits: Option<&mut CoarseFits>,
) -> Result<(), Cancelled> {
    let system = problem.system;
    let Workspace { x, patches, coarse, .. } = workspace;
    let last = system.masks.len() - 1;
    patches.resize_with(last + 1, AffinePatches::default);
    crate::solve::cycle::prepare(cycle, coarse);

    let middle = mean_of_masked(problem, x);
    let grid = cycle.grid(0);
    let finest = &mut patches[0];
    let mapped = !matches!(maps, StartMaps::ByVertex(None, _));
    finest.resize(grid.level.rows(), mapped);
    match maps {
        StartMaps::ByVertex(Some(frames), rest) => load_maps(problem, frames, rest, finest),
        StartMaps::ByVertex(None, _) => {}
        StartMaps::Posed(frames) => load_posed_maps(&grid, frames, finest),
    }
    load_equations(&grid, problem, x, middle, finest);
    for l in 0..last {
        check(cycle.progress)?;
        let (fine, below) = patches[l..].split_at_mut(1);
        restrict_equations(&cycle.grid(l), &cycle.grid(l + 1), &fine[0], &mut below[0]);
    }

    for l in (1..=last).rev() {
        check(cycle.progress)?;
        let grid = cycle.grid(l);
        let vectors = &mut coarse[l - 1..];
        defect(&grid, &patches[l], &mut vectors[0].b);
        cycle.solve(l, vectors)?;
        let here = &mut patches[l];
        for (x, z) in here.x.iter_mut().zip(&vectors[0].z) {
            *x += *z;
        }
        if let Some(fits) = fits.as_deref_mut() {
            fits.fit_level(cycle, l, here, vectors, defect)?;
            if l > 1 {
                fits.hand_down(&cycle.grid(l - 1), l - 1, &mut patches[l - 1]);
            }
        }
        if l > 1 {
            let (fine, below) = patches[l - 1..].split_at_mut(1);
            prolong(&cycle.grid(l - 1), &mut fine[0], &below[0]);
        }
    }
    if last > 0 {
        let (fine, below) = patches.split_at_mut(1);
        prolong(&grid, &mut fine[0], &below[0]);
        for (i, (x, s)) in x.iter_mut().zip(&fine[0].x).enumerate() {
            if grid.mask.free(i) {
                let s = s.to_wide();
                for c in 0..WIDTH {
                    x[c] = s[c] + middle[c];
                }
            }
        }
    }
    if !system.floating.is_empty() {
        system.floating.remove_wide_means(x);
    }
    Ok(())
}

/// Mean of the given values. The start works on differences to it, which single precision can hold.
fn mean_of_masked(problem: &ColumnGroup<'_>, x: &[WideLanes]) -> WideLanes {
    let mask = &problem.system.masks[0];
    let (mut sum, mut count) = ([0.0; WIDTH], 0usize);
    for (i, x) in x.iter().enumerate() {
        if !mask.free(i) && problem.hierarchy.order[i] != NO_ROW {
            add_wide(&mut sum, *x);
            count += 1;
        }
    }
    sum.map(|s| s / count.max(1) as f64)
}

/// Maps and positions of the finest level, in row order, from unit-box positions to the problem's inner units.
fn load_maps(problem: &ColumnGroup<'_>, frames: &[[f32; 9]], rest: Option<&[[f64; 3]]>, finest: &mut AffinePatches) {
    let hierarchy = problem.hierarchy;
    let frame = rest.map_or(hierarchy.frame, UnitBoxMap::around);
    let scale = |c: usize| frame.size / problem.unit[c];
    let scale = Lanes([scale(0) as f32, scale(1) as f32, scale(2) as f32, 0.0]);
    for (i, &v) in hierarchy.order.iter().enumerate() {
        if v == NO_ROW {
            finest.maps[i] = [Lanes::ZERO; 3];
            continue;
        }
        let f = &frames[v as usize];
        finest.maps[i] = [0, 3, 6].map(|k| Lanes([f[k], f[k + 1], f[k + 2], 0.0]) * scale);
    }
    match rest {
        None => finest.positions.copy_from_slice(&hierarchy.levels[0].positions),
        Some(rest) => {
            for (p, &v) in finest.positions.iter_mut().zip(&hierarchy.order) {
                *p = rest.get(v as usize).map_or(Lanes::ZERO, |&p| frame.apply(p));
            }
        }
    }
}

/// The same from the rows of a pose, whose units are the problem's.
fn load_posed_maps(grid: &MaskedLevel<'_>, frames: FrameRows<'_>, finest: &mut AffinePatches) {
    let vectors = (finest.maps.as_mut_slice(), finest.positions.as_mut_slice());
    grid.threads.for_each_piece(PIECE, vectors, |first, (maps, positions)| {
        for (map, row) in maps.iter_mut().zip(&frames.rows[first..]) {
            *map = row.columns();
        }
        positions.copy_from_slice(&frames.rest[first..first + positions.len()]);
    });
}

/// β and given values of the finest level: what the right-hand side holds beyond Σ w d.
fn load_equations(
    grid: &MaskedLevel<'_>,
    problem: &ColumnGroup<'_>,
    x: &[WideLanes],
    middle: WideLanes,
    finest: &mut AffinePatches,
) {
    for (i, (out, x)) in finest.x.iter_mut().zip(x).enumerate() {
        let shifted = [0, 1, 2, 3].map(|c| x[c] - middle[c]);
        *out = if grid.mask.free(i) {
            Lanes::ZERO
        } else {
            Lanes::from_wide(shifted)
        };
    }
    let mut beta = std::mem::take(&mut finest.beta);
    let patches = &*finest;
    grid.threads.for_each_piece(PIECE, beta.as_mut_slice(), |first, beta| {
        for (i, beta) in (first..).zip(beta) {
            *beta = Lanes::ZERO;
            if !grid.mask.free(i) {
                continue;
            }
            // All but what comes on top of a pose is Σ w d.
            let mut b = match problem.frames() {
                Some(frames) => frames.more_of(i),
                None => problem.rhs(i),
            };
            if let Some(s) = problem.system.stiffness.get(i) {
                for c in 0..WIDTH {
                    b[c] -= s * middle[c];
                }
            }
            let mut sum = Lanes::ZERO;
            if !patches.maps.is_empty() && problem.frames().is_none() {
                for (j, w) in grid.level.row(i) {
                    sum += patches.edge(i, j) * w;
                }
            }
            let sum = sum.to_wide();
            *beta = Lanes::from_wide([0, 1, 2, 3].map(|c| b[c] - sum[c]));
        }
    });
    finest.beta = beta;
}

/// The original equations of the next level.
fn restrict_equations(
    grid: &MaskedLevel<'_>,
    below: &MaskedLevel<'_>,
    fine: &AffinePatches,
    coarse: &mut AffinePatches,
) {
    let (level, mask) = (grid.level, grid.mask);
    let n = below.level.rows();
    let mapped = !fine.maps.is_empty();
    coarse.resize(n, mapped);
    let (maps, positions) = (
        SharedRows::new(&mut coarse.maps),
        SharedRows::new(&mut coarse.positions),
    );
    let (betas, xs) = (SharedRows::new(&mut coarse.beta), SharedRows::new(&mut coarse.x));
    grid.threads.for_each(0..piece_count(n, PIECE), |k| {
        for row in piece_rows(k, n, PIECE) {
            if row + AHEAD < n {
                fine.prefetch(level.members_of(row + AHEAD));
            }
            let members = level.members_of(row);
            let (map, centre) = if mapped {
                mean_patch(fine, members)
            } else {
                ([Lanes::ZERO; 3], Lanes::ZERO)
            };
            let (mut beta, mut given) = (Lanes::ZERO, Lanes::ZERO);
            for &i in members {
                let i = i as usize;
                if !mask.free(i) {
                    given += fine.x[i];
                    continue;
                }
                let offset = if mapped {
                    fine.offset(&map, i, centre)
                } else {
                    Lanes::ZERO
                };
                beta += fine.beta[i] - offset * mask.alpha(i);
                // No other row has neighbours that are given.
                if !mask.on_border(i) {
                    continue;
                }
                for (j, w) in level.row(i) {
                    if !mask.free(j) {
                        let share = tie_share(level, below.mask, row, j);
                        beta += (fine.x[j] + fine.edge(i, j) - offset) * (w * share);
                    }
                }
            }
            let free = below.mask.free(row);
            // SAFETY: each row is visited once.
            unsafe {
                if mapped {
                    maps.set(row, map);
                    positions.set(row, centre);
                }
                betas.set(row, if free { beta } else { Lanes::ZERO });
                xs.set(
                    row,
                    if free {
                        Lanes::ZERO
                    } else {
                        given * (1.0 / members.len().max(1) as f32)
                    },
                );
            }
        }
    });
}

/// Mean map and centroid of an aggregate. Averaging different rotations shrinks; the mean size is restored.
fn mean_patch(fine: &AffinePatches, members: &[u32]) -> (PatchMap, Lanes) {
    let size = |m: &PatchMap| {
        let squares = m[0] * m[0] + m[1] * m[1] + m[2] * m[2];
        squares.sum_lanes().sqrt()
    };
    let share = 1.0 / members.len().max(1) as f32;
    let (mut map, mut centre, mut sizes) = ([Lanes::ZERO; 3], Lanes::ZERO, 0.0f32);
    for &i in members {
        let m = &fine.maps[i as usize];
        for c in 0..3 {
            map[c] += m[c] * share;
        }
        centre += fine.positions[i as usize] * share;
        sizes += size(m) * share;
    }
    let mean = size(&map);
    if mean > 1e-3 * sizes {
        (map.map(|column| column * (sizes / mean)), centre)
    } else {
        (members.first().map_or(map, |&i| fine.maps[i as usize]), centre)
    }
}

/// β − α x − Σ w (x_i − x_j − d_ij) of free rows, 0 elsewhere.
fn defect(grid: &MaskedLevel<'_>, patches: &AffinePatches, out: &mut [Lanes]) {
    let (level, mask) = (grid.level, grid.mask);
    grid.threads.for_each_piece(PIECE, out, |first, out| {
        for (i, out) in (first..).zip(out) {
            *out = Lanes::ZERO;
            if !mask.free(i) {
                continue;
            }
            let here = patches.x[i];
            let mut r = patches.beta[i] - here * mask.alpha(i);
            for (j, w) in level.row(i) {
                r -= (here - patches.x[j] - patches.edge(i, j)) * w;
            }
            *out = r;
        }
    });
}

/// x_i = x_I + F_I (p_i − c_I) on free rows; given values stay.
fn prolong(grid: &MaskedLevel<'_>, fine: &mut AffinePatches, coarse: &AffinePatches) {
    let (level, mask) = (grid.level, grid.mask);
    let mut x = std::mem::take(&mut fine.x);
    let patches = &*fine;
    grid.threads.for_each_piece(PIECE, x.as_mut_slice(), |first, x| {
        for (i, x) in (first..).zip(x) {
            let aggregate = level.aggregates[i];
            if !mask.free(i) || aggregate == NO_ROW {
                continue;
            }
            let aggregate = aggregate as usize;
            *x = coarse.x[aggregate];
            if let Some(map) = coarse.maps.get(aggregate) {
                *x += patches.offset(map, i, coarse.positions[aggregate]);
            }
        }
    });
    fine.x = x;
}

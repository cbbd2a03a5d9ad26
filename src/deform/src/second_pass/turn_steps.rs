//! Steps towards the turns at which torques are zero, from the differences that earlier steps have made (Anderson 1965).

use glam::DVec3;

/// The longest step, radians: a turn is followed, not jumped to.
const LONGEST_STEP: f64 = 1.0;
/// The longest one that is left to the next pose of a drag.
const LONGEST_AHEAD: f64 = 0.1;
/// How much further than the surest step one goes where nothing is known of a direction, at first,
const FIRST_GUESS: f64 = 8.0;
/// and at most.
const FARTHEST: f64 = 64.0;
/// How many differences of torques are remembered.
const REMEMBERED: usize = 6;
/// A difference that is this much one of newer ones adds nothing.
const LEAST_NEW: f64 = 1e-2;
/// What shorter steps change, radians, is lost in what solves leave undone.
const LEAST_LEARNT: f64 = 4e-3;
/// A step that makes torques this much larger was wrong.
const MUCH_LARGER: f64 = 2.0;

/// What steps towards turns have shown so far: changes of turns with the changes of torques that came of them, the newest last.
#[derive(Debug, Clone, Default)]
pub(crate) struct TurnSteps {
    /// The holds whose turns they are.
    holds: Vec<usize>,
    steps: Vec<(Vec<DVec3>, Vec<DVec3>)>,
    /// The turns that the last pose of a drag was solved with, and the step from them that it has left to the next one; both empty
    /// where there is none.
    solved: Vec<DVec3>,
    ahead: Vec<DVec3>,
}

impl TurnSteps {
    /// Begins with these holds; what is known of others is forgotten.
    pub(super) fn begin(&mut self, holds: &[usize]) {
        if self.holds != holds {
            self.clear();
            self.holds = holds.to_vec();
        }
    }

    /// Leaves a step to the next pose of a drag, from the turns that this one was solved with. No longer one than
    /// [`LONGEST_AHEAD`]: nothing has shown yet where it leads.
    pub(super) fn leave_ahead(&mut self, solved: Vec<DVec3>, mut step: Vec<DVec3>) {
        shorten(&mut step, LONGEST_AHEAD);
        (self.solved, self.ahead) = (solved, step);
    }

    /// The turns to begin a pose of a drag with, whose last one was solved with `solved`.
    pub(super) fn begin_from(&mut self, mut solved: Vec<DVec3>) -> Vec<DVec3> {
        if std::mem::take(&mut self.solved) == solved {
            add(&mut solved, &self.ahead, 1.0);
        }
        solved
    }

    /// Keeps what a step has changed of the torques, `now` from what they were `before` it. A step that has made them much larger
    /// shows that what is known holds no more.
    pub(super) fn remember(&mut self, turned: Vec<DVec3>, before: &[DVec3], now: &[DVec3]) {
        if length(now) > MUCH_LARGER * length(before) {
            self.steps.clear();
            return;
        }
        if length(&turned) < LEAST_LEARNT {
            return;
        }
        let changed = now.iter().zip(before).map(|(now, before)| *now - *before).collect();
        if self.steps.len() == REMEMBERED {
            self.steps.remove(0);
        }
        self.steps.push((turned, changed));
    }

    /// The step that ends a torque as far as is known, and follows what is left of it elsewhere; and how long it would be if that
    /// gave way as far as anything does.
    pub(super) fn step(&self, torque: &[DVec3]) -> (Vec<DVec3>, f64) {
        let mut left = torque.to_vec();
        let mut step = vec![DVec3::ZERO; left.len()];
        let mut known: Vec<(Vec<DVec3>, Vec<DVec3>)> = Vec::new();
        for (turned, changed) in self.steps.iter().rev() {
            let (mut turned, mut changed) = (turned.clone(), changed.clone());
            let before = length(&changed);
            for (other, unit) in &known {
                let along = dot(&changed, unit);
                add(&mut changed, unit, -along);
                add(&mut turned, other, -along);
            }
            let size = length(&changed);
            if size <= LEAST_NEW * before || size == 0.0 {
                continue;
            }
            let scale = |all: &mut Vec<DVec3>| all.iter_mut().for_each(|v| *v /= size);
            scale(&mut turned);
            scale(&mut changed);
            let along = dot(&left, &changed);
            add(&mut left, &changed, -along);
            add(&mut step, &turned, -along);
            known.push((turned, changed));
        }
        // Turns resist far less than with all around them held, and all about as much.
        let easier = known
            .iter()
            .map(|(turned, _)| length(turned))
            .fold(FIRST_GUESS, f64::max);
        let at_most = length(&step) + FARTHEST * length(&left);
        add(&mut step, &left, -easier.min(FARTHEST));
        shorten(&mut step, LONGEST_STEP);
        (step, at_most)
    }

    pub(crate) fn clear(&mut self) {
        self.steps.clear();
        self.solved.clear();
    }

    pub(crate) fn byte_size(&self) -> usize {
        let of_pair = |pair: &(Vec<DVec3>, Vec<DVec3>)| pair.0.capacity() + pair.1.capacity();
        let of_drag = self.solved.capacity() + self.ahead.capacity();
        (self.steps.iter().map(of_pair).sum::<usize>() + of_drag) * size_of::<DVec3>()
    }
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

fn length(a: &[DVec3]) -> f64 {
    dot(a, a).sqrt()
}

fn add(to: &mut [DVec3], what: &[DVec3], times: f64) {
    to.iter_mut().zip(what).for_each(|(to, what)| *to += *what * times);
}

/// Shortens turns in proportion until none is longer than `most`.
fn shorten(turns: &mut [DVec3], most: f64) {
    let longest = turns.iter().map(|s| s.length()).fold(0.0, f64::max);
    if longest > most {
        turns.iter_mut().for_each(|s| *s *= most / longest);
    }
}

//! Outcomes of the solves that clients request.

use super::times::Times;
use std::time::Duration;
use tonic::{Code, Status};

/// Outcomes of unary solves.
#[derive(Debug, Default, Clone)]
pub(crate) struct AnswerTally {
    /// Solves that were answered.
    pub solved: u64,
    /// From request to the last part of the answer.
    pub latency: Times,
    /// From request to the rejection for lack of room.
    pub refusal: Times,
    /// Other errors.
    pub failed: u64,
    /// One of them.
    pub failure: Option<String>,
    /// How long solves were requested.
    pub elapsed: Duration,
}

impl AnswerTally {
    /// Solves answered a second.
    pub fn solves_per_second(&self) -> f64 {
        self.solved as f64 / self.elapsed.as_secs_f64().max(1e-9)
    }

    /// Enters what came of a request, and the time it took.
    pub fn enter_answer(&mut self, outcome: &Result<(), Status>, took: Duration) {
        match outcome {
            Ok(()) => {
                self.solved += 1;
                self.latency.enter(took);
            }
            Err(status) if status.code() == Code::ResourceExhausted => self.refusal.enter(took),
            Err(status) => {
                self.failed += 1;
                self.failure = Some(status.to_string());
            }
        }
    }

    /// Adds another client's tally.
    pub fn add_tally(&mut self, other: Self) {
        self.solved += other.solved;
        self.latency.add(&other.latency);
        self.refusal.add(&other.refusal);
        self.failed += other.failed;
        self.failure = self.failure.take().or(other.failure);
        self.elapsed = self.elapsed.max(other.elapsed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tally_tells_answers_refusals_and_failures_apart() {
        let (ms, mut tally) = (Duration::from_millis, AnswerTally::default());
        tally.enter_answer(&Ok(()), ms(100));
        tally.enter_answer(&Err(Status::resource_exhausted("full")), ms(2));
        tally.enter_answer(&Err(Status::internal("broken")), ms(3));
        tally.elapsed = ms(500);
        let mut both = tally.clone();
        both.add_tally(tally);
        assert_eq!((both.solved, both.refusal.count(), both.failed), (2, 2, 2));
        assert_eq!(both.solves_per_second(), 4.0);
        assert!(both.failure.is_some_and(|text| text.contains("broken")));
    }
}

//! What was sent and what came back.

use hdrhistogram::Histogram;
use pliant::wire::pb;
use serde_json::{Value, json};
use std::time::Duration;
use tonic::{Code, Status};

/// A pose ledger counts what one client, or several together, sent and got back.
#[derive(Debug, Default)]
pub(crate) struct PoseLedger {
    /// The clients that the ledger counts.
    pub clients: u32,
    /// Poses sent.
    pub sent: u64,
    /// Poses answered by a final frame.
    pub finals: u64,
    /// Poses answered by an error.
    pub refused: u64,
    /// Those of them whose error was not that the server has no room.
    pub failed: u64,
    /// Poses that frames say were skipped for newer ones.
    pub superseded: u64,
    /// Frames before the final one of their pose.
    pub intermediate: u64,
    /// Messages that carried frames.
    pub parts: u64,
    /// Bytes of vertex data.
    pub bytes: u64,
    /// Of every final frame: from when its pose was due until its last part was here.
    pub latency: Times,
    /// Of every final frame: solving, as the server says.
    pub solve: Times,
    /// Of every final frame: waiting for a compute slot, as the server says.
    pub queue: Times,
    /// From the first pose to the last frame, of the slowest client.
    pub elapsed: Duration,
    /// What is wrong beyond the sums.
    broken: Vec<String>,
    /// The frame under way: seq, and the part that is due.
    open: Option<(u64, u32)>,
    last: Option<u64>,
    last_final: bool,
}

impl PoseLedger {
    /// Enters a part of a frame; the answer is true when it completes the final frame of a pose. `latency` is that pose's so far.
    pub fn enter_part(&mut self, frame: &pb::Frame, latency: impl FnOnce(u64) -> Duration) -> bool {
        self.parts += 1;
        self.bytes += frame.data.len() as u64;
        let due = self.open.take().unwrap_or((frame.seq, 0));
        if due != (frame.seq, frame.part) {
            let (seq, part) = due;
            self.broken.push(format!(
                "part {} of frame {} came where part {part} of frame {seq} was due",
                frame.part, frame.seq
            ));
        }
        if frame.part + 1 < frame.parts {
            self.open = Some((frame.seq, frame.part + 1));
            return false;
        }
        self.superseded += u64::from(frame.superseded);
        let newer = self
            .last
            .is_none_or(|last| frame.seq > last || (frame.seq == last && !self.last_final));
        if !newer {
            self.broken.push(format!(
                "frame {} came after frame {}",
                frame.seq,
                self.last.unwrap_or_default()
            ));
        }
        (self.last, self.last_final) = (Some(frame.seq), frame.r#final);
        if !frame.r#final {
            self.intermediate += 1;
            return false;
        }
        self.finals += 1;
        self.latency.enter(latency(frame.seq));
        self.solve.enter_ms(frame.solve_ms);
        self.queue.enter_ms(frame.queue_ms);
        true
    }

    /// Enters a pose that was answered by an error with that gRPC status.
    pub fn enter_error(&mut self, status: u32) {
        self.refused += 1;
        self.failed += u64::from(status != tonic::Code::ResourceExhausted as u32);
    }

    /// Final frames a second.
    pub fn frames_per_second(&self) -> f64 {
        let seconds = self.elapsed.as_secs_f64();
        if seconds > 0.0 {
            self.finals as f64 / seconds
        } else {
            0.0
        }
    }

    /// Notes something that is wrong.
    pub fn note_problem(&mut self, text: String) {
        self.broken.push(text);
    }

    /// Adds the ledger of one more client.
    pub fn add_ledger(&mut self, other: Self) {
        self.clients += 1;
        self.sent += other.sent;
        self.finals += other.finals;
        self.refused += other.refused;
        self.failed += other.failed;
        self.superseded += other.superseded;
        self.intermediate += other.intermediate;
        self.parts += other.parts;
        self.bytes += other.bytes;
        self.latency.add(&other.latency);
        self.solve.add(&other.solve);
        self.queue.add(&other.queue);
        self.elapsed = self.elapsed.max(other.elapsed);
        self.broken.extend(other.broken);
    }

    /// Lists every inconsistency.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = self.broken.clone();
        let answered = self.finals + self.refused + self.superseded;
        if answered != self.sent {
            let Self {
                sent,
                finals,
                refused,
                superseded,
                ..
            } = self;
            problems.push(format!(
                "{sent} poses were sent, but {finals} final frames, {refused} errors and {superseded} superseded are {answered}"
            ));
        }
        problems
    }
}

/// The longest time, in microseconds; longer ones count as this one.
const LONGEST: u64 = 3_600_000_000;

/// Times by how often they occurred, to three digits.
#[derive(Debug, Clone)]
pub(crate) struct Times(Histogram<u64>);

impl Default for Times {
    fn default() -> Self {
        #[allow(clippy::expect_used)]
        Self(Histogram::new_with_bounds(1, LONGEST, 3).expect("the bounds fit each other"))
    }
}

impl Times {
    /// Enters a time.
    pub fn enter(&mut self, time: Duration) {
        let micros = u64::try_from(time.as_micros()).unwrap_or(LONGEST);
        self.0.saturating_record(micros.max(1));
    }

    /// Enters a time in milliseconds; an invalid one counts as 0.
    pub fn enter_ms(&mut self, ms: f64) {
        self.enter(Duration::try_from_secs_f64(ms / 1e3).unwrap_or_default());
    }

    /// Enters all times of another.
    pub fn add(&mut self, other: &Self) {
        // Both have the same bounds.
        let _ = self.0.add(&other.0);
    }

    /// How many there are.
    pub fn count(&self) -> u64 {
        self.0.len()
    }

    /// Milliseconds that the share `q` (0 to 1) of all does not exceed; `None` where there is none.
    pub fn share_ms(&self, q: f64) -> Option<f64> {
        (self.count() > 0).then(|| self.0.value_at_quantile(q) as f64 / 1e3)
    }

    /// The reported quantiles with their names.
    pub const SHARES: [(&str, f64); 4] = [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("max", 1.0)];

    /// The reported quantiles as cells of a table: milliseconds with so many digits after the point.
    pub fn cells(&self, digits: usize) -> [String; 4] {
        let cell = |(_, q)| match self.share_ms(q) {
            Some(ms) => format!("{ms:.digits$}"),
            None => "-".to_owned(),
        };
        Self::SHARES.map(cell)
    }

    /// The reported quantiles for programs, in milliseconds.
    pub fn to_json(&self) -> Value {
        let share = |(name, q): (&str, f64)| (name.to_owned(), json!(self.share_ms(q)));
        Value::Object(Self::SHARES.into_iter().map(share).collect())
    }
}

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
    pub fn enter_answer<T>(&mut self, outcome: &Result<T, Status>, took: Duration) {
        match outcome {
            Ok(_) => {
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

    fn frame(seq: u64, part: u32, parts: u32, last: bool, superseded: u32) -> pb::Frame {
        pb::Frame {
            seq,
            part,
            parts,
            r#final: last,
            superseded,
            data: vec![0; 12].into(),
            ..Default::default()
        }
    }

    #[test]
    fn books_balance_and_say_when_they_do_not() {
        let mut ledger = PoseLedger {
            clients: 1,
            sent: 4,
            ..Default::default()
        };
        let zero = |_| Duration::ZERO;
        assert!(!ledger.enter_part(&frame(1, 0, 2, true, 0), zero));
        assert!(ledger.enter_part(&frame(1, 1, 2, true, 0), zero));
        assert!(!ledger.enter_part(&frame(4, 0, 1, false, 2), zero));
        assert!(ledger.enter_part(&frame(4, 0, 1, true, 0), zero));
        assert_eq!(ledger.problems(), Vec::<String>::new());
        assert_eq!(
            (ledger.finals, ledger.intermediate, ledger.superseded, ledger.bytes),
            (2, 1, 2, 48)
        );
        ledger.sent = 5;
        assert!(ledger.problems()[0].contains("5 poses were sent"));
    }

    #[test]
    fn a_frame_that_goes_back_or_lacks_a_part_is_noticed() {
        let mut ledger = PoseLedger {
            sent: 2,
            ..Default::default()
        };
        ledger.enter_part(&frame(2, 0, 1, true, 0), |_| Duration::ZERO);
        ledger.enter_part(&frame(1, 1, 2, true, 0), |_| Duration::ZERO);
        let problems = ledger.problems().join("; ");
        assert!(
            problems.contains("part 1 of frame 1 came where part 0") && problems.contains("frame 1 came after frame 2"),
            "{problems}"
        );
    }

    #[test]
    fn shares_are_known_to_three_digits() {
        let mut times = Times::default();
        assert_eq!(times.share_ms(0.5), None);
        (1..=100).for_each(|ms| times.enter_ms(f64::from(ms)));
        for (q, wanted) in [(0.5, 50.0), (0.99, 99.0), (1.0, 100.0)] {
            let ms = times.share_ms(q).expect("there are times");
            assert!((ms / wanted - 1.0).abs() < 2e-3, "{q}: {ms}");
        }
        let mut both = times.clone();
        both.add(&times);
        both.enter(Duration::from_secs(100_000));
        assert_eq!(both.count(), 201);
        assert!(both.share_ms(1.0).is_some_and(|ms| ms >= 3.5e6));
    }

    #[test]
    fn a_tally_distinguishes_answers_refusals_and_failures() {
        let (ms, mut tally) = (Duration::from_millis, AnswerTally::default());
        tally.enter_answer(&Ok(()), ms(100));
        tally.enter_answer::<()>(&Err(Status::resource_exhausted("full")), ms(2));
        tally.enter_answer::<()>(&Err(Status::internal("broken")), ms(3));
        tally.elapsed = ms(500);
        let mut both = tally.clone();
        both.add_tally(tally);
        assert_eq!((both.solved, both.refusal.count(), both.failed), (2, 2, 2));
        assert_eq!(both.solves_per_second(), 4.0);
        assert!(both.failure.is_some_and(|text| text.contains("broken")));
    }
}

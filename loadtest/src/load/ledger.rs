//! What was sent and what came back.

use super::times::Times;
use pliant::wire::pb;
use std::time::Duration;

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
    /// Starts an empty ledger of one client.
    pub fn for_one_client() -> Self {
        Self {
            clients: 1,
            ..Self::default()
        }
    }

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

    /// Adds another client's ledger.
    pub fn add_ledger(&mut self, other: Self) {
        self.clients += other.clients;
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
}

//! What a frame asks of the allocator on its way to a socket: the bytes of its messages, once, and next to nothing beside.

use counting_allocator::{CountingAllocator, counted};
use glam::{DVec3, Vec3, Vec4};
use pliant::engine::Shading;
use pliant::wire::frames::{Frame, FrameEncoding, FrameOutput, SentSteps, encode_next};
use prost::Message as _;
use std::sync::Arc;

#[path = "../src/solver/tests/support/counting_allocator.rs"]
mod counting_allocator;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const VERTICES: usize = 60_000;
const PART: usize = 256 << 10;
/// Calls of the allocator for a part: its message, its head, its box, its indices; what runs the test may make some meanwhile.
const CALLS: usize = 24;
/// Bytes for a part beside its numbers: its head.
const BYTES: usize = 4 << 10;

// One test, so that nothing else in the process allocates meanwhile.
#[test]
fn frames_ask_for_the_bytes_that_are_sent() {
    let positions: Vec<DVec3> = (0..VERTICES)
        .map(|v| DVec3::new(v as f64 * 1e-3, libm::sin(v as f64 * 0.01), 0.5))
        .collect();
    let shading = Shading {
        normals: vec![Vec3::Z; VERTICES],
        tangents: vec![Vec4::X; VERTICES],
    };
    let (positions, shading) = (Arc::new(positions), Arc::new(shading));
    let encodings = [
        FrameEncoding::F32,
        FrameEncoding::U16,
        FrameEncoding::Meshopt,
        FrameEncoding::Delta,
    ];
    for encoding in encodings {
        for normals in [false, true] {
            // What differs and what has changed are not asked for together: the second round is of a frame that follows.
            let reports_differences = encoding == FrameEncoding::Delta;
            let mut held = SentSteps::default();
            for changed_only in [None, if reports_differences { None } else { Some(0.0) }] {
                let request = Frame {
                    positions: Arc::clone(&positions),
                    shading: Some(Arc::clone(&shading)),
                    output: FrameOutput {
                        normals,
                        changed_only,
                        encoding,
                        ..FrameOutput::default()
                    },
                    selected: changed_only.map(|_| (0..VERTICES as u32).step_by(2).collect()),
                    part_bytes: PART,
                    ..Frame::default()
                };
                let case = format!("{:?}", request.output);
                let is_key = held.byte_size() == 0;
                let kept = if is_key {
                    usize::try_from(request.kept_bytes()).expect("fits")
                } else {
                    0
                };
                let (mut parts, asked) = counted(|| encode_next(request.clone(), std::mem::take(&mut held)));
                assert!(
                    asked.calls <= CALLS && asked.bytes <= BYTES + VERTICES * 4 + kept,
                    "{case}: {} bytes for a frame of which no part is made",
                    asked.bytes
                );
                // What a part is made with: its indices; what meshopt takes, and the room for what it gives.
                let indices = changed_only.map_or(0, |_| PART);
                let coded = if matches!(encoding, FrameEncoding::Meshopt | FrameEncoding::Delta) {
                    3 * PART
                } else {
                    0
                };
                let mut sent_bytes = 0;
                while let (Some(part), made) = counted(|| parts.next_part()) {
                    assert!(
                        made.calls <= CALLS && made.bytes <= BYTES + coded + indices,
                        "{case}: {} calls for {} bytes before a part is sent:\n{}",
                        made.calls,
                        made.bytes,
                        made.traces.join("\n")
                    );
                    let (message, sent) = counted(|| part.encode_to_vec());
                    assert!(
                        sent.calls <= CALLS && sent.bytes <= message.len() + BYTES,
                        "{case}: {} calls for {} bytes, of which {} are sent:\n{}",
                        sent.calls,
                        sent.bytes,
                        message.len(),
                        sent.traces.join("\n")
                    );
                    sent_bytes += message.len();
                }
                assert!(!is_key || sent_bytes > 2 * BYTES, "{case}: numbers are sent");
                held = parts.into_sent();
                assert_eq!(held.byte_size(), request.kept_bytes(), "{case}");
            }
        }
    }
}

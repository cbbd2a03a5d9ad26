//! Whatever shapes follow one another, a reader of differences holds exactly the steps in the key frame's box.

use super::pb::frame;
use super::*;
use crate::Error;
use glam::Vec3Swizzles as _;
use pliant_core::engine::TopologyId;
use proptest::prelude::*;
use std::collections::BTreeMap;

/// A stream's two ends.
struct SentFrames {
    sent: SentSteps,
    reader: FrameReader,
    frames: Vec<Vec<pb::Frame>>,
}

impl SentFrames {
    fn to_reader_of(vertices: usize) -> Self {
        Self {
            sent: SentSteps::default(),
            reader: FrameReader::new(vertices),
            frames: Vec::new(),
        }
    }

    /// Sends a frame; whether it is a key frame.
    fn send(&mut self, request: Frame) -> bool {
        let kept = request.kept_bytes();
        let mut parts = encode_next(request, std::mem::take(&mut self.sent));
        let made: Vec<pb::Frame> = parts.by_ref().collect();
        self.sent = parts.into_sent();
        assert_eq!(self.sent.byte_size(), kept, "what is counted is what is held");
        for (k, part) in made.iter().enumerate() {
            let is_whole = self.reader.take(part).expect("is read");
            assert_eq!(is_whole, k + 1 == made.len());
        }
        let is_key = made.iter().all(|part| part.encoding() != frame::Encoding::Delta);
        self.frames.push(made);
        is_key
    }

    fn last(&self) -> &[pb::Frame] {
        self.frames.last().expect("a frame was sent")
    }

    fn last_bytes(&self) -> usize {
        self.last().iter().map(|part| part.data.len()).sum()
    }
}

fn request(positions: &[DVec3], part_bytes: usize) -> Frame {
    Frame {
        positions: Arc::new(positions.to_vec()),
        output: FrameOutput {
            encoding: FrameEncoding::Delta,
            asked: 1,
            ..Default::default()
        },
        part_bytes,
        ..Frame::default()
    }
}

fn shading(positions: &[DVec3]) -> Option<Arc<Shading>> {
    let directions = || positions.iter().map(|p| p.as_vec3().normalize_or(glam::Vec3::Z));
    Some(Arc::new(Shading {
        normals: directions().collect(),
        tangents: directions().map(|d| d.zxy().extend(-1.0)).collect(),
    }))
}

fn wave(count: usize, phase: f64) -> Vec<DVec3> {
    let place = |i: usize| {
        DVec3::new(
            i as f64 * 0.01,
            libm::sin(i as f64 * 0.1 + phase),
            libm::cos(i as f64 * 0.07),
        )
    };
    (0..count).map(place).collect()
}

/// The steps of a vertex as U16 defines them.
fn steps_in_box(numbers: &[f64], [low, high]: [&[f64]; 2]) -> [u16; 4] {
    let step = |k: usize| match (numbers.get(k), low.get(k), high.get(k)) {
        (Some(x), Some(a), Some(b)) if b > a => ((x - a) / (b - a) * 65535.0).round().clamp(0.0, 65535.0) as u16,
        _ => 0,
    };
    [step(0), step(1), step(2), step(3)]
}

proptest! {
    #[test]
    fn differences_add_up_to_the_steps_of_the_box(
        shapes in prop::collection::vec((any::<(bool, bool)>(), prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 30)), 1..12),
        grows in prop::collection::vec(0.2f64..1.6, 12),
        count in 1usize..30,
        part_bytes in 0usize..400,
    ) {
        let mut sent = SentFrames::to_reader_of(count);
        for (((normals, tangents), points), grow) in shapes.iter().zip(&grows) {
            let positions: Vec<DVec3> = points[..count].iter().map(|p| DVec3::from_array(*p) * *grow).collect();
            let mut request = request(&positions, part_bytes);
            request.shading = shading(&positions);
            (request.output.normals, request.output.tangents) = (*normals, *tangents);
            let shaded = request.shading.clone().expect("has some");
            let number = sent.frames.len() as u64 + 1;
            let is_key = sent.send(request);
            prop_assert!(is_key || number > 1);
            let last = sent.last();
            prop_assert!(last.iter().all(|part| part.number == number && part.encoding() != frame::Encoding::F32));
            let corners = [&last[0].box_min[..], &last[0].box_max[..]];
            for (v, p) in positions.iter().enumerate() {
                let seen = sent.reader.steps(frame::Attribute::Position)[v];
                prop_assert_eq!(seen, steps_in_box(&p.to_array(), corners), "vertex {}", v);
                let ends = [&[-1.0; 4][..], &[1.0; 4][..]];
                if *normals {
                    let normal = shaded.normals[v].as_dvec3().to_array();
                    prop_assert_eq!(sent.reader.steps(frame::Attribute::Normal)[v], steps_in_box(&normal, [&ends[0][..3], &ends[1][..3]]));
                }
                if *tangents {
                    let tangent = shaded.tangents[v].as_dvec4().to_array();
                    prop_assert_eq!(sent.reader.steps(frame::Attribute::Tangent)[v], steps_in_box(&tangent, ends));
                }
            }
        }
    }

    /// Any bytes are an error or a frame, never a panic, whatever was held.
    #[test]
    fn what_no_server_sends_is_refused(
        parts in prop::collection::vec(
            (0u64..4, 0u32..3, 0u32..3, -1i32..5, -1i32..4, 0u32..9, 0u32..9, prop::collection::vec(any::<u8>(), 0..40), 0usize..4), 1..8),
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
    ) {
        let mut sent = SentFrames::to_reader_of(8);
        sent.send(request(&wave(8, 0.0), 1 << 20));
        for (number, part, parts, encoding, attribute, first_vertex, vertex_count, data, corners) in parts {
            let mut data = data;
            if data.len() % 2 == 0 {
                // Nearly the bytes of a frame.
                data = sent.last()[0].data.to_vec();
                for (at, byte) in &flips {
                    let at = at.index(data.len());
                    data[at] ^= byte;
                }
            }
            let part = pb::Frame {
                number, part, parts, encoding, attribute, first_vertex, vertex_count,
                data: data.into(),
                box_min: vec![0.0; corners],
                box_max: vec![1.0; corners],
                ..Default::default()
            };
            let _ = sent.reader.take(&part);
        }
    }
}

#[test]
fn a_key_frame_comes_first_and_when_the_shape_or_the_question_is_another() {
    let shape = wave(500, 0.0);
    let mut sent = SentFrames::to_reader_of(500);
    let usual = || request(&shape, 1 << 20);
    let at = |scale: f64, by: DVec3| -> Vec<DVec3> { shape.iter().map(|p| *p * scale + by).collect() };
    let moved = |scale, by| request(&at(scale, by), 1 << 20);
    let extent = 5.0;
    assert!(sent.send(usual()), "the first");
    assert!(!sent.send(usual()), "the same again");
    assert!(!sent.send(moved(1.0, DVec3::X * extent * 0.12)), "within the room");
    assert!(sent.send(moved(1.0, DVec3::X * extent * 0.13)), "out of the room");
    assert!(sent.send(moved(0.2, DVec3::X)), "much smaller");
    assert!(sent.send(usual()), "and out of the box of that");

    let mut edited = usual();
    edited.topology = Some(TopologyId::default());
    assert!(sent.send(edited.clone()), "after an edit");
    assert!(!sent.send(edited.clone()));
    assert!(sent.send(usual()), "and when it is undone");

    let mut again = usual();
    again.output.asked = 2;
    assert!(sent.send(again.clone()), "options that are sent again");
    let mut shaded = again.clone();
    shaded.output.normals = true;
    shaded.shading = shading(&shape);
    assert!(sent.send(shaded.clone()), "normals too");
    assert!(!sent.send(shaded.clone()));
    shaded.shading = None;
    assert!(sent.send(shaded), "normals that are missing");
    assert!(sent.send(again.clone()));
    assert_eq!(sent.sent.byte_size(), 500 * 8);

    let mut plain = again.clone();
    plain.output.encoding = FrameEncoding::U16;
    assert!(sent.send(plain), "no differences are asked for");
    assert_eq!(sent.sent.byte_size(), 0, "and nothing is held for them");
    assert_eq!(sent.last()[0].number, 0);
    assert!(sent.send(again), "they are again");
    assert_eq!(sent.last()[0].number, 15, "numbers go on along a stream");
}

#[test]
fn what_does_not_move_takes_next_to_nothing_and_another_number_of_vertices_is_a_key_frame() {
    let shape = wave(5000, 0.0);
    let mut sent = SentFrames::to_reader_of(5000);
    assert!(sent.send(request(&shape, 1 << 20)));
    let key = sent.last_bytes();
    assert!(!sent.send(request(&shape, 1 << 20)));
    assert!(sent.last_bytes() * 100 < key, "{} of {key} bytes", sent.last_bytes());
    assert!(!sent.send(request(&wave(5000, 1e-3), 1 << 20)));
    assert!(sent.last_bytes() * 2 < key, "{} of {key} bytes", sent.last_bytes());

    let fewer = &shape[..4000];
    assert!(sent.send(request(fewer, 1 << 20)));
    assert_eq!(
        sent.sent.byte_size(),
        4000 * 8,
        "nothing is held for vertices that are gone"
    );
    assert!(!sent.send(request(fewer, 1 << 20)));
    assert!(sent.send(request(&[], 1 << 20)), "none at all");
    assert!(!sent.send(request(&[], 1 << 20)));
}

/// Where the frame ends that is sent, the numbers are those of U16, not nearly those.
#[test]
fn bytes_depend_on_the_shapes_alone() {
    let shapes: Vec<_> = (0..6).map(|k| wave(9000, f64::from(k) * 0.01)).collect();
    let bytes = |part_bytes: usize| {
        let mut sent = SentFrames::to_reader_of(9000);
        for shape in &shapes {
            sent.send(request(shape, part_bytes));
        }
        let numbers = sent.reader.numbers(frame::Attribute::Position).to_vec();
        (sent.frames, numbers.iter().map(|x| x.to_bits()).collect::<Vec<_>>())
    };
    assert_eq!(bytes(20_000), bytes(20_000));
    assert_eq!(bytes(20_000).1, bytes(1 << 20).1, "however they are cut into parts");
}

#[test]
fn a_call_that_answers_one_frame_answers_a_key_frame() {
    let shape = wave(300, 0.0);
    let parts: Vec<pb::Frame> = encode(request(&shape, 700)).collect();
    let mut sent = SentFrames::to_reader_of(300);
    sent.send(request(&shape, 700));
    assert_eq!(parts, sent.last());
    assert!(
        parts.len() > 1
            && parts
                .iter()
                .all(|part| part.encoding() == frame::Encoding::Meshopt && part.number == 1)
    );
    // Those who ask for changes too are refused; what was stored of such a call is sent all the same.
    let mut listed = request(&shape, 1 << 20);
    listed.selected = Some(vec![3, 4]);
    let parts: Vec<pb::Frame> = encode_next(listed, SentSteps::default()).collect();
    assert_eq!(
        (parts[0].encoding(), parts[0].number, &parts[0].indices[..]),
        (frame::Encoding::Meshopt, 0, &[3, 4][..])
    );
}

#[test]
fn differences_without_what_they_are_distinguished_from_are_refused() {
    let mut sent = SentFrames::to_reader_of(50);
    for phase in 0..3 {
        sent.send(request(&wave(50, f64::from(phase) * 0.01), 200));
    }
    let [key, second, third] = &sent.frames[..] else {
        panic!("three frames")
    };
    assert!(key.len() > 1);
    let fields = |frames: &[&[pb::Frame]], change: &dyn Fn(&mut pb::Frame)| -> Option<String> {
        let mut reader = FrameReader::new(50);
        for mut part in frames.concat() {
            change(&mut part);
            match reader.take(&part) {
                Ok(_) => {}
                Err(Error::Invalid { field, .. }) => return Some(field),
                Err(other) => panic!("{other}"),
            }
        }
        None
    };
    let is = |field: &str| Some(field.to_owned());
    let nothing = |_: &mut pb::Frame| {};
    assert_eq!(fields(&[key, second, third], &nothing), None);
    assert_eq!(fields(&[second], &nothing), is("frame.number"), "no base");
    assert_eq!(fields(&[key, third], &nothing), is("frame.number"), "another base");
    assert_eq!(fields(&[&key[..1], third], &nothing), is("frame.part"), "half a base");
    let of_second = |change: fn(&mut pb::Frame)| {
        move |part: &mut pb::Frame| {
            if part.number == 2 {
                change(part);
            }
        }
    };
    let changes: BTreeMap<&str, fn(&mut pb::Frame)> = BTreeMap::from([
        ("frame.boxMin", (|part| part.box_min[1] += 1.0) as fn(&mut pb::Frame)),
        ("frame.data", |part| part.data = part.data.slice(1..)),
        ("frame.attribute", |part| part.attribute = 1),
        ("frame.vertexCount", |part| part.vertex_count = 99),
        ("frame.indices", |part| part.indices = (0..part.vertex_count).collect()),
        ("frame.encoding", |part| part.encoding = 9),
        ("frame.number", |part| part.number = 9),
    ]);
    for (field, change) in changes {
        assert_eq!(fields(&[key, second], &of_second(change)), is(field));
    }
}

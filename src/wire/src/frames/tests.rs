//! Whatever the encoding, a client gets every vertex once, in parts that are small enough.

use super::pb::frame;
use super::sent_steps::bounds;
use super::*;
use glam::Vec3Swizzles as _;
use pb::deform_response::Message as Response;
use pliant_core::engine::digest;
use proptest::prelude::*;
use prost::Message as _;

fn request(positions: Vec<DVec3>, encoding: frame::Encoding, part_bytes: usize) -> Frame {
    Frame {
        header: pb::Frame {
            seq: 7,
            revision: 3,
            r#final: true,
            ..Default::default()
        },
        positions: Arc::new(positions),
        output: FrameOutput {
            encoding: FrameEncoding::from_message(encoding),
            ..Default::default()
        },
        part_bytes,
        ..Frame::default()
    }
}

/// What a client makes of a frame: numbers per attribute by vertex, at most `numbers` each.
fn decode(parts: &[pb::Frame], attribute: frame::Attribute) -> Vec<(u32, Vec<f64>)> {
    let n = if attribute == frame::Attribute::Tangent { 4 } else { 3 };
    let mut out = Vec::new();
    for part in parts.iter().filter(|p| p.attribute() == attribute) {
        let count = part.vertex_count as usize;
        let raw: Vec<Vec<f64>> = match part.encoding() {
            frame::Encoding::F32 => {
                assert_eq!(part.data.len(), count * n * 4);
                let numbers = part
                    .data
                    .chunks_exact(4)
                    .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]).into());
                numbers
                    .collect::<Vec<f64>>()
                    .chunks_exact(n)
                    .map(<[f64]>::to_vec)
                    .collect()
            }
            frame::Encoding::U16 => {
                assert_eq!(part.data.len(), count * n * 2);
                let numbers = part.data.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]));
                numbers
                    .collect::<Vec<u16>>()
                    .chunks_exact(n)
                    .map(|v| unpack(part, v))
                    .collect()
            }
            frame::Encoding::Meshopt if count == 0 => Vec::new(),
            frame::Encoding::Delta => panic!("frames that stand for themselves have no differences"),
            frame::Encoding::Meshopt => {
                let coded: Vec<[u16; 4]> = meshopt::decode_vertex_buffer(&part.data, count).expect("decodes");
                coded.iter().map(|v| unpack(part, &v[..n])).collect()
            }
        };
        let vertex = |k: usize| part.indices.get(k).copied().unwrap_or(part.first_vertex + k as u32);
        out.extend(raw.into_iter().enumerate().map(|(k, v)| (vertex(k), v)));
    }
    out
}

fn unpack(part: &pb::Frame, quantised: &[u16]) -> Vec<f64> {
    let low = |i: usize| if i < 3 { part.box_min[i] } else { -1.0 };
    let high = |i: usize| if i < 3 { part.box_max[i] } else { 1.0 };
    quantised
        .iter()
        .enumerate()
        .map(|(i, &q)| low(i) + f64::from(q) / 65535.0 * (high(i) - low(i)))
        .collect()
}

fn wave(count: usize) -> Vec<DVec3> {
    (0..count)
        .map(|i| DVec3::new(i as f64 * 0.37 - 4.0, libm::sin(i as f64), 2.5))
        .collect()
}

fn check_parts(parts: &[pb::Frame], part_bytes: usize) {
    for (k, part) in parts.iter().enumerate() {
        assert_eq!(
            (part.part as usize, part.parts as usize, part.seq, part.revision),
            (k, parts.len(), 7, 3)
        );
        assert!(
            part.r#final && part.data.len() + part.indices.len() * 4 <= part_bytes,
            "part {k} is too large"
        );
    }
}

/// Readers in other languages need it: another version is another encoding.
#[test]
fn the_vertex_codec_is_of_version_1() {
    let positions: Vec<DVec3> = (0..300).map(|i| DVec3::splat(f64::from(i))).collect();
    for encoding in [frame::Encoding::Meshopt, frame::Encoding::Delta] {
        let mut parts = encode(request(positions.clone(), encoding, 1 << 20));
        let part = parts.next().expect("a part");
        assert_eq!((part.encoding(), part.data[0]), (frame::Encoding::Meshopt, 0xA1));
    }
}

#[test]
fn digest_is_of_the_bits_in_order() {
    let (a, b) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.0, -0.0, 5.0));
    let bytes: Vec<u8> = [1.0f64, 2.0, 3.0, 0.0, -0.0, 5.0]
        .iter()
        .flat_map(|x| x.to_le_bytes())
        .collect();
    assert_eq!(
        digest(&[a, b]),
        format!("xxh3:{:016x}", xxhash_rust::xxh3::xxh3_64(&bytes))
    );
    assert_ne!(
        digest(&[a, b]),
        digest(&[a, DVec3::new(0.0, 0.0, 5.0)]),
        "the sign of zero counts"
    );
    let long = wave(1000);
    let bytes: Vec<u8> = long
        .iter()
        .flat_map(|p| p.to_array())
        .flat_map(f64::to_le_bytes)
        .collect();
    assert_eq!(
        digest(&long),
        format!("xxh3:{:016x}", xxhash_rust::xxh3::xxh3_64(&bytes))
    );
}

#[test]
fn float_parts_join_to_the_whole_buffer() {
    let positions = wave(1000);
    let parts: Vec<_> = encode(request(positions.clone(), frame::Encoding::F32, 1200)).collect();
    assert_eq!(parts.len(), 10);
    check_parts(&parts, 1200);
    let joined: Vec<u8> = parts.iter().flat_map(|p| p.data.to_vec()).collect();
    assert_eq!(joined, f32_bytes(&positions, DVec3::ZERO));
    assert!(parts.iter().all(|p| p.box_min.is_empty() && p.indices.is_empty()));
}

#[test]
fn an_empty_model_and_a_tiny_part_still_make_frames() {
    assert_eq!(encode(request(Vec::new(), frame::Encoding::Meshopt, 1200)).count(), 1);
    let parts: Vec<_> = encode(request(wave(3), frame::Encoding::F32, 0)).collect();
    assert_eq!(parts.iter().map(|p| p.first_vertex).collect::<Vec<_>>(), [0, 1, 2]);
}

#[test]
fn an_axis_without_extent_is_kept_exactly() {
    for encoding in [frame::Encoding::U16, frame::Encoding::Meshopt] {
        let parts: Vec<_> = encode(request(wave(300), encoding, 1 << 20)).collect();
        assert!(
            decode(&parts, frame::Attribute::Position)
                .iter()
                .all(|(_, p)| p[2] == 2.5),
            "{encoding:?}"
        );
    }
}

#[test]
fn normals_and_tangents_follow_as_blocks_of_their_own() {
    let positions = wave(500);
    let shading = Shading {
        normals: positions.iter().map(|p| p.as_vec3().normalize()).collect(),
        tangents: positions
            .iter()
            .map(|p| p.as_vec3().normalize().zxy().extend(-1.0))
            .collect(),
    };
    for encoding in [frame::Encoding::F32, frame::Encoding::U16, frame::Encoding::Meshopt] {
        let mut request = request(positions.clone(), encoding, 2000);
        request.shading = Some(Arc::new(shading.clone()));
        request.output.normals = true;
        request.output.tangents = true;
        let parts: Vec<_> = encode(request).collect();
        check_parts(&parts, 2000);
        let order: Vec<i32> = parts.iter().map(|p| p.attribute).collect();
        assert!(order.is_sorted() && order.first() == Some(&0) && order.last() == Some(&2));
        for (v, seen) in decode(&parts, frame::Attribute::Tangent) {
            let tangent = shading.tangents[v as usize].to_array();
            assert!(
                seen.iter().zip(tangent).all(|(a, b)| (a - f64::from(b)).abs() < 2e-5),
                "{encoding:?} {v}"
            );
        }
        assert_eq!(decode(&parts, frame::Attribute::Normal).len(), 500);
    }
}

#[test]
fn only_selected_vertices_are_sent() {
    let mut request = request(wave(100), frame::Encoding::F32, 64);
    request.selected = Some(vec![3, 8]);
    let parts: Vec<_> = encode(request.clone()).collect();
    let seen: Vec<u32> = decode(&parts, frame::Attribute::Position)
        .iter()
        .map(|(v, _)| *v)
        .collect();
    assert_eq!((seen, &parts[0].indices[..]), (vec![3, 8], &[3, 8][..]));

    request.selected = Some(Vec::new());
    request.output.normals = true;
    let parts: Vec<_> = encode(request.clone()).collect();
    assert_eq!(
        (parts.len(), parts[0].vertex_count, parts[0].data.len()),
        (1, 0, 0),
        "no change is one empty part"
    );

    request.selected = Some((0..100).collect());
    let all: Vec<u32> = encode(request).flat_map(|p| p.indices).collect();
    assert_eq!(all, (0..100).collect::<Vec<u32>>(), "every part has indices");
}

/// What a transport sends of a frame, part by part.
fn sent(request: Frame) -> Vec<Vec<u8>> {
    let mut parts = encode(request);
    let mut sent = Vec::new();
    while let Some(part) = parts.next_part() {
        let bytes = part.data_bytes();
        let message = part.encode_to_vec();
        assert_eq!(message.len(), part.encoded_len());
        assert!(message.len() >= bytes);
        sent.push(message);
    }
    sent
}

#[test]
fn words_go_out_as_they_are() {
    let pong = Response::Pong(pb::Ping { nonce: 7 });
    let bytes = OutgoingResponse::from(pong.clone()).encode_to_vec();
    let read = pb::DeformResponse::decode(&bytes[..]).expect("a response");
    assert_eq!(read.message, Some(pong.clone()));
    let read = OutgoingResponse::decode(&bytes[..]).expect("a response");
    assert_eq!(pb::DeformResponse::from(read).message, Some(pong));
}

#[test]
fn long_frames_are_slow_where_they_are_compressed() {
    let is_slow = |count, encoding| request(wave(count), encoding, 1 << 20).is_slow_to_encode();
    assert!(is_slow(100_000, frame::Encoding::Meshopt) && !is_slow(100, frame::Encoding::Meshopt));
    assert!(is_slow(100_000, frame::Encoding::Delta) && !is_slow(100, frame::Encoding::Delta));
    assert!(!is_slow(100_000, frame::Encoding::F32) && !is_slow(100_000, frame::Encoding::U16));
}

proptest! {
    /// Numbers that are written straight into what is sent say what the message says.
    #[test]
    fn what_is_sent_is_the_message(
        count in 0usize..700,
        encoding in 0i32..4,
        part_bytes in 100usize..9000,
        every in prop::option::of(1usize..5),
        shades in any::<(bool, bool)>(),
    ) {
        let positions = wave(count);
        let encoding = frame::Encoding::try_from(encoding).expect("0 to 3");
        let mut request = request(positions.clone(), encoding, part_bytes);
        request.shading = Some(Arc::new(Shading {
            normals: positions.iter().map(|p| p.as_vec3().normalize()).collect(),
            tangents: positions.iter().map(|p| p.as_vec3().normalize().zxy().extend(1.0)).collect(),
        }));
        (request.output.normals, request.output.tangents) = shades;
        request.selected = every.map(|every| (0..count as u32).step_by(every).collect());
        let messages: Vec<pb::Frame> = encode(request.clone()).collect();
        let read: Vec<pb::Frame> = sent(request)
            .iter()
            .map(|bytes| match pb::DeformResponse::decode(&bytes[..]).expect("a response").message {
                Some(Response::Frame(frame)) => frame,
                other => panic!("a frame was sent, not {other:?}"),
            })
            .collect();
        prop_assert_eq!(read, messages);
    }

    /// Every encoding gives every vertex back, once, within its stated error.
    #[test]
    fn encodings_keep_their_error(
        points in prop::collection::vec(prop::array::uniform3(-1e6f64..1e6), 1..400),
        encoding in 0i32..3,
        part_bytes in 0usize..3000,
    ) {
        let positions: Vec<DVec3> = points.iter().copied().map(DVec3::from_array).collect();
        let encoding = frame::Encoding::try_from(encoding).expect("0 to 2");
        let [low, high] = bounds(&positions, None);
        let parts: Vec<_> = encode(request(positions.clone(), encoding, part_bytes)).collect();
        if part_bytes >= 100 {
            check_parts(&parts, part_bytes);
        }
        let decoded = decode(&parts, frame::Attribute::Position);
        prop_assert_eq!(decoded.len(), positions.len());
        for (k, (v, seen)) in decoded.iter().enumerate() {
            prop_assert_eq!(*v as usize, k);
            for i in 0..3 {
                let step = if encoding == frame::Encoding::F32 { 0.13 } else { (high - low)[i] / 65535.0 };
                prop_assert!((seen[i] - positions[k][i]).abs() <= step * 0.5001);
            }
        }
    }
}

#[test]
fn gradients_are_read_as_they_were_made_in_every_encoding() {
    let positions = wave(700);
    let turn = |k: usize| glam::Quat::from_axis_angle(glam::Vec3::Y, k as f32 * 0.004);
    let gradients = LocalGradients {
        rotations: (0..700).map(|k| turn(k).into()).collect(),
        stretches: (0..700).map(|k| glam::Vec3::new(0.5, 1.0, k as f32 * 0.005)).collect(),
        shears: (0..700)
            .map(|k| glam::Vec3::new(-0.25, k as f32 * 0.003, 0.0))
            .collect(),
    };
    for encoding in [
        frame::Encoding::F32,
        frame::Encoding::U16,
        frame::Encoding::Meshopt,
        frame::Encoding::Delta,
    ] {
        let mut request = request(positions.clone(), encoding, 3000);
        request.gradients = Some(Arc::new(gradients.clone()));
        assert_eq!(
            encode(request.clone()).filter(|p| p.attribute != 0).count(),
            0,
            "not asked for"
        );
        request.output.gradients = true;
        let mut reader = FrameReader::new(700);
        let mut sent = SentSteps::default();
        let mut carried = Vec::new();
        for round in 0..2 {
            let mut parts = encode_next(request.clone(), sent);
            let made: Vec<_> = parts.by_ref().collect();
            check_parts(&made, 3000);
            sent = parts.into_sent();
            made.iter().for_each(|part| {
                reader.take(part).expect("is read");
            });
            let differs = made.iter().any(|part| part.encoding() == frame::Encoding::Delta);
            assert_eq!(differs, round == 1 && encoding == frame::Encoding::Delta);
            carried = made.iter().map(|part| part.attribute).collect();
        }
        carried.dedup();
        assert_eq!(carried, [0, 3, 4, 5]);
        let error = if encoding == frame::Encoding::F32 {
            0.0
        } else {
            4.0 / 65535.0
        };
        for k in 0..700 {
            let near = |seen: &[f32], made: &[f32]| {
                seen.iter()
                    .zip(made)
                    .all(|(a, b)| (a - b).abs() <= error + 1e-6 * error)
            };
            let of =
                |attribute: frame::Attribute, width: usize| reader.numbers(attribute)[width * k..][..width].to_vec();
            assert!(
                near(&of(frame::Attribute::Rotation, 4), &gradients.rotations[k].to_array()),
                "{encoding:?} {k}"
            );
            assert!(
                near(&of(frame::Attribute::Stretch, 3), &gradients.stretches[k].to_array()),
                "{encoding:?} {k}"
            );
            assert!(
                near(&of(frame::Attribute::Shear, 3), &gradients.shears[k].to_array()),
                "{encoding:?} {k}"
            );
        }
    }
}

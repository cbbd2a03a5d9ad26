//! Decompression of `EXT_meshopt_compression` and `KHR_meshopt_compression` buffer views.
//!
//! Source: the two extensions' specifications; the bit streams are meshoptimizer's. Its decoders are safe on any bytes
//! but trust counts and strides, so those are checked here before anything is allocated.

use super::container::GltfFault;
use super::schema::ViewCompression;
use crate::Error;
use crate::apart::{AnsweredCalls, DecodedPlace, ParserCalls};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io;

/// What calls of this decoder name.
pub(in super::super) const DECODER: &str = "meshopt";

/// How a view is compressed, checked.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct ViewCoding {
    mode: ViewMode,
    filter: MeshoptFilter,
    stride: usize,
    count: usize,
}

/// What a compressed view holds.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
enum ViewMode {
    Attributes,
    Triangles,
    Indices,
}

impl ViewCoding {
    /// Checks how a view of `source` compressed bytes is compressed.
    pub(super) fn of(c: &ViewCompression, source: u64, place: &str, fault: GltfFault) -> Result<Self, Error> {
        let place = format!("{place}/extensions/meshopt_compression");
        let malformed = |problem: String| fault.malformed(place.clone(), problem);
        let stride = c.byte_stride.index();
        let (mode, allowed) = match c.mode.as_str() {
            "ATTRIBUTES" => (
                ViewMode::Attributes,
                (4..=256).contains(&stride) && stride.is_multiple_of(4),
            ),
            "TRIANGLES" => (ViewMode::Triangles, stride == 2 || stride == 4),
            "INDICES" => (ViewMode::Indices, stride == 2 || stride == 4),
            mode => {
                return Err(malformed(format!(
                    "mode {mode:?} is not ATTRIBUTES, TRIANGLES or INDICES"
                )));
            }
        };
        if !allowed {
            return Err(malformed(format!("stride {stride} does not go with mode {}", c.mode)));
        }
        let filter = MeshoptFilter::of(c, stride, &malformed)?;
        let count = c.count.index();
        // The densest streams there are: one control byte stands for 1024 bytes of attributes, one code for a triangle or
        // an index.
        let (least, what) = match mode {
            ViewMode::Attributes => ((c.count.0.saturating_mul(c.byte_stride.0)) / 1024, "attributes"),
            ViewMode::Triangles if !count.is_multiple_of(3) => {
                return Err(malformed(format!("{count} indices do not make triangles")));
            }
            ViewMode::Triangles => (c.count.0 / 3, "indices"),
            ViewMode::Indices => (c.count.0, "indices"),
        };
        if source < least {
            return Err(malformed(format!("{source} bytes cannot hold {count} {what}")));
        }
        Ok(Self {
            mode,
            filter,
            stride,
            count,
        })
    }

    /// Decodes a view: `count` times `stride` bytes. The error is that of the decoder.
    fn decode(self, source: &[u8]) -> Result<Vec<u8>, String> {
        let Self { count, stride, .. } = self;
        if count == 0 {
            return Ok(Vec::new());
        }
        let decoded = match self.mode {
            ViewMode::Attributes => decode_attributes(source, count, stride),
            ViewMode::Triangles if stride == 2 => {
                meshopt::decode_index_buffer::<u16>(source, count).map(|i| u16_bytes(&i))
            }
            ViewMode::Triangles => meshopt::decode_index_buffer::<u32>(source, count).map(|i| u32_bytes(&i)),
            ViewMode::Indices if stride == 2 => {
                meshopt::decode_index_sequence::<u16>(source, count).map(|i| u16_bytes(&i))
            }
            ViewMode::Indices => meshopt::decode_index_sequence::<u32>(source, count).map(|i| u32_bytes(&i)),
        };
        let bytes = decoded.map_err(|e| e.to_string())?;
        Ok(self.filter.apply(bytes, stride))
    }

    /// Decodes a view in this process, or through `calls` in another one.
    pub(super) fn decode_at(
        self,
        source: &[u8],
        at: DecodedPlace<'_>,
        fault: GltfFault,
        calls: Option<&mut ParserCalls>,
    ) -> Result<Vec<u8>, Error> {
        let decoded = match calls {
            None => self.decode(source),
            Some(calls) => {
                let length = (self.count as u64).saturating_mul(self.stride as u64);
                calls.allow((source.len() as u64).saturating_add(length.saturating_mul(2)), at)?;
                calls.send(&(DECODER, self), &[source], at)?;
                let mut room = length.saturating_add(MESSAGE_BYTES);
                let (answer, mut parts) = calls.receive(at, &mut |bytes| {
                    room = room
                        .checked_sub(bytes)
                        .ok_or_else(|| fault.malformed(at.place, "decodes to more than its count"))?;
                    Ok(())
                })?;
                match answer {
                    Ok(()) => match parts.pop() {
                        Some(bytes) if bytes.len() as u64 == length => Ok(bytes),
                        _ => return Err(calls.unexpected(at)),
                    },
                    Err(problem) => Err(problem),
                }
            }
        };
        let damaged = |problem| format!("the compressed bytes are damaged ({problem})").to_lowercase();
        decoded.map_err(|problem: String| fault.malformed(at.place, damaged(problem)))
    }
}

/// Bytes that an answer may take beside those that are decoded.
const MESSAGE_BYTES: u64 = 16 << 10;

/// Answers a call of [`ViewCoding::decode_at`], in the other process.
pub(in super::super) fn answer(call: Value, parts: &[Vec<u8>], calls: &mut AnsweredCalls<'_>) -> io::Result<()> {
    let coding: ViewCoding = serde_json::from_value(call)?;
    match coding.decode(parts.first().map_or(&[], |source| source)) {
        Ok(bytes) => calls.write(&Ok::<(), String>(()), &[&bytes]),
        Err(problem) => calls.write(&Err::<(), String>(problem), &[]),
    }
}

/// What is done to attributes after the codec.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
enum MeshoptFilter {
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

impl MeshoptFilter {
    fn of(c: &ViewCompression, stride: usize, malformed: &impl Fn(String) -> Error) -> Result<Self, Error> {
        let name = c.filter.as_deref().unwrap_or("NONE");
        let (filter, allowed) = match name {
            "NONE" => (Self::None, true),
            "OCTAHEDRAL" => (Self::Octahedral, stride == 4 || stride == 8),
            "QUATERNION" => (Self::Quaternion, stride == 8),
            "EXPONENTIAL" => (Self::Exponential, stride.is_multiple_of(4)),
            "COLOR" => (Self::Color, stride == 4 || stride == 8),
            other => return Err(malformed(format!("filter {other:?} is not known"))),
        };
        if !allowed || (c.mode != "ATTRIBUTES" && name != "NONE") {
            return Err(malformed(format!(
                "filter {name} does not go with mode {} and stride {stride}",
                c.mode
            )));
        }
        Ok(filter)
    }

    fn apply(self, bytes: Vec<u8>, stride: usize) -> Vec<u8> {
        match (self, stride) {
            (Self::None, _) => bytes,
            (Self::Octahedral, 4) => {
                let mut data = quads(&bytes, |b| b.map(|b| b as i8));
                meshopt::decode_filter_oct(&mut data);
                data.into_flattened().into_iter().map(|v| v as u8).collect()
            }
            (Self::Octahedral, _) => {
                let mut data = words_as(&bytes, i16::from_le_bytes);
                meshopt::decode_filter_oct(&mut data);
                data.into_flattened().into_iter().flat_map(i16::to_le_bytes).collect()
            }
            (Self::Quaternion, _) => {
                let mut data = words_as(&bytes, i16::from_le_bytes);
                meshopt::decode_filter_quat(&mut data);
                data.into_flattened().into_iter().flat_map(i16::to_le_bytes).collect()
            }
            (Self::Exponential, _) => {
                let mut data = quads(&bytes, |b| [u32::from_le_bytes(b)]);
                meshopt::decode_filter_exp(&mut data);
                u32_bytes(data.as_flattened())
            }
            (Self::Color, 4) => {
                let mut data = quads(&bytes, |b| b);
                meshopt::decode_filter_color(&mut data);
                data.into_flattened()
            }
            (Self::Color, _) => {
                let mut data = words_as(&bytes, u16::from_le_bytes);
                meshopt::decode_filter_color(&mut data);
                u16_bytes(data.as_flattened())
            }
        }
    }
}

fn quads<T>(bytes: &[u8], f: impl Fn([u8; 4]) -> T) -> Vec<T> {
    bytes.as_chunks::<4>().0.iter().map(|&b| f(b)).collect()
}

fn words_as<T>(bytes: &[u8], word: impl Fn([u8; 2]) -> T) -> Vec<[T; 4]> {
    bytes
        .as_chunks::<8>()
        .0
        .iter()
        .map(|&[a, b, c, d, e, f, g, h]| [[a, b], [c, d], [e, f], [g, h]].map(&word))
        .collect()
}

fn u16_bytes(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn u32_bytes(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// The codec takes its stride from a type.
#[derive(Clone)]
struct Block<const N: usize>([u8; N]);

impl<const N: usize> Default for Block<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

fn decode_attributes(source: &[u8], count: usize, stride: usize) -> meshopt::Result<Vec<u8>> {
    fn decode<const N: usize>(source: &[u8], count: usize) -> meshopt::Result<Vec<u8>> {
        let blocks = meshopt::decode_vertex_buffer::<Block<N>>(source, count)?;
        Ok(blocks.into_iter().map(|b| b.0).collect::<Vec<_>>().into_flattened())
    }
    macro_rules! by_stride {
        ($($words:literal)*) => {
            match stride {
                $(n if n == 4 * $words => decode::<{ 4 * $words }>(source, count),)*
                // Ruled out by the caller.
                _ => Ok(Vec::new()),
            }
        };
    }
    by_stride!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32
        33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63 64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Format;
    use pliant_exec::progress::Silent;

    fn described(mode: &str, filter: &str, stride: usize, count: usize) -> ViewCompression {
        let json = format!(
            r#"{{"buffer":0,"byteLength":0,"byteStride":{stride},"count":{count},"mode":"{mode}","filter":"{filter}"}}"#
        );
        serde_json::from_str(&json).expect("a description")
    }

    fn run(source: &[u8], mode: &str, filter: &str, stride: usize, count: usize) -> Result<Vec<u8>, String> {
        let c = described(mode, filter, stride, count);
        let at = DecodedPlace {
            place: "bufferViews/0/extensions/meshopt_compression",
            progress: &Silent,
        };
        let fault = GltfFault(Format::GLB);
        let coding = ViewCoding::of(&c, source.len() as u64, "bufferViews/0", fault);
        let decoded = coding.and_then(|coding| coding.decode_at(source, at, fault, None));
        decoded.map_err(|e| e.to_string())
    }

    fn attributes<const N: usize>(data: &[[u8; N]], version: i32) -> Vec<u8> {
        meshopt::encode_vertex_buffer_level(data, 2, Some(version)).expect("encodable")
    }

    #[test]
    fn attributes_of_both_versions_and_every_stride_come_back() {
        fn check<const N: usize>() {
            let data: Vec<[u8; N]> = (0..300_u32)
                .map(|i| std::array::from_fn(|k| (i * 7 + k as u32) as u8))
                .collect();
            for version in [0, 1] {
                assert_eq!(
                    run(&attributes(&data, version), "ATTRIBUTES", "NONE", N, 300),
                    Ok(data.concat()),
                    "{N}"
                );
            }
        }
        check::<4>();
        check::<8>();
        check::<12>();
        check::<20>();
        check::<64>();
        check::<252>();
        check::<256>();
    }

    #[test]
    fn indices_come_back_as_triangles_and_as_a_sequence() {
        let indices: Vec<u32> = (0..200).flat_map(|i| [i, i + 1, i + 2]).collect();
        let triangles = meshopt::encode_index_buffer(&indices, 202).expect("encodable");
        let sequence = meshopt::encode_index_sequence(&indices, 202).expect("encodable");
        let wide = u32_bytes(&indices);
        let narrow = u16_bytes(&indices.iter().map(|&i| i as u16).collect::<Vec<_>>());
        assert_eq!(run(&sequence, "INDICES", "NONE", 4, 600), Ok(wide.clone()));
        assert_eq!(run(&sequence, "INDICES", "NONE", 2, 600), Ok(narrow));
        // The codec may turn a triangle round, but keeps the triangle.
        let decoded = run(&triangles, "TRIANGLES", "NONE", 4, 600).expect("valid");
        let sorted = |bytes: &[u8]| {
            let of = |t: &[u8; 12]| {
                let mut t: Vec<u32> = t.as_chunks::<4>().0.iter().map(|&b| u32::from_le_bytes(b)).collect();
                t.sort_unstable();
                t
            };
            bytes.as_chunks::<12>().0.iter().map(of).collect::<Vec<_>>()
        };
        assert_eq!(sorted(&decoded), sorted(&wide));
    }

    #[test]
    fn filters_give_back_what_they_were_given() {
        let unit: Vec<[f32; 4]> = (0..64)
            .map(|i| glam::Vec3::new((i % 8) as f32 - 3.5, (i / 8) as f32 - 3.5, 2.0 - i as f32 / 16.0).normalize())
            .map(|n| [n.x, n.y, n.z, 0.0])
            .collect();
        let near = |bytes: &[u8], wide: bool, tolerance: f32| {
            let value = |k: usize| match wide {
                true => f32::from(i16::from_le_bytes([bytes[2 * k], bytes[2 * k + 1]])) / 32767.0,
                false => f32::from(bytes[k] as i8) / 127.0,
            };
            for (i, n) in unit.iter().enumerate() {
                for k in 0..3 {
                    assert!((value(4 * i + k) - n[k]).abs() < tolerance, "{i} {k}");
                }
            }
        };
        let small: Vec<[u8; 4]> = meshopt::encode_filter_oct::<i8>(&unit, 8)
            .iter()
            .map(|n| n.map(|v| v as u8))
            .collect();
        near(
            &run(&attributes(&small, 0), "ATTRIBUTES", "OCTAHEDRAL", 4, 64).expect("valid"),
            false,
            0.02,
        );
        let words = |q: &[[i16; 4]]| -> Vec<[u8; 8]> {
            q.iter()
                .map(|v| *v.map(i16::to_le_bytes).as_flattened().first_chunk().expect("eight"))
                .collect()
        };
        let large = words(&meshopt::encode_filter_oct::<i16>(&unit, 16));
        near(
            &run(&attributes(&large, 0), "ATTRIBUTES", "OCTAHEDRAL", 8, 64).expect("valid"),
            true,
            1e-4,
        );

        let turns: Vec<[f32; 4]> = unit
            .iter()
            .map(|n| glam::Vec4::new(n[0], n[1], n[2], 0.5).normalize().to_array())
            .collect();
        let stored = words(&meshopt::encode_filter_quat(&turns, 16));
        let bytes = run(&attributes(&stored, 0), "ATTRIBUTES", "QUATERNION", 8, 64).expect("valid");
        for (got, wanted) in bytes.as_chunks::<8>().0.iter().zip(&turns) {
            let got = glam::Vec4::from_array(std::array::from_fn(|k| {
                f32::from(i16::from_le_bytes([got[2 * k], got[2 * k + 1]]))
            }));
            assert!(got.normalize().dot(glam::Vec4::from_array(*wanted)).abs() > 0.9999);
        }

        let values: Vec<[f32; 3]> = (0..64)
            .map(|i| [i as f32 * 0.25, -1e-6 * i as f32, 1e6 / (i + 1) as f32])
            .collect();
        let stored = meshopt::encode_filter_exp(&values, 24, meshopt::EncodeExpMode::Separate);
        let stored: Vec<[u8; 12]> = stored
            .iter()
            .map(|v| *v.map(u32::to_le_bytes).as_flattened().first_chunk().expect("twelve"))
            .collect();
        let bytes = run(&attributes(&stored, 1), "ATTRIBUTES", "EXPONENTIAL", 12, 64).expect("valid");
        for (got, wanted) in bytes.as_chunks::<4>().0.iter().zip(values.as_flattened()) {
            assert!((f32::from_le_bytes(*got) - wanted).abs() <= wanted.abs() * 1e-6);
        }

        let colours: Vec<[f32; 4]> = (0..64)
            .map(|i| [i as f32 / 63.0, 1.0 - i as f32 / 63.0, 0.25, 1.0])
            .collect();
        let stored = meshopt::encode_filter_color::<u8>(&colours, 8);
        let bytes = run(&attributes(&stored, 1), "ATTRIBUTES", "COLOR", 4, 64).expect("valid");
        for (got, wanted) in bytes.iter().zip(colours.as_flattened()) {
            assert!((f32::from(*got) / 255.0 - wanted).abs() < 0.03);
        }
    }

    #[test]
    fn what_cannot_be_is_refused_before_decoding() {
        let cases = [
            ("ATTRIBUTES", "NONE", 6, 10),
            ("ATTRIBUTES", "NONE", 260, 10),
            ("ATTRIBUTES", "NONE", 0, 10),
            ("ATTRIBUTES", "OCTAHEDRAL", 12, 10),
            ("ATTRIBUTES", "QUATERNION", 4, 10),
            ("ATTRIBUTES", "SOMETHING", 4, 10),
            ("TRIANGLES", "NONE", 4, 10),
            ("TRIANGLES", "NONE", 8, 9),
            ("INDICES", "EXPONENTIAL", 4, 9),
            ("SOMETHING", "NONE", 4, 9),
            ("ATTRIBUTES", "NONE", 256, usize::MAX / 256),
            ("TRIANGLES", "NONE", 4, usize::MAX / 3 * 3),
            ("INDICES", "NONE", 4, usize::MAX),
        ];
        for (mode, filter, stride, count) in cases {
            let text = run(&[0xa0; 64], mode, filter, stride, count).expect_err(mode);
            assert!(text.contains("bufferViews/0"), "{text}");
        }
    }

    proptest::proptest! {
        #[test]
        fn garbage_never_panics(
            mut bytes in proptest::collection::vec(proptest::num::u8::ANY, 1..400),
            header in 0_usize..5,
            mode in 0_usize..3,
            words in 1_usize..5,
            count in 0_usize..400,
        ) {
            bytes[0] = [0xa0, 0xa1, 0xe0, 0xe1, 0xd1][header];
            let (mode, stride) = [("ATTRIBUTES", 4 * words), ("TRIANGLES", 4), ("INDICES", 2)][mode];
            for filter in ["NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"] {
                if let Ok(decoded) = run(&bytes, mode, filter, stride, count) {
                    proptest::prop_assert_eq!(decoded.len(), stride * count);
                }
            }
        }
    }
}

//! Frames as a client reads them: parts in, vertex buffers out.
//!
//! For clients in Rust, and for measurements and tests. Nothing in a part is trusted: what does not fit is an error,
//! and then nothing is read but a frame that stands for itself.

use super::pb::{self, frame};
use super::{ATTRIBUTES, range_of, width_of};
use crate::Error;

/// Reads the frames of one stream. Another stream, and a model that an edit has changed, need another reader.
#[derive(Debug)]
pub struct FrameReader {
    vertices: usize,
    attributes: [ReadAttribute; ATTRIBUTES.len()],
    /// The corners of the box in which the steps of positions are.
    corners: [Vec<f64>; 2],
    /// The number of the frame whose steps are held.
    held: Option<u64>,
    /// The frame of which some parts have come.
    under_way: Option<PartsUnderWay>,
}

/// What is known of an attribute.
#[derive(Debug, Default)]
struct ReadAttribute {
    /// Three or four numbers a vertex; empty where none came.
    numbers: Vec<f32>,
    /// On streams with differences: four steps a vertex.
    steps: Vec<[u16; 4]>,
}

/// A frame of which some parts have come.
#[derive(Debug, Clone, Copy)]
struct PartsUnderWay {
    seq: u64,
    next: u32,
    /// The number of the frame that was held when it began.
    base: Option<u64>,
}

impl FrameReader {
    /// Of a model with this many render vertices.
    pub fn new(vertices: usize) -> Self {
        Self {
            vertices,
            attributes: Default::default(),
            corners: Default::default(),
            held: None,
            under_way: None,
        }
    }

    /// Takes the next part; true when its frame is whole now.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the field that is wrong: parts out of order, vertices that the model has not, bytes that are no such
    /// numbers, differences from a frame that is not held.
    pub fn take(&mut self, part: &pb::Frame) -> Result<bool, Error> {
        let taken = self.take_in_order(part);
        if taken.is_err() {
            self.held = None;
            self.under_way = None;
        }
        taken
    }

    /// Numbers of an attribute, three a vertex, of tangents and rotations four; empty where none came.
    pub fn numbers(&self, attribute: frame::Attribute) -> &[f32] {
        &self.attributes[attribute as usize].numbers
    }

    /// Steps of an attribute, four a vertex, on streams with differences.
    pub fn steps(&self, attribute: frame::Attribute) -> &[[u16; 4]] {
        &self.attributes[attribute as usize].steps
    }

    fn take_in_order(&mut self, part: &pb::Frame) -> Result<bool, Error> {
        let begun = PartsUnderWay {
            seq: part.seq,
            next: 0,
            base: self.held,
        };
        let now = self.under_way.take().unwrap_or(begun);
        if (part.seq, part.part) != (now.seq, now.next) {
            let problem = format!(
                "is {} of frame {}, due is {} of {}",
                part.part, part.seq, now.next, now.seq
            );
            return Err(Error::invalid("frame.part", problem));
        }
        // Until it is whole it has no values.
        self.held = None;
        self.read_part(part, now.base)?;
        if part.part.saturating_add(1) < part.parts {
            self.under_way = Some(PartsUnderWay {
                next: now.next + 1,
                ..now
            });
            return Ok(false);
        }
        self.held = (part.number > 0).then_some(part.number);
        Ok(true)
    }

    fn read_part(&mut self, part: &pb::Frame, base: Option<u64>) -> Result<(), Error> {
        let attribute = frame::Attribute::try_from(part.attribute)
            .map_err(|_| Error::invalid("frame.attribute", "is none that is known"))?;
        let encoding = frame::Encoding::try_from(part.encoding)
            .map_err(|_| Error::invalid("frame.encoding", "is none that is known"))?;
        let width = width_of(attribute);
        let range = self.places(part)?;
        let count = range.len();
        let data = &part.data[..];
        if encoding == frame::Encoding::F32 {
            let numbers = exactly(data, count * width * 4)?.chunks_exact(4);
            let numbers = numbers.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            self.write(attribute, width, part, &numbers.collect::<Vec<_>>());
            return Ok(());
        }
        let mut steps = match encoding {
            frame::Encoding::U16 => {
                let mut steps = vec![[0u16; 4]; count];
                let numbers = exactly(data, count * width * 2)?.chunks_exact(width * 2);
                for (to, vertex) in steps.iter_mut().zip(numbers) {
                    for (to, b) in to.iter_mut().zip(vertex.chunks_exact(2)) {
                        *to = u16::from_le_bytes([b[0], b[1]]);
                    }
                }
                steps
            }
            _ if count == 0 => Vec::new(),
            _ => {
                let coded = meshopt::decode_vertex_buffer::<[u16; 4]>(data, count)
                    .map_err(|e| Error::invalid("frame.data", format!("is not a code of {count} vertices: {e}")))?;
                coded.into_iter().map(|vertex| vertex.map(u16::from_le)).collect()
            }
        };
        let corners = corners(part, attribute)?;
        if encoding == frame::Encoding::Delta {
            let held = self.base(part, attribute, base, &corners)?;
            let held = held.get(range.clone()).unwrap_or_default();
            for (step, held) in steps.as_flattened_mut().iter_mut().zip(held.as_flattened()) {
                *step = step.wrapping_add(*held);
            }
        }
        if part.number > 0 {
            if attribute == frame::Attribute::Position {
                self.corners = corners.clone();
            }
            let held = &mut self.attributes[attribute as usize].steps;
            held.resize(self.vertices, [0; 4]);
            held[range].copy_from_slice(&steps);
        }
        let [low, high] = corners;
        let number = |(k, step): (usize, &u16)| (low[k] + f64::from(*step) / 65535.0 * (high[k] - low[k])) as f32;
        let numbers: Vec<f32> = (steps.iter())
            .flat_map(|vertex| vertex[..width].iter().enumerate().map(number))
            .collect();
        self.write(attribute, width, part, &numbers);
        Ok(())
    }

    /// The vertices of a part, where it names none.
    fn places(&self, part: &pb::Frame) -> Result<std::ops::Range<usize>, Error> {
        let count = part.vertex_count as usize;
        let wrong = |field: &str, seen: String| {
            let most = self.vertices;
            Err(Error::invalid(field, format!("{seen}, the model has {most} vertices")))
        };
        if !part.indices.is_empty() {
            if part.indices.len() != count {
                return wrong(
                    "frame.indices",
                    format!("are {} for {count} vertices", part.indices.len()),
                );
            }
            if let Some(far) = part.indices.iter().find(|&&v| v as usize >= self.vertices) {
                return wrong("frame.indices", format!("name vertex {far}"));
            }
            if part.number > 0 {
                return wrong("frame.indices", "stand where differences are listed".to_owned());
            }
            return Ok(0..count);
        }
        let first = part.first_vertex as usize;
        match first.checked_add(count) {
            Some(end) if end <= self.vertices => Ok(first..end),
            _ => wrong("frame.vertexCount", format!("is {count} from {first} on")),
        }
    }

    /// The steps that differences refer to.
    fn base(
        &self,
        part: &pb::Frame,
        attribute: frame::Attribute,
        base: Option<u64>,
        corners: &[Vec<f64>; 2],
    ) -> Result<&[[u16; 4]], Error> {
        if part.number == 0 || base != part.number.checked_sub(1) {
            let problem = format!(
                "is {}, which lists what differs from the frame before, and that is not here; send the options again to get a \
                 whole frame",
                part.number
            );
            return Err(Error::invalid("frame.number", problem));
        }
        if attribute == frame::Attribute::Position && *corners != self.corners {
            return Err(Error::invalid("frame.boxMin", "is not that of the frame before"));
        }
        let held = &self.attributes[attribute as usize].steps;
        if held.len() != self.vertices {
            let problem = "is one that the frame before did not carry";
            return Err(Error::invalid("frame.attribute", problem));
        }
        Ok(held)
    }

    fn write(&mut self, attribute: frame::Attribute, width: usize, part: &pb::Frame, numbers: &[f32]) {
        let held = &mut self.attributes[attribute as usize].numbers;
        held.resize(self.vertices * width, 0.0);
        for (k, vertex) in numbers.chunks_exact(width).enumerate() {
            let at = part
                .indices
                .get(k)
                .map_or(part.first_vertex as usize + k, |&v| v as usize);
            if let Some(to) = held.get_mut(at * width..(at + 1) * width) {
                to.copy_from_slice(vertex);
            }
        }
    }
}

fn exactly(data: &[u8], bytes: usize) -> Result<&[u8], Error> {
    if data.len() == bytes {
        return Ok(data);
    }
    let problem = format!("has {} bytes, its vertices need {bytes}", data.len());
    Err(Error::invalid("frame.data", problem))
}

/// What steps 0 and 65535 of each number stand for.
fn corners(part: &pb::Frame, attribute: frame::Attribute) -> Result<[Vec<f64>; 2], Error> {
    if let Some(range) = range_of(attribute) {
        return Ok([vec![-range; 4], vec![range; 4]]);
    }
    if part.box_min.len() != 3 || part.box_max.len() != 3 {
        return Err(Error::invalid("frame.boxMin", "and boxMax are not corners of a box"));
    }
    Ok([part.box_min.clone(), part.box_max.clone()])
}

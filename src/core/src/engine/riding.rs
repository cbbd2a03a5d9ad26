//! Primitives that ride along: which they are, and where their vertices go in a shape.

use super::error::{Error, InputPlace};
use super::passenger::{Passenger, PassengerKind};
use crate::asset::Primitive;
use crate::exec::Exec;
use crate::mesh::carry::{CarriedPoints, CarrySurface, SurfaceMotion};
use crate::pool::Pool;
use glam::DVec3;

/// What finding what one vertex of a passenger follows may look at on average: some tens of microseconds. Where faces are of about
/// one size it looks at a hundredth of it.
const VISITS_PER_VERTEX: u64 = 8192;
/// The same for any passengers: some seconds.
const LEAST_VISITS: u64 = 1 << 31;
/// Vertices after which what was looked at and what is held are counted.
const BLOCK: usize = 512;

/// Marks the primitives that ride along.
///
/// # Errors
/// [`Error::Invalid`] with the passenger's index for a primitive that is not there or marked twice, and when nothing is left to
/// be solved.
pub(super) fn mark_passengers(primitives: &mut [Primitive], passengers: &[Passenger]) -> Result<(), Error> {
    for (k, passenger) in passengers.iter().enumerate() {
        let refuse = |problem: String| Err(Error::invalid(InputPlace::Passenger(k), problem));
        let count = primitives.len();
        let meant: Vec<usize> = match &passenger.kind {
            PassengerKind::Primitive(index) if (*index as usize) < count => vec![*index as usize],
            PassengerKind::Primitive(index) => {
                return refuse(format!(
                    "is primitive {index}, the model has {}, counted from 0",
                    number_of_primitives(count)
                ));
            }
            PassengerKind::PrimitivesNamed(name) => {
                let bears = |p: &usize| primitives[*p].name == *name;
                let named: Vec<usize> = (0..count).filter(bears).collect();
                if named.is_empty() {
                    let shown = clip_name(name);
                    let names: Vec<String> = primitives.iter().take(8).map(|p| format!("\"{}\"", p.name)).collect();
                    let names = names.join(", ");
                    return refuse(format!("no primitive is named \"{shown}\", there are {names}"));
                }
                named
            }
            PassengerKind::Node(_)
            | PassengerKind::NodesNamed(_)
            | PassengerKind::Points { .. }
            | PassengerKind::Model(_) => continue,
        };
        for index in meant {
            if std::mem::replace(&mut primitives[index].is_passenger, true) {
                return refuse(format!("primitive {index} is a passenger already"));
            }
        }
        if primitives.iter().all(|p| p.is_passenger || p.index_count == 0) {
            return refuse("nothing is left to be solved: every primitive with triangles is a passenger".into());
        }
    }
    Ok(())
}

/// So many primitives, in words.
pub(super) fn number_of_primitives(count: usize) -> String {
    match count {
        1 => "1 primitive".into(),
        _ => format!("{count} primitives"),
    }
}

/// As much of a name as a refusal repeats.
pub(super) fn clip_name(name: &str) -> String {
    name.chars().take(64).collect()
}

/// The render vertices of passengers, with what they follow.
#[derive(Debug, Clone)]
pub(super) struct RidingVertices {
    vertices: Vec<u32>,
    points: CarriedPoints,
}

impl RidingVertices {
    /// Finds what every vertex of a passenger follows. `admit` says whether so many bytes may be held.
    ///
    /// # Errors
    /// [`Error::Precondition`] when that looks at too much, [`Error::Cancelled`], and those of `admit`.
    pub fn bind(
        surface: &CarrySurface,
        primitives: &[Primitive],
        rest: &[DVec3],
        admit: impl Fn(u64) -> Result<(), Error>,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let passengers = primitives.iter().filter(|p| p.is_passenger);
        let vertices: Vec<u32> = passengers.flat_map(|p| p.vertices()).map(|v| v as u32).collect();
        let mut riders = Self {
            points: CarriedPoints::default(),
            vertices,
        };
        let limit = LEAST_VISITS + VISITS_PER_VERTEX * riders.vertices.len() as u64;
        let mut visits = 0;
        for block in riders.vertices.chunks(BLOCK) {
            let places: Vec<DVec3> = block.iter().map(|&v| rest[v as usize]).collect();
            visits += riders.points.bind_more(surface, &places, exec)?;
            if visits > limit {
                return Err(Error::Precondition(format!(
                    "finding what the vertices of passengers follow takes more than {limit} comparisons, because faces are as \
                     long as the model; remesh the model to give it faces of about one size, or open it without these passengers"
                )));
            }
            admit(riders.points.byte_size() as u64)?;
        }
        Ok(riders)
    }

    /// Writes where they are when the surface is at `current`, among the positions of all render vertices.
    pub fn place(&self, surface: &CarrySurface, current: &[DVec3], positions: &mut [DVec3], pool: &Pool) {
        let motion = SurfaceMotion::between(surface, current, pool);
        let carried = self.points.carried_by(&motion, pool);
        for (&vertex, frame) in self.vertices.iter().zip(&carried) {
            positions[vertex as usize] = frame.position;
        }
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.vertices.capacity() * 4 + self.points.byte_size()
    }
}

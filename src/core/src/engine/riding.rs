//! Primitives that ride along: which they are, and where their vertices go in a shape.

use super::error::{Error, InputPlace};
use super::passenger::{Passenger, PassengerKind};
use crate::asset::Primitive;
use crate::mesh::carry::{CarriedPoints, CarrySurface, SurfaceMotion};
use crate::pool::Pool;
use glam::DVec3;

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
    /// Finds what every vertex of a passenger follows.
    pub fn bind(surface: &CarrySurface, primitives: &[Primitive], rest: &[DVec3], pool: &Pool) -> Self {
        let passengers = primitives.iter().filter(|p| p.is_passenger);
        let vertices: Vec<u32> = passengers.flat_map(|p| p.vertices()).map(|v| v as u32).collect();
        let places: Vec<DVec3> = vertices.iter().map(|&v| rest[v as usize]).collect();
        Self {
            points: CarriedPoints::bind(surface, &places, pool),
            vertices,
        }
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

//! Built-in files for trying pliant without a model: a creature, a figure with everything that a character of a game has,
//! and recordings that move them. The files in this folder were computed once.

/// Regions of the creature in its rest pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleHandles {
    /// Centre and radius of a sphere around the head, ears included.
    pub head: ([f64; 3], f64),
    /// Centre and radius of a sphere around the end of the tail.
    pub tail: ([f64; 3], f64),
    /// Normal n and offset of the half-space n·x ≥ offset that holds the four feet.
    pub feet: ([f64; 3], f64),
}

/// The regions that examples use.
pub const HANDLES: SampleHandles = SampleHandles {
    head: ([0.76, 1.22, 0.0], 0.36),
    tail: ([-1.0, 1.06, 0.0], 0.16),
    feet: ([0.0, -1.0, 0.0], -0.14),
};

/// The creature as a GLB file: one closed mesh of a four-legged animal, about two units long. It stands on the ground y = 0
/// with the origin between its feet, y up, and looks along +x.
pub fn creature_glb() -> &'static [u8] {
    include_bytes!("creature.glb")
}

/// The figure as a GLB file: a person with the arms stretched out, about 1.75 units tall, on the ground y = 0, y up, looking
/// along +z. Primitive 0 is the body, 1 and 2 are its levels of detail (`lod1`, `lod2`), 3 is a hull for collisions. Its
/// clips are called `walk` and `wave`, its sockets `rightHandSocket` and `hatSocket`.
pub fn figure_glb() -> &'static [u8] {
    include_bytes!("figure.glb")
}

/// The figure's body alone, as a GLB file: one closed mesh, without a skeleton.
pub fn body_glb() -> &'static [u8] {
    include_bytes!("body.glb")
}

/// A model that needs no file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum BuiltInModel {
    /// A four-legged creature: one closed mesh.
    Creature,
    /// A person with a skeleton, two clips, two levels of detail, a hull for collisions and two sockets.
    Figure,
}

impl BuiltInModel {
    /// All built-in models.
    pub const ALL: [Self; 2] = [Self::Creature, Self::Figure];

    /// The model's name, without an extension.
    pub fn name(self) -> &'static str {
        match self {
            Self::Creature => "creature",
            Self::Figure => "figure",
        }
    }

    /// The model of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// The names of all models, for a sentence: "creature or figure".
    pub fn name_list() -> String {
        Self::ALL.map(Self::name).join(" or ")
    }

    /// The model's GLB file.
    pub fn glb(self) -> &'static [u8] {
        match self {
            Self::Creature => creature_glb(),
            Self::Figure => figure_glb(),
        }
    }
}

/// A BVH recording of a body 175 units tall, y up, facing along z, whose arms are stretched out in the rest pose. All
/// recordings have the same skeleton and 30 frames a second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BuiltInRecording {
    /// From standing to a boxer's stance; jabs, a cross, a hook, a duck and an uppercut.
    Boxing,
    /// A dance: plié, rise, a leg that unfolds, a pirouette, an arabesque, a leap.
    Ballet,
    /// The left hand of a stretched-out arm turns over by 170 degrees, and nothing else moves.
    Twist,
}

impl BuiltInRecording {
    /// All built-in recordings.
    pub const ALL: [Self; 3] = [Self::Boxing, Self::Ballet, Self::Twist];

    /// The recording's name, without an extension.
    pub fn recording_name(self) -> &'static str {
        match self {
            Self::Boxing => "boxing",
            Self::Ballet => "ballet",
            Self::Twist => "twist",
        }
    }

    /// The recording of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        let mut all = Self::ALL.into_iter();
        all.find(|recording| recording.recording_name() == name)
    }

    /// The recording's BVH file.
    pub fn bvh_text(self) -> String {
        match self {
            Self::Boxing => include_str!("boxing.bvh"),
            Self::Ballet => include_str!("ballet.bvh"),
            Self::Twist => include_str!("twist.bvh"),
        }
        .to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::Shape;
    use crate::shapes::tests::{boundary_edges, euler, volume};
    use crate::{FileSet, Limits, Model};
    use glam::DVec3;

    fn read(glb: &'static [u8]) -> Model {
        let model = Model::read(FileSet::single("sample.glb", glb), None, &Limits::default()).expect("it is a GLB");
        assert!(model.warnings.is_empty(), "{:?}", model.warnings);
        model
    }

    /// Checks that a shape is one closed manifold and returns its volume.
    fn closed_volume(shape: &Shape) -> f64 {
        assert_eq!((boundary_edges(shape), euler(shape)), (0, 2));
        volume(shape)
    }

    #[test]
    fn the_creature_is_one_closed_manifold_of_modest_size() {
        let creature = read(creature_glb());
        let count = creature.positions.len();
        assert!((6000..=9000).contains(&count), "{count} vertices");
        assert!(creature.primitives[0].has_normals);
        assert!(closed_volume(&(creature.positions.clone(), creature.triangles.clone())) > 0.2);
        let (low, high) = creature
            .positions
            .iter()
            .fold((DVec3::MAX, DVec3::MIN), |(l, h), p| (l.min(*p), h.max(*p)));
        assert!(
            low.y.abs() < 0.02 && (1.8..2.3).contains(&(high.x - low.x)),
            "from {low} to {high}"
        );
    }

    #[test]
    fn normals_agree_with_the_triangles() {
        let creature = read(creature_glb());
        for t in &creature.triangles {
            let [a, b, c] = t.map(|v| creature.positions[v as usize]);
            let face = (b - a).cross(c - a).normalize();
            for &v in t {
                let normal = creature.normals[v as usize].as_dvec3();
                assert!((normal.length() - 1.0).abs() < 1e-5 && normal.dot(face) > 0.2);
            }
        }
    }

    #[test]
    fn the_named_regions_hold_what_they_say() {
        let positions = read(creature_glb()).positions.clone();
        let in_sphere = |(center, radius): ([f64; 3], f64)| {
            positions
                .iter()
                .filter(|p| p.distance(DVec3::from_array(center)) <= radius)
                .copied()
                .collect::<Vec<_>>()
        };
        let (head, tail) = (in_sphere(HANDLES.head), in_sphere(HANDLES.tail));
        assert!(head.len() > 300 && head.iter().all(|p| p.x > 0.3 && p.y > 0.8));
        assert!(tail.len() > 20 && tail.iter().all(|p| p.x < -0.8));
        let (normal, offset) = HANDLES.feet;
        let feet: Vec<_> = positions
            .iter()
            .filter(|p| p.dot(DVec3::from_array(normal)) >= offset)
            .collect();
        for (front, left) in [(false, false), (false, true), (true, false), (true, true)] {
            assert!(
                feet.iter()
                    .filter(|p| (p.x > 0.0) == front && (p.z > 0.0) == left)
                    .count()
                    > 50
            );
        }
    }

    #[test]
    fn every_level_of_detail_is_one_closed_manifold() {
        let figure = read(figure_glb());
        let expected = [
            ("body", 5000..=8000),
            ("lod1", 1200..=2500),
            ("lod2", 400..=1000),
            ("hull", 100..=500),
        ];
        assert_eq!(figure.primitives.len(), expected.len());
        for (part, (name, counts)) in figure.primitives.iter().zip(expected) {
            assert_eq!(part.name, name);
            let own = part.vertices();
            assert!(counts.contains(&own.len()), "{} vertices of {name}", own.len());
            let triangles = figure.triangles.iter().filter(|t| own.contains(&(t[0] as usize)));
            let local = triangles.map(|t| t.map(|v| v - part.first_vertex)).collect();
            let volume = closed_volume(&(figure.positions[own].to_vec(), local));
            assert!((0.05..0.25).contains(&volume), "{name}: {volume}");
        }
        let body = read(body_glb());
        let volume = closed_volume(&(body.positions.clone(), body.triangles.clone()));
        assert!((0.05..0.25).contains(&volume), "{volume}");
    }
}

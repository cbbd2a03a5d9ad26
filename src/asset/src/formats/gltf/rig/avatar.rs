//! What avatars (VRM) say in lengths beside their nodes: colliders, radii, the places of eyes. It follows the surface.
//!
//! A point goes as the surface around it does, seen from the new place of its node; a radius grows with it. Of VRM 0.x these are
//! `secondaryAnimation` and `firstPersonBoneOffset`, whose points have z the other way round than nodes, as UniVRM writes and
//! three-vrm reads them; of VRM 1.0 `VRMC_springBone` with its extended colliders, and `lookAt.offsetFromHeadBone`.
//! Directions and numbers without a length, such as gravity and stiffness, stay.

use super::super::builder::json_floats;
use super::super::document::GltfDocument;
use super::super::placement::{SkinPose, invert};
use super::super::scene::PlacedScene;
use super::super::text::{
    JsonEdits, index_of, json_array, json_object, list_of, members, string_of, value_at, value_of, with_member,
};
use super::motions::{SkinnedShape, fits_at};
use super::nodes::MovedNodes;
use glam::DVec3;
use pliant_mesh::BoundingBox;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The extensions of which lengths follow.
pub(in super::super) const MEASURED: [&str; 3] = ["VRM", "VRMC_vrm", "VRMC_springBone"];

/// Lengths that change by less than this share of the model's size are left as they are written.
const SAME: f64 = 1e-6;

/// How many places are looked at; what a file has beyond stays as it is stored.
const MOST_PLACES: usize = 16_384;

/// An extension of the document itself.
fn extension<'a>(doc: &GltfDocument<'a>, name: &str) -> Option<&'a str> {
    value_at(doc.text, &["extensions", name])
}

/// Whether a document is an avatar of VRM 0.x, whose joints must not be turned.
pub(in super::super) fn is_vrm0(doc: &GltfDocument<'_>) -> bool {
    extension(doc, MEASURED[0]).is_some()
}

/// Whether a document is an avatar whose lengths may follow.
pub(super) fn is_measured(doc: &GltfDocument<'_>) -> bool {
    MEASURED.iter().any(|name| extension(doc, name).is_some())
}

/// The extensions of a document with what VRM 0.x says of each material, for materials that are added behind its own: that they
/// are drawn as glTF says. `None` for other documents.
pub(in super::super) fn extensions_with_materials(doc: &GltfDocument<'_>, added: &[String]) -> Option<String> {
    let vrm = extension(doc, MEASURED[0])?;
    value_of(vrm, "materialProperties")?;
    let plain = |text: &String| {
        let name = value_of(text, "name").unwrap_or("\"\"");
        json_object([
            ("name", name),
            ("shader", "\"VRM_USE_GLTFSHADER\""),
            ("renderQueue", "2000"),
            ("floatProperties", "{}"),
            ("vectorProperties", "{}"),
            ("textureProperties", "{}"),
            ("keywordMap", "{}"),
            ("tagMap", "{}"),
        ])
    };
    let stored = list_of(vrm, "materialProperties").into_iter().map(str::to_owned);
    let list = json_array(stored.chain(added.iter().map(plain)));
    let vrm = with_member(vrm, "materialProperties", list);
    Some(with_member(value_of(doc.text, "extensions")?, MEASURED[0], vrm))
}

/// The nodes that a document calls bones of its avatar: of the body, and of chains that swing. Most are joints of skins.
pub(super) fn bones(doc: &GltfDocument<'_>) -> BTreeSet<usize> {
    let [vrm, core, springs] = MEASURED.map(|name| extension(doc, name));
    let node = |bone: &str| index_of(bone, "node");
    let mut bones = BTreeSet::new();
    let body = vrm.and_then(|vrm| value_of(vrm, "humanoid"));
    bones.extend(
        body.into_iter()
            .flat_map(|body| list_of(body, "humanBones"))
            .filter_map(node),
    );
    let groups = vrm.and_then(|vrm| value_of(vrm, "secondaryAnimation"));
    let roots = groups.into_iter().flat_map(|groups| list_of(groups, "boneGroups"));
    let roots = roots.flat_map(|group| list_of(group, "bones"));
    bones.extend(chain(doc, roots.filter_map(|bone| bone.parse().ok()).collect()));
    let body = core.and_then(|core| value_at(core, &["humanoid", "humanBones"]));
    let named = body.and_then(|body| members(body).ok()).unwrap_or_default();
    bones.extend(named.iter().filter_map(|bone| node(bone.value)));
    let chains = springs.into_iter().flat_map(|springs| list_of(springs, "springs"));
    let links = chains.flat_map(|spring| list_of(spring, "joints"));
    bones.extend(links.filter_map(node));
    bones
        .into_iter()
        .filter(|bone| *bone < doc.nodes.len())
        .take(MOST_PLACES)
        .collect()
}

/// Nodes and all below them, as far as places are looked at.
fn chain(doc: &GltfDocument<'_>, mut open: Vec<usize>) -> Vec<usize> {
    let mut nodes = Vec::new();
    while let Some(node) = open.pop()
        && nodes.len() <= MOST_PLACES
    {
        nodes.push(node);
        let children = doc.nodes.get(node).map_or(&[][..], |node| &node.children);
        open.extend(children.iter().map(|child| child.index()));
    }
    nodes
}

/// How a point is written.
#[derive(Clone, Copy)]
enum PointForm {
    /// As members x, y and z, the last of which is turned round.
    Turned,
    List,
}

/// A place, in the space of a node.
#[derive(Clone, Copy)]
struct AvatarPlace {
    node: usize,
    local: DVec3,
}

enum MeasureKind {
    Point(PointForm),
    /// A length, of the mean size of its places.
    Length(f64),
}

/// One number or point of an avatar.
struct Measure<'a> {
    /// The object that has it.
    holder: &'a str,
    key: &'static str,
    places: Vec<AvatarPlace>,
    what: MeasureKind,
}

fn number(object: &str, key: &str) -> Option<f64> {
    let number: Option<f64> = value_of(object, key).and_then(|text| text.parse().ok());
    number.filter(|number| number.is_finite())
}

impl PointForm {
    /// Zero where nothing is written.
    fn read(self, holder: &str, key: &str) -> DVec3 {
        let lanes: [f64; 3] = match self {
            Self::Turned => {
                let point = value_of(holder, key).unwrap_or("{}");
                ["x", "y", "z"].map(|lane| number(point, lane).unwrap_or(0.0))
            }
            Self::List => {
                let list = list_of(holder, key);
                [0, 1, 2].map(|lane| list.get(lane).and_then(|text| text.parse().ok()).unwrap_or(0.0))
            }
        };
        let point = DVec3::from_array(lanes);
        match self {
            _ if !point.is_finite() => DVec3::ZERO,
            Self::Turned => point * DVec3::new(1.0, 1.0, -1.0),
            Self::List => point,
        }
    }

    fn write(self, point: DVec3) -> String {
        let [x, y, z] = point.as_vec3().to_array();
        match self {
            Self::Turned => json_object(["x", "y", "z"].into_iter().zip([x, y, -z])),
            Self::List => json_floats(&[x, y, z]),
        }
    }
}

/// The measures of a document, in an order that its text alone gives.
struct Measures<'d, 'a> {
    doc: &'d GltfDocument<'a>,
    list: Vec<Measure<'a>>,
    places: usize,
}

/// Says how many places of an avatar are more than are looked at.
pub(in super::super) fn places_beyond(doc: &GltfDocument<'_>) -> Option<String> {
    let places = if is_measured(doc) { Measures::count(doc) } else { 0 };
    (places > MOST_PLACES).then(|| {
        format!(
            "the avatar has lengths and offsets at more than {MOST_PLACES} places; those beyond stay as they are stored when its shape changes"
        )
    })
}

impl<'a> Measures<'_, 'a> {
    fn count(doc: &GltfDocument<'a>) -> usize {
        Self::read(doc).places
    }

    fn of(doc: &GltfDocument<'a>) -> Vec<Measure<'a>> {
        Self::read(doc).list
    }

    fn read<'d>(doc: &'d GltfDocument<'a>) -> Measures<'d, 'a> {
        let mut all = Measures {
            doc,
            list: Vec::new(),
            places: 0,
        };
        let [vrm, core, springs] = MEASURED.map(|name| extension(doc, name));
        if let Some(vrm) = vrm {
            all.add_vrm0(vrm);
        }
        let head = core.and_then(|core| index_of(value_at(core, &["humanoid", "humanBones", "head"])?, "node"));
        if let Some((head, looks)) = head.zip(core.and_then(|core| value_of(core, "lookAt"))) {
            all.add_point(looks, "offsetFromHeadBone", head, PointForm::List);
        }
        if let Some(springs) = springs {
            all.add_springs(springs);
        }
        all
    }

    fn add(&mut self, holder: &'a str, key: &'static str, places: Vec<AvatarPlace>, what: MeasureKind) {
        self.places += places.len();
        let is_there = places.iter().all(|place| place.node < self.doc.nodes.len());
        if is_there && !places.is_empty() && self.places <= MOST_PLACES {
            self.list.push(Measure {
                holder,
                key,
                places,
                what,
            });
        }
    }

    /// A point, which is returned. One at the node itself goes with the node.
    fn add_point(&mut self, holder: &'a str, key: &'static str, node: usize, form: PointForm) -> AvatarPlace {
        let place = AvatarPlace {
            node,
            local: form.read(holder, key),
        };
        if place.local != DVec3::ZERO {
            self.add(holder, key, vec![place], MeasureKind::Point(form));
        }
        place
    }

    fn add_length(&mut self, holder: &'a str, key: &'static str, places: Vec<AvatarPlace>) {
        if let Some(length) = number(holder, key).filter(|length| *length != 0.0) {
            self.add(holder, key, places, MeasureKind::Length(length));
        }
    }

    fn add_vrm0(&mut self, vrm: &'a str) {
        let bones = value_of(vrm, "humanoid").map_or(Vec::new(), |humanoid| list_of(humanoid, "humanBones"));
        let is_head = |bone: &&str| string_of(bone, "bone").as_deref() == Some("head");
        let head = bones.into_iter().find(is_head).and_then(|bone| index_of(bone, "node"));
        if let Some(first) = value_of(vrm, "firstPerson")
            && let Some(node) = index_of(first, "firstPersonBone").or(head)
        {
            self.add_point(first, "firstPersonBoneOffset", node, PointForm::Turned);
        }
        let Some(secondary) = value_of(vrm, "secondaryAnimation") else {
            return;
        };
        for group in list_of(secondary, "colliderGroups") {
            let Some(node) = index_of(group, "node") else { continue };
            for collider in list_of(group, "colliders") {
                let place = self.add_point(collider, "offset", node, PointForm::Turned);
                self.add_length(collider, "radius", vec![place]);
            }
        }
        for group in list_of(secondary, "boneGroups") {
            let bones = list_of(group, "bones").into_iter().filter_map(|bone| bone.parse().ok());
            if self.places > MOST_PLACES {
                continue;
            }
            let at_node = |node| AvatarPlace {
                node,
                local: DVec3::ZERO,
            };
            let places = chain(self.doc, bones.collect()).into_iter().map(at_node);
            self.add_length(group, "hitRadius", places.collect());
        }
    }

    fn add_springs(&mut self, springs: &'a str) {
        for collider in list_of(springs, "colliders") {
            let Some(node) = index_of(collider, "node") else {
                continue;
            };
            let extended = value_at(collider, &["extensions", "VRMC_springBone_extended_collider", "shape"]);
            for shape in [value_of(collider, "shape"), extended].into_iter().flatten() {
                if let Some(sphere) = value_of(shape, "sphere") {
                    let place = self.add_point(sphere, "offset", node, PointForm::List);
                    self.add_length(sphere, "radius", vec![place]);
                }
                if let Some(capsule) = value_of(shape, "capsule") {
                    let ends = ["offset", "tail"].map(|key| self.add_point(capsule, key, node, PointForm::List));
                    self.add_length(capsule, "radius", ends.to_vec());
                }
                if let Some(plane) = value_of(shape, "plane") {
                    self.add_point(plane, "offset", node, PointForm::List);
                }
            }
        }
        for spring in list_of(springs, "springs") {
            for joint in list_of(spring, "joints") {
                let place = index_of(joint, "node").map(|node| AvatarPlace {
                    node,
                    local: DVec3::ZERO,
                });
                self.add_length(joint, "hitRadius", place.into_iter().collect());
            }
        }
    }
}

/// What the measures of a document become on a new shape: for each its text, where that changes.
#[derive(Default)]
pub(super) struct AvatarLengths(Vec<Option<String>>);

impl AvatarLengths {
    /// `poses`: the rest poses of skins that hold vertices. `nodes`: after they have moved.
    pub(super) fn fit(
        doc: &GltfDocument<'_>,
        shape: &SkinnedShape<'_>,
        poses: &BTreeMap<usize, Arc<SkinPose>>,
        scene: &PlacedScene,
        nodes: &MovedNodes,
    ) -> Self {
        let (now, size) = (&nodes.world_from_node, BoundingBox::of(&shape.before).diagonal());
        let measures = Measures::of(doc);
        let places = measures.iter().flat_map(|measure| &measure.places);
        let in_world = |place: &AvatarPlace| {
            (
                place.node,
                scene.world_from_node[place.node].transform_point3(place.local),
            )
        };
        let places: Vec<(usize, DVec3)> = places.map(in_world).collect();
        let fits = fits_at(&places, shape, poses);
        let mut fits = places.iter().zip(fits);
        let mut of_measure = |measure: &Measure<'_>| {
            let mut own = fits.by_ref().take(measure.places.len());
            match measure.what {
                MeasureKind::Point(form) => {
                    let place = measure.places.first()?;
                    let ((_, before), fit) = own.next()?;
                    let moved = *before + fit.shift;
                    let (was, is) = (&scene.world_from_node[place.node], &now[place.node]);
                    let local = invert(is)?.transform_point3(moved);
                    let is_same = was.transform_vector3(local - place.local).length() <= SAME * size;
                    (local.as_vec3().is_finite() && !is_same).then(|| form.write(local))
                }
                MeasureKind::Length(length) => {
                    let growth = own.map(|(_, fit)| fit.growth).sum::<f64>() / measure.places.len() as f64;
                    let is_same = (growth - 1.0).abs() <= SAME;
                    let grown = (length * growth) as f32;
                    (grown.is_finite() && !is_same).then(|| format!("{grown}"))
                }
            }
        };
        Self(measures.iter().map(&mut of_measure).collect())
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.iter().all(Option::is_none)
    }

    /// Puts them into a document that was written with its avatar as it was.
    pub(super) fn write<'a>(&self, doc: &GltfDocument<'a>, edits: &mut JsonEdits<'a>) {
        if self.is_empty() {
            return;
        }
        for (measure, new) in Measures::of(doc).iter().zip(&self.0) {
            if let Some(new) = new {
                edits.set(measure.holder, measure.key, new);
            }
        }
    }
}

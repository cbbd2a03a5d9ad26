//! `pose`: regions in words become handles of the session, which are set and solved as any others.
//!
//! Between handles that touch, a band of the surface is left free, so that it can bend there.

use super::arguments::{MovedArguments, PoseArguments, Scale, message_of};
use super::scene::{Scene, SessionCaller};
use crate::answer::{ToolAnswer, place, short};
use crate::picture::{PictureOrder, draw};
use crate::words::{Found, VertexSet, plain_words};
use glam::{DQuat, DVec3};
use pliant_core::engine::Error as EngineError;
use pliant_core::mesh::rotation::exp_rotation;
use pliant_session::Error;
use pliant_wire::pb;
use serde_json::{Value, json};

/// The handle of what is held without being named.
const EVERYTHING_ELSE: &str = "everything else";
/// How wide the free band is, in diagonals of the model: between named regions, and around what moves.
const BAND: f64 = 0.05;
const WIDE_BAND: f64 = 0.1;
/// The share of a region that is held, however wide the band.
const KEPT: f64 = 0.34;
/// Factors of a scale.
const SCALES: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
/// Regions of one call.
const MOST: usize = 64;
/// Triangles up to which a pose is looked at for crossings unless options say otherwise.
const LOOKED_AT: u32 = 200_000;

/// A handle that a pose asks for.
struct WantedHandle {
    id: String,
    words: String,
    found: Found,
    /// How it moves; `None` for what is held.
    moved: Option<pb::HandlePose>,
}

/// What a pose becomes.
struct Prepared {
    handles: Vec<pb::Handle>,
    report: Vec<(String, Value, DVec3)>,
}

impl SessionCaller {
    /// Poses regions that words name.
    pub async fn pose(&self, arguments: PoseArguments) -> Result<ToolAnswer, Error> {
        let PoseArguments {
            session,
            moved,
            held,
            blend,
            fresh,
            options,
            picture,
        } = arguments;
        let count = moved.len() + held.as_ref().map_or(0, Vec::len);
        if moved.is_empty() || count > MOST {
            let problem = format!(
                "has {} entries, 1 to {MOST} are allowed with those of held",
                moved.len()
            );
            return Err(Error::invalid("moved", problem));
        }
        if let Some(blend) = blend.filter(|b| !(b.is_finite() && *b >= 0.0)) {
            return Err(Error::invalid(
                "blend",
                format!("is {blend}; a finite length of 0 or more is allowed"),
            ));
        }
        let order = picture.order()?;
        let described = self.manager.get(&self.tenant, &session).await?;
        let set = self.manager.handles(&self.tenant, &session).await?;
        let mut request = pliant_wire::handle_set_message(&set);
        if fresh {
            request.handles.clear();
        }
        for handle in &mut request.handles {
            let facts = described.handles.iter().find(|facts| facts.id == handle.id);
            handle.pose = facts.and_then(|facts| facts.pose.clone());
        }
        let before = request.handles.clone();
        let prepared = self
            .see(&session, move |scene| {
                prepare(scene, &moved, held.as_deref(), blend, before)
            })
            .await?;
        let options = match options {
            Some(options) => message_of::<pb::Options>(options, "options")?,
            None => pb::Options {
                output: Some(pb::Output {
                    self_intersections: described.primitives.iter().map(|p| p.index_count / 3).sum::<u32>()
                        <= LOOKED_AT,
                    ..Default::default()
                }),
                ..Default::default()
            },
        };
        let solve = pb::SolveRequest {
            options: Some(options),
            ..Default::default()
        };
        let commit = pliant_wire::pose_commit(&solve, self.manager.config().window)?;
        request.handles = prepared.handles;
        let handles = pliant_wire::handle_set(&request)?;
        self.manager.set_handles(&self.tenant, &session, handles, None).await?;
        let solved = match self.manager.solve(&self.tenant, &session, commit, None).await {
            Ok(solved) => solved,
            Err(error) => {
                // The handles alone are no pose.
                let _ = self.manager.undo(&self.tenant, &session, None).await;
                return Err(error);
            }
        };
        let quality = match &solved.frame.header.quality {
            Some(quality) => pliant_wire::json::to_json(quality)?,
            None => Value::Null,
        };
        self.tell(&session, prepared.report, &order, solved.revision, quality)
            .await
    }

    /// The answer of a pose: where regions are now, and how the shape has fared.
    async fn tell(
        &self,
        session: &str,
        report: Vec<(String, Value, DVec3)>,
        order: &PictureOrder,
        revision: u64,
        quality: Value,
    ) -> Result<ToolAnswer, Error> {
        let order = order.clone();
        let names: Vec<String> = report.iter().map(|own| own.0.clone()).collect();
        let (centers, png) = self
            .see(session, move |scene| {
                let regions: Result<Vec<_>, EngineError> = names
                    .iter()
                    .map(|name| Ok((name.clone(), scene.resolver.resolve(name, "moved")?.set)))
                    .collect();
                let regions = regions?;
                let center = |set: &VertexSet| scene.figure.center(set, scene.positions).unwrap_or_default();
                let centers: Vec<DVec3> = regions.iter().map(|(_, set)| center(set)).collect();
                let figure = scene.figure;
                let png = draw(
                    figure.deformer,
                    scene.positions,
                    figure.upright(),
                    &regions,
                    &order,
                    figure.exec,
                )?;
                Ok((centers, png))
            })
            .await?;
        let mut text = String::new();
        let mut moved = Vec::new();
        for ((name, mut facts, rest), center) in report.into_iter().zip(centers) {
            text += &format!(
                "\"{name}\": its middle is at {}, in the rest pose it is at {}.\n",
                place(center),
                place(rest)
            );
            facts["center"] = json!(center.to_array());
            moved.push(facts);
        }
        let number = |name: &str| quality.get(name).and_then(Value::as_f64).unwrap_or_default();
        text += &format!(
            "Shape against rest: volume {:+.1} %, mean stretch of edges {:.1} %, largest stretch {}, {} triangles turned over",
            100.0 * number("volumeChange"),
            100.0 * number("edgeRms"),
            short(number("maxStretch")),
            number("flippedTriangles"),
        );
        if let Some(pairs) = quality.get("newSelfIntersections").and_then(Value::as_f64) {
            text += &format!(", {pairs} new pairs of triangles cross");
            if pairs > 0.0 {
                text += " (options {\"contact\": \"AVOID\"} moves them apart)";
            }
        }
        text += ". Regions that moved are coloured. `undo` takes the pose back.";
        Ok(ToolAnswer {
            text,
            facts: json!({"session": session, "revision": revision, "moved": moved, "quality": quality}),
            pictures: vec![png],
            ..ToolAnswer::default()
        })
    }
}

/// The id of a handle for words.
fn handle_id(words: &str) -> String {
    let mut id = plain_words(words).join(" ");
    let mut end = id.len().min(120);
    while !id.is_char_boundary(end) {
        end -= 1;
    }
    id.truncate(end);
    id
}

fn means_everything_else(words: &str) -> bool {
    matches!(
        handle_id(words).as_str(),
        EVERYTHING_ELSE | "rest" | "all else" | "rest of model" | "others"
    )
}

/// The regions that a pose names, and how each moves.
fn named_regions(
    scene: &Scene<'_>,
    moved: &[MovedArguments],
    held: &[String],
    before: &[pb::Handle],
) -> Result<Vec<WantedHandle>, EngineError> {
    let mut wanted: Vec<WantedHandle> = Vec::new();
    for (k, words) in held.iter().enumerate() {
        let id = handle_id(words);
        if means_everything_else(words) || before.iter().any(|handle| handle.id == id) {
            continue;
        }
        let found = scene.resolver.resolve(words, &format!("held[{k}]"))?;
        let words = words.clone();
        wanted.push(WantedHandle {
            id,
            words,
            found,
            moved: None,
        });
    }
    for (k, asked) in moved.iter().enumerate() {
        let field = format!("moved[{k}]");
        let found = scene.resolver.resolve(&asked.region, &format!("{field}.region"))?;
        let pose = handle_pose(scene, asked, &found, &field)?;
        let id = handle_id(&asked.region);
        if wanted.iter().any(|own| own.id == id) {
            return Err(EngineError::invalid(
                format!("{field}.region"),
                format!("\"{id}\" is named twice"),
            ));
        }
        let words = asked.region.clone();
        wanted.push(WantedHandle {
            id,
            words,
            found,
            moved: Some(pose),
        });
    }
    Ok(wanted)
}

/// Resolves the regions of a pose and makes handles of them beside those `before`.
fn prepare(
    scene: &Scene<'_>,
    moved: &[MovedArguments],
    held: Option<&[String]>,
    blend: Option<f64>,
    before: Vec<pb::Handle>,
) -> Result<Prepared, EngineError> {
    let figure = scene.figure;
    let mut wanted = named_regions(scene, moved, held.unwrap_or_default(), &before)?;
    let mut holds_rest = held.is_some_and(|held| held.iter().any(|words| means_everything_else(words)));
    let is_same = |handle: &pb::Handle| wanted.iter().any(|own| own.id == handle.id);
    holds_rest |= held.is_none()
        && before
            .iter()
            .all(|handle| handle.id == EVERYTHING_ELSE || is_same(handle));
    let mut kept: Vec<pb::Handle> = before
        .into_iter()
        .filter(|h| h.id != EVERYTHING_ELSE && !is_same(h))
        .collect();
    // Where regions overlap the later handle holds: a hand that is named beside its arm is a hand.
    wanted.sort_by_key(|own| std::cmp::Reverse(own.found.set.count()));
    let fresh = wanted
        .iter()
        .fold(VertexSet::none(figure.count()), |all, own| all.or(&own.found.set));
    // What is wholly covered by what is named now moves with that.
    kept.retain(|handle| {
        let own = vertices_of(handle, figure.count());
        own.count() == 0 || own.minus(&fresh).count() > 0
    });
    let mut sets: Vec<VertexSet> = kept.iter().map(|handle| vertices_of(handle, figure.count())).collect();
    if holds_rest {
        let set = everything_else(scene, &wanted, &sets, blend)?;
        let found = Found {
            set,
            pivot: None,
            how: "everything that is far enough from what moves".to_owned(),
            others: Vec::new(),
        };
        let id = EVERYTHING_ELSE.to_owned();
        wanted.insert(
            0,
            WantedHandle {
                words: id.clone(),
                id,
                found,
                moved: None,
            },
        );
    }
    sets.extend(wanted.iter().map(|own| own.found.set.clone()));
    let band = blend.unwrap_or(BAND * figure.deformer.diagonal());
    let moves = kept.iter().map(|handle| handle.pose.is_some());
    let moves: Vec<bool> = moves.chain(wanted.iter().map(|own| own.moved.is_some())).collect();
    let trimmed = trim(scene, &sets, &moves, band)?.split_off(kept.len());
    let mut handles = kept;
    let mut report = Vec::new();
    for (own, set) in wanted.into_iter().zip(trimmed) {
        handles.push(handle_of(&own, &set));
        if own.moved.is_some() {
            let rest = figure
                .center(&own.found.set, figure.deformer.rest())
                .unwrap_or_default();
            let mut value = scene.facts(&own.found).value;
            value["region"] = own.id.as_str().into();
            report.push((own.words, value, rest));
        }
    }
    Ok(Prepared { handles, report })
}

fn handle_of(own: &WantedHandle, set: &VertexSet) -> pb::Handle {
    let vertices = pb::region::Vertices {
        indices: set.list(),
        ranges: Vec::new(),
    };
    pb::Handle {
        id: own.id.clone(),
        region: Some(pb::Region {
            region: Some(pb::region::Region::Vertices(vertices)),
        }),
        pose: own.moved.clone(),
        ..Default::default()
    }
}

fn vertices_of(handle: &pb::Handle, count: usize) -> VertexSet {
    match handle.region.as_ref().and_then(|region| region.region.as_ref()) {
        Some(pb::region::Region::Vertices(own)) => {
            let runs = own
                .ranges
                .iter()
                .flat_map(|run| run.first..run.first.saturating_add(run.count));
            let in_model = runs.take_while(|v| (*v as usize) < count);
            let list: Vec<u32> = own.indices.iter().copied().chain(in_model).collect();
            VertexSet::of_list(count, &list)
        }
        _ => VertexSet::none(count),
    }
}

/// The pose of a region that moves.
fn handle_pose(
    scene: &Scene<'_>,
    asked: &MovedArguments,
    found: &Found,
    field: &str,
) -> Result<pb::HandlePose, EngineError> {
    let figure = scene.figure;
    let refuse = |e: Error| EngineError::invalid(e.field.clone().unwrap_or_default(), strip(&e));
    if asked.rotation.is_some() && asked.aim.is_some() {
        return Err(EngineError::invalid(format!("{field}.aim"), "goes without rotation"));
    }
    if asked.to.is_some() && asked.translation.is_some() {
        return Err(EngineError::invalid(format!("{field}.to"), "goes without translation"));
    }
    let center = figure.center(&found.set, figure.deformer.rest()).unwrap_or_default();
    let pivot = asked.pivot.map(DVec3::from_array).or(found.pivot);
    let model_from_upright = figure.upright().transpose();
    let turn = match (&asked.rotation, &asked.aim) {
        (Some(turn), _) => {
            let axis = turn
                .axis
                .vector(model_from_upright, &format!("{field}.rotation.axis"))
                .map_err(refuse)?;
            if !turn.degrees.is_finite() || turn.degrees.abs() > 36_000.0 {
                let problem = format!("is {}; -36000 to 36000 are allowed", turn.degrees);
                return Err(EngineError::invalid(format!("{field}.rotation.degrees"), problem));
            }
            Some(axis * turn.degrees.to_radians())
        }
        (None, Some(aim)) => {
            let goal = aim
                .vector(model_from_upright, &format!("{field}.aim"))
                .map_err(refuse)?;
            let from = pivot.and_then(|pivot| (center - pivot).try_normalize());
            let from = from.ok_or_else(|| {
                let problem = "needs a region that hangs on something, or a pivot beside its middle";
                EngineError::invalid(format!("{field}.aim"), problem)
            })?;
            Some(shortest_turn(from, goal, model_from_upright * DVec3::Z))
        }
        (None, None) => None,
    };
    let scale = match &asked.scale {
        None => DVec3::ONE,
        Some(Scale::Uniform(factor)) => DVec3::splat(*factor),
        Some(Scale::Axes(factors)) => DVec3::from_array(*factors),
    };
    if !scale.to_array().iter().all(|factor| SCALES.contains(factor)) {
        let (least, most) = (SCALES.start(), SCALES.end());
        return Err(EngineError::invalid(
            format!("{field}.scale"),
            format!("is {scale}; {least} to {most} are allowed"),
        ));
    }
    let pivot = pivot.unwrap_or(center);
    let turned = turn.map_or(DQuat::IDENTITY, exp_rotation);
    let translation = match (asked.to, asked.translation) {
        (Some(to), _) => Some(DVec3::from_array(to) - (pivot + turned * (scale * (center - pivot)))),
        (None, Some(by)) => Some(DVec3::from_array(by)),
        (None, None) => None,
    };
    if translation.is_none() && turn.is_none() && asked.scale.is_none() {
        return Err(EngineError::invalid(
            field,
            "needs one of translation, to, rotation, aim and scale",
        ));
    }
    let turns = turn.is_some() || asked.scale.is_some();
    Ok(pb::HandlePose {
        translation: translation.map(|t| t.to_array().to_vec()).unwrap_or_default(),
        rotation_vector: turn.map(|t| t.to_array().to_vec()).unwrap_or_default(),
        scale: asked
            .scale
            .as_ref()
            .map(|_| scale.to_array().to_vec())
            .unwrap_or_default(),
        pivot: if turns { pivot.to_array().to_vec() } else { Vec::new() },
        free_rotation: asked.turn_freely,
        ..Default::default()
    })
}

/// What is wrong, without the field.
fn strip(error: &Error) -> String {
    let start = error
        .field
        .as_ref()
        .map(|field| format!("{field}: "))
        .unwrap_or_default();
    error
        .message
        .strip_prefix(start.as_str())
        .unwrap_or(&error.message)
        .to_owned()
}

/// The shortest turn from one direction to another, axis times angle; half a turn is about `else_about` or what is square to it.
fn shortest_turn(from: DVec3, to: DVec3, else_about: DVec3) -> DVec3 {
    let cross = from.cross(to);
    let angle = libm::atan2(cross.length(), from.dot(to));
    match cross.try_normalize() {
        Some(axis) => axis * angle,
        None if from.dot(to) > 0.0 => DVec3::ZERO,
        None => {
            (else_about - from * else_about.dot(from)).normalize_or(from.any_orthonormal_vector())
                * std::f64::consts::PI
        }
    }
}

/// What is farther from all that moves than the band, along the surface.
fn everything_else(
    scene: &Scene<'_>,
    wanted: &[WantedHandle],
    kept: &[VertexSet],
    blend: Option<f64>,
) -> Result<VertexSet, EngineError> {
    let figure = scene.figure;
    let none = || VertexSet::none(figure.count());
    let moving = wanted
        .iter()
        .filter(|own| own.moved.is_some())
        .fold(none(), |set, own| set.or(&own.found.set));
    let moving = kept.iter().fold(moving, |set, own| set.or(own));
    let band = blend.unwrap_or(WIDE_BAND * figure.deformer.diagonal());
    let far = figure.distances(&figure.welded(&moving), None, f64::INFINITY)?;
    let held = figure.rendered(|s| far[s as usize].is_finite() && far[s as usize] > band);
    if held.count() > 0 {
        return Ok(held);
    }
    let apart = figure.rendered(|s| far[s as usize].is_infinite());
    if apart.count() > 0 {
        return Ok(apart);
    }
    let problem = format!(
        "nothing is farther than {} from what moves, so nothing would be held; name what is held, or give a smaller blend",
        short(band)
    );
    Err(EngineError::invalid("held", problem))
}

/// The sets without the band along where one that moves meets another; later ones have what several hold.
fn trim(scene: &Scene<'_>, sets: &[VertexSet], moves: &[bool], band: f64) -> Result<Vec<VertexSet>, EngineError> {
    let figure = scene.figure;
    let count = figure.mesh().positions.len();
    let mut owner: Vec<Option<usize>> = vec![None; count];
    for (k, set) in sets.iter().enumerate() {
        figure.welded(set).into_iter().for_each(|s| owner[s as usize] = Some(k));
    }
    let meets = |own: usize, other: u32| {
        owner[other as usize].is_some_and(|other| other != own && (moves[own] || moves[other]))
    };
    let is_seam =
        |s: &u32| owner[*s as usize].is_some_and(|own| figure.neighbours(*s).iter().any(|other| meets(own, *other)));
    let seams: Vec<u32> = (0..count as u32).filter(is_seam).collect();
    let far = figure.distances(&seams, None, f64::INFINITY)?;
    let mut trimmed = Vec::with_capacity(sets.len());
    for (k, set) in sets.iter().enumerate() {
        let mut own: Vec<f64> = (0..count).filter(|s| owner[*s] == Some(k)).map(|s| far[s]).collect();
        own.sort_by(|a, b| b.total_cmp(a));
        // However wide the band, some of each region is left to hold it by.
        let least = own.get(((own.len() as f64 * KEPT) as usize).min(own.len().saturating_sub(1)));
        let from = least.map_or(0.0, |least| least.min(band));
        let left = figure.rendered(|s| owner[s as usize] == Some(k) && (far[s as usize] >= from || seams.is_empty()));
        trimmed.push(left.and(set));
    }
    Ok(trimmed)
}

//! The tools that look, name, go back and list.

use super::arguments::{CloseArguments, LookArguments, RegionArguments, SessionsArguments, StepArguments};
use super::scene::{Scene, SessionCaller};
use crate::answer::{ToolAnswer, place, short};
use crate::kept::{MOST_NAMES, NamedRegion};
use crate::picture::{PictureOrder, draw};
use crate::words::{VertexSet, plain_words};
use pliant_asset::is_hidden;
use pliant_core::engine::Error as EngineError;
use pliant_core::mesh::BoundingBox;
use pliant_session::Error;
use pliant_wire::pb;
use serde_json::{Value, json};
use std::sync::Arc;

/// Regions that one picture highlights.
const MOST_HIGHLIGHTS: usize = 16;
/// Sessions of a page.
const PAGE: u32 = 50;

/// Which way is which in pictures.
const CONVENTIONS: &str =
    "Left and right are the figure's own; in the front view its left is on the right of the picture.";

impl SessionCaller {
    /// Draws a session and lists what is there.
    pub async fn look(&self, arguments: LookArguments) -> Result<ToolAnswer, Error> {
        if arguments.highlight.len() > MOST_HIGHLIGHTS {
            let problem = format!(
                "has {} entries, at most {MOST_HIGHLIGHTS} are allowed",
                arguments.highlight.len()
            );
            return Err(Error::invalid("highlight", problem));
        }
        let order = arguments.picture.order()?;
        self.seen(&arguments.session, arguments.highlight, order).await
    }

    /// The answer that shows a session: what is there, and a picture.
    pub(super) async fn seen(
        &self,
        session: &str,
        highlight: Vec<String>,
        order: PictureOrder,
    ) -> Result<ToolAnswer, Error> {
        let described = self.manager.get(&self.tenant, session).await?;
        let views: Vec<&str> = order.views.iter().map(|view| view.name()).collect();
        let views = views.join(", ");
        let (mut facts, words, png) = self
            .see(session, move |scene| {
                let regions: Result<Vec<_>, EngineError> = (highlight.iter().enumerate())
                    .map(|(k, words)| {
                        Ok((
                            words.clone(),
                            scene.resolver.resolve(words, &format!("highlight[{k}]"))?,
                        ))
                    })
                    .collect();
                let regions = regions?;
                let told: Vec<Value> = regions
                    .iter()
                    .map(|(words, found)| {
                        let mut value = scene.facts(found).value;
                        value["words"] = words.as_str().into();
                        value
                    })
                    .collect();
                let sets: Vec<(String, VertexSet)> = regions.into_iter().map(|(words, own)| (words, own.set)).collect();
                let png = picture(scene, &sets, &order)?;
                let mut facts = shape_facts(scene);
                facts["highlight"] = told.into();
                Ok((facts, scene.resolver.what_there_is()?, png))
            })
            .await?;
        facts["session"] = session.into();
        facts["revision"] = described.revision.into();
        facts["label"] = described.label.as_str().into();
        let moved: Vec<&str> = described
            .handles
            .iter()
            .filter(|h| h.pose.is_some())
            .map(|h| h.id.as_str())
            .collect();
        let still: Vec<&str> = described
            .handles
            .iter()
            .filter(|h| h.pose.is_none())
            .map(|h| h.id.as_str())
            .collect();
        facts["moved"] = json!(moved);
        facts["held"] = json!(still);
        let number = |name: &str| facts.get(name).and_then(Value::as_u64).unwrap_or_default();
        let mut text = format!(
            "{} vertices, {} triangles, {}; its box goes from {} to {}, up is {}, the front is {}, left is {}.\n",
            number("vertices"),
            number("triangles"),
            match number("parts") {
                1 => "1 connected part".to_owned(),
                parts => format!("{parts} connected parts"),
            },
            facts["box"]["min"],
            facts["box"]["max"],
            facts["up"].as_str().unwrap_or_default(),
            facts["front"].as_str().unwrap_or_default(),
            facts["left"].as_str().unwrap_or_default(),
        );
        if !described.handles.is_empty() {
            let list = |all: &[&str]| {
                if all.is_empty() {
                    "nothing".to_owned()
                } else {
                    all.join(", ")
                }
            };
            text += &format!("Moved: {}; held: {}.\n", list(&moved), list(&still));
        }
        let hidden: Vec<&str> = (described.primitives.iter())
            .map(|primitive| primitive.name.as_str())
            .filter(|name| is_hidden(name))
            .collect();
        if !hidden.is_empty() {
            text += &format!("Not drawn: {}.\n", hidden.join(", "));
        }
        text += &format!("In words, {words}.\nThe picture: {views}. {CONVENTIONS}");
        Ok(ToolAnswer {
            text,
            facts,
            pictures: vec![png],
            ..ToolAnswer::default()
        })
    }

    /// Resolves words to a region and keeps it under a name.
    pub async fn region(&self, arguments: RegionArguments) -> Result<ToolAnswer, Error> {
        let order = arguments.picture.order()?;
        let words = arguments.words;
        let name = plain_words(arguments.name.as_deref().unwrap_or(&words)).join(" ");
        if name.is_empty() || name.len() > 120 {
            let field = if arguments.name.is_some() { "name" } else { "words" };
            return Err(Error::invalid(field, "needs 1 to 120 bytes of letters and digits"));
        }
        let (shown, asked) = (name.clone(), words.clone());
        let (found, topology, facts, png) = self
            .see(&arguments.session, move |scene| {
                let found = scene.resolver.resolve(&asked, "words")?;
                let png = picture(scene, &[(shown, found.set.clone())], &order)?;
                let facts = scene.facts(&found);
                Ok((found, scene.topology, facts, png))
            })
            .await?;
        let notes = self.kept.notes(&self.tenant, &arguments.session);
        if notes.regions.len() >= MOST_NAMES && !notes.regions.contains_key(&name) {
            return Err(Error::invalid(
                "name",
                format!("{MOST_NAMES} regions have names already, no more are allowed"),
            ));
        }
        let region = NamedRegion {
            words,
            vertices: Arc::new(found.set.list()),
            pivot: found.pivot,
            topology,
        };
        let count = region.vertices.len();
        self.remember(&arguments.session, |notes| {
            _ = notes.regions.insert(name.clone(), region)
        })?;
        let mut text = format!(
            "\"{name}\" is {}: {count} vertices, their middle at {}",
            found.how,
            place(facts.center)
        );
        if let Some(pivot) = found.pivot {
            text += &format!("; it turns about {}", place(pivot));
        }
        text += ". The picture shows it in colour; the name can be used in all tools.";
        if !found.others.is_empty() {
            text += &format!(" Others that may be meant: {}.", found.others.join(", "));
        }
        let mut value = facts.value;
        value["name"] = name.into();
        Ok(ToolAnswer {
            text,
            facts: value,
            pictures: vec![png],
            ..ToolAnswer::default()
        })
    }

    /// Goes back by one pose or edit, or forward again. Commits of handles alone, which change no shape, are passed.
    pub async fn step(&self, arguments: StepArguments, is_undo: bool) -> Result<ToolAnswer, Error> {
        let StepArguments { session, picture } = arguments;
        let order = picture.order()?;
        let go = async || match is_undo {
            true => self.manager.undo(&self.tenant, &session, None).await,
            false => self.manager.redo(&self.tenant, &session, None).await,
        };
        let kind_now = async || -> Result<String, Error> {
            let history = self.manager.history(&self.tenant, &session).await?;
            let now = history
                .commits
                .into_iter()
                .find(|commit| commit.revision == history.current);
            Ok(now.map(|commit| commit.kind).unwrap_or_default())
        };
        let mut was = kind_now().await?;
        go().await?;
        loop {
            let now = kind_now().await?;
            // Back: what stands before a pose are its handles. Forward: handles come before their pose.
            let is_half_way = now == "handles" || is_undo && was == "handles";
            if !is_half_way || go().await.is_err() {
                break;
            }
            was = now;
        }
        let seen = self.seen(&session, Vec::new(), order).await?;
        let done = if is_undo { "Undone" } else { "Redone" };
        Ok(ToolAnswer {
            text: format!("{done}. {}", seen.text),
            ..seen
        })
    }

    /// Closes a session.
    pub async fn close(&self, arguments: CloseArguments) -> Result<ToolAnswer, Error> {
        self.manager.delete(&self.tenant, &arguments.session).await?;
        self.kept.forget(&self.tenant, &arguments.session);
        Ok(ToolAnswer {
            text: format!("Session {} is closed.", arguments.session),
            facts: json!({"session": arguments.session}),
            ..ToolAnswer::default()
        })
    }

    /// Lists the caller's sessions.
    pub async fn sessions(&self, arguments: SessionsArguments) -> Result<ToolAnswer, Error> {
        let request = pb::ListSessionsRequest {
            page_size: PAGE,
            page_token: arguments.page_token.unwrap_or_default(),
        };
        let list = self
            .manager
            .list(&self.tenant, pliant_wire::session_page(&request)?)
            .await?;
        let mut lines = Vec::new();
        let mut facts = Vec::new();
        for session in &list.sessions {
            let vertices = session.model.as_ref().map_or(0, |model| model.vertices);
            lines.push(format!(
                "{}: {vertices} vertices, revision {}, {}",
                session.id, session.revision, session.label
            ));
            facts.push(json!({
                "session": session.id,
                "vertices": vertices,
                "revision": session.revision,
                "label": session.label,
                "expiresAt": session.expires_at,
            }));
        }
        let mut facts = json!({"sessions": facts});
        if let Some(after) = list.next_after {
            facts["nextPageToken"] = pliant_wire::page_token(after).into();
        }
        let text = if lines.is_empty() {
            "No session is open.".to_owned()
        } else {
            lines.join("\n")
        };
        Ok(ToolAnswer {
            text,
            facts,
            ..ToolAnswer::default()
        })
    }
}

fn picture(scene: &Scene<'_>, regions: &[(String, VertexSet)], order: &PictureOrder) -> Result<Vec<u8>, EngineError> {
    let figure = scene.figure;
    draw(
        figure.deformer,
        scene.positions,
        figure.upright(),
        regions,
        order,
        figure.exec,
    )
}

/// The size of the current shape, and which way it stands.
fn shape_facts(scene: &Scene<'_>) -> Value {
    let figure = scene.figure;
    let bounds = BoundingBox::of(scene.positions);
    let axes = figure.axes;
    let left = figure.upright().transpose() * glam::DVec3::X;
    let axis = left.abs().max_position();
    let sign = if left[axis] < 0.0 { "-" } else { "" };
    json!({
        "vertices": figure.count(),
        "triangles": figure.deformer.geometry().triangles.len(),
        "parts": figure.parts().len(),
        "box": {"min": rounded(bounds.min), "max": rounded(bounds.max)},
        "up": axes.up.name(),
        "front": axes.front.name(),
        "left": format!("{sign}{}", ["x", "y", "z"][axis]),
    })
}

fn rounded(p: glam::DVec3) -> [f64; 3] {
    p.to_array().map(|x| short(x).parse().unwrap_or(x))
}

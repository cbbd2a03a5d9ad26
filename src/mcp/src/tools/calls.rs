//! The tools but `pose`: opening, looking, naming, editing, going back, taking away.

use super::arguments::{
    CloseArguments, EditArguments, ExportArguments, LookArguments, OpenArguments, RegionArguments, SessionsArguments,
    StepArguments,
};
use super::message_of;
use super::scene::{Scene, SessionCaller};
use crate::answer::{ToolAnswer, place, short};
use crate::folder::AgentFolder;
use crate::kept::{MOST_NAMES, NamedRegion};
use crate::picture::{PictureOrder, draw};
use crate::words::{VertexSet, plain_words};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;
use pliant_asset::sample::BuiltInModel;
use pliant_asset::{FileSet, Format};
use pliant_core::engine::Error as EngineError;
use pliant_core::mesh::BoundingBox;
use pliant_motion::SignedAxis;
use pliant_motion::humanoid::BodyAxes;
use pliant_session::{Error, ErrorCode, MemoryReservation, MemoryUse};
use pliant_wire::pb;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Regions that one picture highlights.
const MOST_HIGHLIGHTS: usize = 16;
/// Words inside of one edit.
const MOST_WORDS: usize = 16;
/// Sessions of a page.
const PAGE: u32 = 50;

/// How regions are told apart in pictures, and which way is which.
const CONVENTIONS: &str =
    "Left and right are the figure's own; in the front view its left is on the right of the picture.";

impl SessionCaller {
    /// Opens a model.
    pub async fn open(&self, arguments: OpenArguments, folder: Option<&AgentFolder>) -> Result<ToolAnswer, Error> {
        let axes = axes_of(&arguments)?;
        let order = arguments.picture.clone().order()?;
        let options = match arguments.options.clone() {
            Some(options) => message_of::<pb::CreateOptions>(options, "options")?,
            None => pb::CreateOptions::default(),
        };
        let (files, held) = self.files_of(arguments, folder)?;
        let options = pliant_wire::session_options(&options, self.manager.ttl_range(&self.tenant)?)?;
        // From here on the session's own reservation has room for them.
        drop(held);
        let session = self.manager.create(&self.tenant, files, options, None).await?.value;
        self.remember(&session.id, |notes| notes.axes = axes)?;
        let mut seen = self.seen(&session.id, Vec::new(), order).await?;
        let warnings: Vec<String> = session
            .warnings
            .iter()
            .take(8)
            .map(|w| format!("{}: {}", w.code, w.message))
            .collect();
        let mut text = format!("Session {} is open.\n{}", session.id, seen.text);
        if !warnings.is_empty() {
            text += &format!("\nWarnings: {}.", warnings.join("; "));
            seen.facts["warnings"] = json!(warnings);
        }
        Ok(ToolAnswer { text, ..seen })
    }

    /// The files that are to be opened, and the memory that holds them until the session does.
    fn files_of(
        &self,
        arguments: OpenArguments,
        folder: Option<&AgentFolder>,
    ) -> Result<(FileSet, Option<MemoryReservation>), Error> {
        let most = self.manager.config().upload_bytes;
        match (arguments.path, arguments.data, arguments.sample) {
            (Some(path), None, None) => {
                let folder = folder.ok_or_else(|| {
                    Error::invalid(
                        "path",
                        "files of this machine are not open to agents here; give data and name",
                    )
                })?;
                Ok((folder.read_model(&path, most)?, None))
            }
            (None, Some(data), None) => {
                let bytes = data.len() as u64 / 4 * 3;
                if bytes > most.saturating_add(3) {
                    let problem = format!("data: is about {bytes} bytes decoded, at most {most} are allowed");
                    return Err(Error::new(ErrorCode::TooLarge, problem));
                }
                let account = self.manager.account(&self.tenant)?;
                account.check_upload(bytes)?;
                let held = self.manager.ledger().reserve_later(MemoryUse::Uploads, Some(&account));
                held.grow_to(bytes)
                    .map_err(|shortage| Error::exhausted(shortage.to_string(), 2))?;
                let decoded = STANDARD.decode(data.as_bytes());
                let decoded = decoded.map_err(|e| Error::invalid("data", format!("is not base64: {e}")))?;
                let name = arguments.name.unwrap_or_else(|| "model".to_owned());
                let name: String = name
                    .rsplit(['/', '\\'])
                    .next()
                    .unwrap_or_default()
                    .chars()
                    .take(255)
                    .collect();
                Ok((FileSet::single(name, Bytes::from(decoded)), Some(held)))
            }
            (None, None, Some(sample)) => {
                let model = BuiltInModel::from_name(&sample).ok_or_else(|| {
                    let (seen, allowed): (String, _) = (sample.chars().take(64).collect(), BuiltInModel::name_list());
                    Error::invalid("sample", format!("\"{seen}\" is not built in; there is {allowed}"))
                })?;
                Ok((FileSet::single(format!("{sample}.glb"), model.glb()), None))
            }
            _ => Err(Error::malformed(
                "one of path, data and sample is needed, and not two of them",
            )),
        }
    }

    /// Draws a session and tells what is there.
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

    async fn seen(&self, session: &str, highlight: Vec<String>, order: PictureOrder) -> Result<ToolAnswer, Error> {
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
            "{} vertices, {} triangles, {} connected parts; its box goes from {} to {}, up is {}, the front is {}, left is {}.\n",
            number("vertices"),
            number("triangles"),
            number("parts"),
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
            return Err(Error::invalid("name", "needs 1 to 120 bytes of letters and digits"));
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

    /// Edits the topology: an operation as HTTP takes it, with `{"words": …}` wherever a region may stand.
    pub async fn edit(&self, arguments: EditArguments) -> Result<ToolAnswer, Error> {
        let EditArguments {
            session,
            operation,
            picture,
        } = arguments;
        let order = picture.order()?;
        let mut operation = Value::Object(operation);
        let mut asked: Vec<(String, String)> = Vec::new();
        words_in(&operation, "operation", &mut asked);
        if asked.len() > MOST_WORDS {
            let problem = format!(
                "has words for {} regions, at most {MOST_WORDS} are allowed",
                asked.len()
            );
            return Err(Error::invalid("operation", problem));
        }
        if !asked.is_empty() {
            let resolved = self
                .see(&session, move |scene| {
                    let each = asked.iter().map(|(field, words)| {
                        let found = scene.resolver.resolve(words, &format!("{field}.words"))?;
                        Ok((words.clone(), found.set.list()))
                    });
                    each.collect::<Result<BTreeMap<String, Vec<u32>>, EngineError>>()
                })
                .await?;
            put_vertices(&mut operation, &resolved);
        }
        let Value::Object(operation) = operation else {
            return Err(Error::malformed("operation: must be an object"));
        };
        let request = pb::EditRequest {
            session_id: String::new(),
            ..message_of::<pb::EditRequest>(operation, "operation")?
        };
        let edit = pliant_wire::session_edit(&request).map_err(|e| super::below(e.into(), "operation"))?;
        let done = self.manager.edit(&self.tenant, &session, edit, None).await?;
        let warnings: Vec<String> = done
            .warnings
            .iter()
            .take(8)
            .map(|w| format!("{}: {}", w.code, w.message))
            .collect();
        let mut report = pliant_wire::json::to_json(&done)?;
        if let Some(report) = report.as_object_mut() {
            // Maps between old vertices and new ones say nothing to an agent, and are long.
            ["kept", "curve", "creases", "ms"]
                .iter()
                .for_each(|name| _ = report.shift_remove(*name));
        }
        let seen = self.seen(&session, Vec::new(), order).await?;
        let mut text = format!("The edit is done (revision {}).", done.revision);
        if done.volume_change != 0.0 {
            text += &format!(" Volume {:+.1} %.", 100.0 * done.volume_change);
        }
        if !warnings.is_empty() {
            text += &format!(" Warnings: {}.", warnings.join("; "));
        }
        text += &format!("\nNow: {}", seen.text);
        Ok(ToolAnswer {
            text,
            facts: json!({"edit": report, "model": seen.facts}),
            pictures: seen.pictures,
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
        let done = if is_undo { "Undone" } else { "Done again" };
        Ok(ToolAnswer {
            text: format!("{done}. {}", seen.text),
            ..seen
        })
    }

    /// Writes the model: to a file of the folder, or into the answer.
    pub async fn export(&self, arguments: ExportArguments, folder: Option<&AgentFolder>) -> Result<ToolAnswer, Error> {
        let named = arguments.format.as_ref().map(|name| ("format", name.clone()));
        let ending = arguments
            .path
            .as_ref()
            .and_then(|path| path.rsplit_once('.'))
            .map(|(_, ending)| ("path", ending.to_owned()));
        let format = match named.or(ending) {
            Some((field, name)) => Some(format_of(field, &name)?),
            None => None,
        };
        if folder.is_some() && arguments.path.is_none() {
            return Err(Error::invalid(
                "path",
                "is needed: where the model is to be written, such as \"out/posed.glb\"",
            ));
        }
        let exported = self.manager.export(&self.tenant, &arguments.session, format).await?;
        let mut warnings: Vec<String> = Vec::new();
        warnings.extend(
            pliant_wire::written_warnings(&exported.written)
                .into_iter()
                .map(|w| format!("{}: {}", w.code, w.message)),
        );
        let bytes = exported.written.main.len();
        let mut facts = json!({"session": arguments.session, "format": exported.format.name(), "bytes": bytes, "warnings": warnings});
        let (mut text, files) = match (folder, &arguments.path) {
            (Some(folder), Some(path)) => {
                let written = folder.write_model(path, &exported.written, arguments.overwrite)?;
                let text = format!("Wrote {} ({bytes} bytes).", written.join(", "));
                facts["files"] = json!(written);
                (text, Vec::new())
            }
            (None, Some(_)) => {
                return Err(Error::invalid(
                    "path",
                    "no files are written here; without it the model is in the answer",
                ));
            }
            (_, None) => {
                let whole = bytes + exported.written.companions.values().map(Vec::len).sum::<usize>();
                let most = self.manager.config().message_bytes;
                if whole as u64 > most / 4 * 3 {
                    let path = format!("/v1/sessions/{}/model", arguments.session);
                    let problem =
                        format!("the model has {whole} bytes, more than an answer of {most} holds; GET {path} has it");
                    return Err(Error::new(ErrorCode::TooLarge, problem));
                }
                let kind = exported.format.media_type();
                let mut files = vec![(format!("model.{}", exported.format.name()), kind, exported.written.main)];
                let companions = exported.written.companions.into_iter();
                files.extend(companions.map(|(name, bytes)| (name, "application/octet-stream", bytes)));
                (format!("The model is in this answer ({bytes} bytes, base64)."), files)
            }
        };
        if !warnings.is_empty() {
            text += &format!(" Warnings: {}.", warnings.join("; "));
        }
        Ok(ToolAnswer {
            text,
            facts,
            files,
            ..ToolAnswer::default()
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

fn axes_of(arguments: &OpenArguments) -> Result<BodyAxes, Error> {
    let read = |name: &Option<String>, field: &str| match name {
        None => Ok(None),
        Some(name) => SignedAxis::named(name).map(Some).ok_or_else(|| {
            let (seen, all): (String, _) = (name.chars().take(16).collect(), SignedAxis::NAMES.join(", "));
            Error::invalid(field, format!("is \"{seen}\"; allowed are {all}"))
        }),
    };
    let up = read(&arguments.up, "up")?.unwrap_or_default();
    let is_creature = arguments.sample.as_deref() == Some(BuiltInModel::Creature.name());
    let usual = match up.direction() == glam::DVec3::Z {
        true => SignedAxis::named("-y"),
        false if is_creature => SignedAxis::named("x"),
        false => SignedAxis::named("z"),
    };
    let front = read(&arguments.front, "front")?.or(usual).unwrap_or_default();
    match up.direction().dot(front.direction()) == 0.0 {
        true => Ok(BodyAxes { up, front }),
        false => Err(Error::invalid(
            "front",
            format!("is {}, the axis of up; another one is needed", front.name()),
        )),
    }
}

fn format_of(field: &str, name: &str) -> Result<Format, Error> {
    let format = Format::from_name(name).ok_or_else(|| {
        let (shown, names): (String, _) = (name.chars().take(64).collect(), Format::name_list("and"));
        Error::invalid(field, format!("\"{shown}\" is not a format; allowed are {names}"))
    })?;
    match format.refusal_to_write() {
        Some(problem) => Err(Error::invalid(field, problem)),
        None => Ok(format),
    }
}

/// The words that stand for regions: objects whose only field is `words`.
fn region_words(value: &Map<String, Value>) -> Option<&str> {
    match value.len() {
        1 => value.get("words")?.as_str(),
        _ => None,
    }
}

fn words_in(value: &Value, path: &str, found: &mut Vec<(String, String)>) {
    match value {
        Value::Object(own) => match region_words(own) {
            Some(words) => found.push((path.to_owned(), words.to_owned())),
            None => own
                .iter()
                .for_each(|(name, inner)| words_in(inner, &format!("{path}.{name}"), found)),
        },
        Value::Array(all) => {
            (all.iter().enumerate()).for_each(|(k, inner)| words_in(inner, &format!("{path}[{k}]"), found))
        }
        _ => {}
    }
}

fn put_vertices(value: &mut Value, resolved: &BTreeMap<String, Vec<u32>>) {
    match value {
        Value::Object(own) => match region_words(own).and_then(|words| resolved.get(words)) {
            Some(list) => *value = json!({"vertices": {"indices": list}}),
            None => own.values_mut().for_each(|inner| put_vertices(inner, resolved)),
        },
        Value::Array(all) => all.iter_mut().for_each(|inner| put_vertices(inner, resolved)),
        _ => {}
    }
}

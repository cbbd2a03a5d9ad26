//! `open` and `export`: models that come in and go out, by path or in the call.

use super::arguments::{ExportArguments, OpenArguments, message_of};
use super::scene::SessionCaller;
use crate::answer::ToolAnswer;
use crate::folder::AgentFolder;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;
use pliant_asset::sample::BuiltInModel;
use pliant_asset::{FileSet, Format};
use pliant_motion::SignedAxis;
use pliant_motion::humanoid::BodyAxes;
use pliant_session::{Error, ErrorCode, MemoryReservation, MemoryUse};
use pliant_wire::pb;
use serde_json::json;

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

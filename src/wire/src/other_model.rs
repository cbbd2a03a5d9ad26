//! The other model that an edit takes: its bytes, a session's, or a file beside a job.

use super::{Error, pb};
use bytes::Bytes;
use pb::edit_request::{Operation, merge, wrap};
use pliant_asset::{FileSet, Format};
use pliant_core::engine::OtherModel;

/// Where an edit takes another model from.
#[derive(Debug, Clone, Copy)]
pub(super) enum OtherSource<'a> {
    Model(&'a Bytes),
    Session(&'a str),
    File(&'a str),
}

impl<'a> OtherSource<'a> {
    /// That of an edit which takes one and names it.
    pub fn of(operation: &'a Operation) -> Option<Self> {
        match operation {
            Operation::Merge(merge) => Self::of_merge(merge),
            Operation::Wrap(wrap) => Self::of_wrap(wrap),
            _ => None,
        }
    }

    pub fn of_merge(merge: &'a pb::edit_request::Merge) -> Option<Self> {
        Some(match merge.source.as_ref()? {
            merge::Source::Model(bytes) => Self::Model(bytes),
            merge::Source::Session(id) => Self::Session(id),
            merge::Source::File(name) => Self::File(name),
        })
    }

    pub fn of_wrap(wrap: &'a pb::edit_request::Wrap) -> Option<Self> {
        Some(match wrap.target.as_ref()? {
            wrap::Target::Model(bytes) => Self::Model(bytes),
            wrap::Target::Session(id) => Self::Session(id),
            wrap::Target::File(name) => Self::File(name),
        })
    }
}

/// Takes the model out of an edit, which then names a session without an id: so a store records it.
pub(super) fn take_other_model(operation: &mut Operation) {
    match operation {
        Operation::Merge(merge) => merge.source = Some(merge::Source::Session(String::new())),
        Operation::Wrap(wrap) => wrap.target = Some(wrap::Target::Session(String::new())),
        _ => {}
    }
}

/// Reads the other model of the edit `place`; `session` is that of the session that it names.
pub(super) fn other_model(
    source: Option<OtherSource<'_>>,
    format: &str,
    place: &str,
    session: Option<&FileSet>,
) -> Result<OtherModel, Error> {
    let files = match (source, session) {
        (None, _) => {
            let problem = "names no other model, allowed is one of model, session or, in a job, file";
            return Err(Error::invalid(place, problem));
        }
        (Some(OtherSource::Model(bytes)), _) => FileSet::single("", bytes.clone()),
        (Some(OtherSource::File(name)), _) => {
            let problem = format!("names \"{name}\", but files are read where a job file is run; give the model");
            return Err(Error::invalid(format!("{place}.file"), problem));
        }
        (Some(OtherSource::Session(_)), Some(files)) => files.clone(),
        (Some(OtherSource::Session(_)), None) => {
            let problem = "can only be named where there are sessions; give the model";
            return Err(Error::invalid(format!("{place}.session"), problem));
        }
    };
    let format = match format {
        "" => None,
        name => Some(Format::from_name(name).ok_or_else(|| {
            let problem = format!("is \"{name}\", allowed are {}", Format::read_name_list("and"));
            Error::invalid(format!("{place}.format"), problem)
        })?),
    };
    Ok(OtherModel {
        files,
        from_session: matches!(source, Some(OtherSource::Session(_))),
        format,
    })
}

//! Calls on a session, read from their requests: a pose to commit, an edit, a page of the list.

use super::edit::edit;
use super::options::DeformOptions;
use super::other_model::{OtherSource, take_other_model};
use super::pb::edit_request::Operation;
use super::poses::pose_changes;
use super::{Error, pb};
use pliant_asset::FileSet;
use pliant_core::engine::{Edit, EditedShape, HandlePose};

/// A pose to be solved and committed. Made by [`pose_commit`].
#[derive(Debug, Clone, PartialEq)]
pub struct PoseCommit {
    /// The number of its frame.
    pub seq: u64,
    /// The handles that move, and where they go.
    pub changes: Vec<(String, HandlePose)>,
    /// How it is solved, and what its frame carries.
    pub options: DeformOptions,
}

/// Reads a pose to commit.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn pose_commit(request: &pb::SolveRequest, max_window: u32) -> Result<PoseCommit, Error> {
    let options = DeformOptions::check(&request.options.unwrap_or_default(), "options", max_window)?;
    let pose = request.pose.as_ref();
    if pose.is_some_and(|p| !p.idempotency_key.is_empty()) {
        let problem = "is for commits on a stream; give this call the header idempotency-key";
        return Err(Error::invalid("pose.idempotencyKey", problem));
    }
    if pose.is_some_and(|p| p.more) {
        let problem = "is for poses on a stream; a call has the whole pose";
        return Err(Error::invalid("pose.more", problem));
    }
    Ok(PoseCommit {
        seq: pose.map_or(0, |p| p.seq),
        changes: pose.map_or_else(|| Ok(Vec::new()), pose_changes)?,
        options,
    })
}

/// An edit of a session's model. Made by [`session_edit`].
#[derive(Debug, Clone)]
pub struct SessionEdit {
    /// The request as a store records it: without the session's id and without the other model.
    pub request: pb::EditRequest,
    /// What is to be done. The files of another session are empty until that session is asked for them.
    pub edit: Edit,
    /// The shape that it works on.
    pub on: EditedShape,
    /// The other session that a merge or a wrap takes its model from.
    pub other_session: Option<String>,
    /// More parts follow of the shape that is adopted.
    pub is_part: bool,
}

impl SessionEdit {
    /// Puts the parts of a shape together: this edit adopts what `part` adds to it too.
    ///
    /// # Errors
    /// [`Error::Invalid`] where the part does not begin where this one ends, or adopts on another shape.
    pub fn join(mut self, part: SessionEdit) -> Result<SessionEdit, Error> {
        part.check_first(self.adopted_vertices())?;
        if part.on != self.on {
            return Err(Error::invalid("on", "is not that of the parts before"));
        }
        if let (Edit::Adopt { positions }, Edit::Adopt { positions: more }) = (&mut self.edit, part.edit) {
            positions.extend(more);
        }
        if let (Some(Operation::Adopt(adopt)), Some(Operation::Adopt(more))) =
            (&mut self.request.operation, part.request.operation)
        {
            adopt.positions = [&adopt.positions[..], &more.positions].concat().into();
            adopt.more = more.more;
        }
        Ok(SessionEdit {
            is_part: part.is_part,
            ..self
        })
    }

    /// Refuses a part of a shape unless `before` vertices are in those before it.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check_first(&self, before: usize) -> Result<(), Error> {
        match &self.request.operation {
            Some(Operation::Adopt(adopt)) if adopt.first as usize != before => {
                let problem = format!(
                    "is {}, but the parts before have {before} vertices; another change of the session drops them, and another shape in parts",
                    adopt.first
                );
                Err(Error::invalid("adopt.first", problem))
            }
            _ => Ok(()),
        }
    }

    /// Whether it adopts a part of a shape that others come before.
    pub fn is_later_part(&self) -> bool {
        matches!(&self.request.operation, Some(Operation::Adopt(adopt)) if adopt.first > 0)
    }

    /// The name of the shape that it adopts a part of.
    pub fn shape_in_parts(&self) -> Option<&str> {
        match &self.request.operation {
            Some(Operation::Adopt(adopt)) => Some(&adopt.shape),
            _ => None,
        }
    }

    /// How many vertices it adopts.
    pub fn adopted_vertices(&self) -> usize {
        match &self.edit {
            Edit::Adopt { positions } => positions.len(),
            _ => 0,
        }
    }
}

/// Reads an edit of a session's model.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn session_edit(request: &pb::EditRequest) -> Result<SessionEdit, Error> {
    let other_session = match request.operation.as_ref().and_then(OtherSource::of) {
        Some(OtherSource::Session(id)) => Some(id.to_owned()),
        _ => None,
    };
    let (edit, on) = edit(request, Some(&FileSet::default()))?;
    let mut request = pb::EditRequest {
        session_id: String::new(),
        ..request.clone()
    };
    request.operation.iter_mut().for_each(take_other_model);
    let is_part = matches!(&request.operation, Some(Operation::Adopt(adopt)) if adopt.more);
    Ok(SessionEdit {
        request,
        edit,
        on,
        other_session,
        is_part,
    })
}

/// A page of a list of sessions. Made by [`session_page`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SessionPage {
    /// The most sessions that it holds.
    pub size: usize,
    /// It begins after the session with this number; sessions are numbered as they are opened.
    pub after: u64,
}

/// Reads which page of the sessions is asked for.
///
/// # Errors
/// [`Error::Invalid`] for a page size or token that is not allowed.
pub fn session_page(request: &pb::ListSessionsRequest) -> Result<SessionPage, Error> {
    let size = match request.page_size {
        0 => 100,
        n @ 1..=1000 => n as usize,
        n => return Err(Error::invalid("pageSize", format!("is {n}, at most 1000 is allowed"))),
    };
    let after = match request.page_token.as_str() {
        "" => 0,
        token => u64::from_str_radix(token, 16)
            .map_err(|_| Error::invalid("pageToken", "is not a token that an earlier page gave"))?,
    };
    Ok(SessionPage { size, after })
}

/// Writes the token of the page that begins after the session with this number.
pub fn page_token(after: u64) -> String {
    format!("{after:x}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use pb::edit_request::{Operation, merge::Source};

    #[test]
    fn a_token_leads_to_the_page_that_it_was_given_for() {
        let page = |page_size, page_token: &str| {
            session_page(&pb::ListSessionsRequest {
                page_size,
                page_token: page_token.into(),
            })
        };
        let expected = SessionPage { size: 2, after: 31 };
        assert_eq!(page(2, &page_token(31)), Ok(expected));
        assert_eq!(page(0, ""), Ok(SessionPage { size: 100, after: 0 }));
        for (size, token, field) in [(1001, "", "pageSize"), (1, "x y", "pageToken")] {
            assert!(matches!(page(size, token), Err(Error::Invalid { field: f, .. }) if f == field));
        }
    }

    #[test]
    fn a_merge_with_a_session_names_it_and_has_no_files_yet() {
        let merge = pb::edit_request::Merge {
            source: Some(Source::Session("other".into())),
            ..Default::default()
        };
        let request = pb::EditRequest {
            operation: Some(Operation::Merge(merge)),
            ..Default::default()
        };
        let read = session_edit(&request).expect("right");
        assert_eq!(read.other_session.as_deref(), Some("other"));
        assert!(
            matches!(read.edit, Edit::Merge(merge) if merge.other.from_session && merge.other.files.main.is_empty())
        );
    }
}

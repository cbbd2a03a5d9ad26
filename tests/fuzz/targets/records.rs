//! What a session's store keeps, as bytes that somebody or a dying disk has changed.

use pliant::wire::record::{LoggedCommit, RecordedModel};

pub fn commits(bytes: &[u8]) {
    let Ok(commit) = LoggedCommit::read(bytes) else { return };
    assert!(!commit.kind().is_empty());
    let written = commit.write();
    let again = LoggedCommit::read(&written).expect("a record that was just written");
    assert_eq!(again.write(), written, "a record changes when it is written again");
}

pub fn models(bytes: &[u8]) {
    let Ok(model) = RecordedModel::read(bytes) else { return };
    let written = model.write();
    let again = RecordedModel::read(&written).expect("a record that was just written");
    assert_eq!(again.write(), written, "a record changes when it is written again");
}

//! The joints below which bones are rigid, as they are named.

use super::error::{Error, InputPlace};
use crate::asset::{BoneLengthRule, Model};

/// How many joints and characters an error lists.
const MOST_SHOWN: usize = 8;
const LONGEST_SHOWN: usize = 64;

/// Refuses a name that no joint of the model has.
///
/// # Errors
/// [`Error::Invalid`] with the name's index, and those of [`Model::joint_names`].
pub(super) fn check_rigid_chains(model: &Model, rule: &BoneLengthRule) -> Result<(), Error> {
    let BoneLengthRule::KeepBelow(names) = rule else {
        return Ok(());
    };
    let joints = model.joint_names()?;
    for (k, name) in names.iter().enumerate() {
        if joints.binary_search(name).is_err() {
            let clip = |name: &String| format!("\"{}\"", name.chars().take(LONGEST_SHOWN).collect::<String>());
            let known: Vec<String> = joints.iter().take(MOST_SHOWN).map(clip).collect();
            let known = match (joints.len(), known.join(", ")) {
                (0, _) => {
                    "the model has no joint with a name; boneLengths KEEP keeps the lengths of all bones".to_owned()
                }
                (all, known) if all > MOST_SHOWN => format!("there are {known} and {} more", all - MOST_SHOWN),
                (_, known) => format!("there are {known}"),
            };
            let problem = format!("no joint is named {}; {known}", clip(name));
            return Err(Error::invalid(InputPlace::RigidChain(k), problem));
        }
    }
    Ok(())
}

//! What else of a file follows when the shape of its model changes.

/// What becomes of morph targets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MorphTargetRule {
    /// Displacements turn and grow with the surface around their vertices.
    #[default]
    Follow,
    /// They stay as they are stored.
    Keep,
}

/// What becomes of skeletons.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RigRule {
    /// Joints move and turn with what they hold; inverse bind matrices and clips are made to fit.
    #[default]
    Follow,
    /// They stay as they are stored.
    Keep,
}

/// What follows the shape of a model into its file. The default is that everything does; formats that hold nothing of the
/// kind are not concerned.
///
/// ```
/// use pliant_core::asset::{Following, MorphTargetRule, RigRule};
/// assert_eq!(Following::default().rig, RigRule::Follow);
/// assert_eq!(Following::default().morph_targets, MorphTargetRule::Follow);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Following {
    /// Morph targets (blend shapes) of glTF.
    pub morph_targets: MorphTargetRule,
    /// The joints of skinned glTF.
    pub rig: RigRule,
}

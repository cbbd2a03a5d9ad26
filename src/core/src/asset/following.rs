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

/// What becomes of the lengths of bones: of the distances between joints and the nearest joints above them, in the rest pose.
///
/// A joint whose bone keeps its length is put in the direction in which it would have gone, seen from the new place of
/// the joint above, and turned as it would have been. Joints with none above are free. Translations of its clips turn
/// with the bone: at every time the bone is as long as before, unless a non-joint node or a stretched parent lies
/// between. Lengths stay within the rounding of 32-bit numbers: a millionth of themselves and of the model's diagonal.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum BoneLengthRule {
    /// They follow the body.
    #[default]
    Follow,
    /// All stay as they are.
    Keep,
    /// Those stay that are below joints of these names, however far below.
    KeepBelow(Vec<String>),
}

/// What follows the shape of a model into its file. The default is that everything does; formats that hold nothing of the
/// kind are not concerned.
///
/// ```
/// use pliant_core::asset::{Following, MorphTargetRule, RigRule};
/// assert_eq!(Following::default().rig, RigRule::Follow);
/// assert_eq!(Following::default().morph_targets, MorphTargetRule::Follow);
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Following {
    /// Morph targets (blend shapes) of glTF.
    pub morph_targets: MorphTargetRule,
    /// The joints of skinned glTF.
    pub rig: RigRule,
    /// The lengths of bones, where joints follow.
    pub bone_lengths: BoneLengthRule,
}

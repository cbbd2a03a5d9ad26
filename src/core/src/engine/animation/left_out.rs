//! What is not solved in a model that has a skin: what no skin places, such as hulls for collisions, props and floors, and coarser
//! levels of detail of what is solved. Rigs are found without it, and clips are solved without it.

use crate::asset::{Model, MovingScene, Primitive};
use crate::engine::error::Error;
use crate::engine::passenger::{Passenger, PassengerKind};

/// What is not solved where a clip moves a model that has a skin: primitives that no skin places, such as hulls for collisions, and
/// those whose names end in `lod1` or a higher number while others do not: coarser copies of what is solved. The model's own clip
/// moves them by their nodes and joints; with any other they ride along with the surface that is solved. Empty for a model without a
/// skin, or one whose skins place nothing.
///
/// # Errors
/// Those of [`Model::moving_scene`].
pub fn left_out_primitives(model: &Model) -> Result<Vec<usize>, Error> {
    let has_skin = |scene: &MovingScene| scene.is_joint.contains(&true) && scene.primitives.iter().any(|p| p.has_skin);
    let Some(scene) = model.moving_scene()?.filter(has_skin) else {
        return Ok(Vec::new());
    };
    let primitives = || scene.primitives.iter().map(|p| p.has_skin).zip(&model.primitives);
    let is_finest = |(has_skin, primitive): (bool, &Primitive)| has_skin && !is_coarser_level(primitive);
    let has_finest = primitives().any(is_finest);
    let left_out = primitives()
        .enumerate()
        .filter(|(_, (has_skin, primitive))| match has_finest {
            true => !is_finest((*has_skin, primitive)),
            false => !has_skin,
        });
    Ok(left_out.map(|(number, _)| number).collect())
}

/// Whether the name says that this is a coarser level of detail: `lod1`, `Body_LOD2`, `hair.lod-1`, but neither `lod0` nor `explod1`.
fn is_coarser_level(primitive: &Primitive) -> bool {
    let name = &primitive.name;
    let before = name.trim_end_matches(|c: char| c.is_ascii_digit());
    let is_coarser = name[before.len()..].bytes().any(|digit| digit != b'0');
    let word = before.strip_suffix(['_', '-', ' ', '.']).unwrap_or(before);
    let start = word.len().checked_sub(3).filter(|start| word.is_char_boundary(*start));
    let begins_a_word = |start: usize| !word[..start].ends_with(|c: char| c.is_alphabetic()) || word.ends_with("LOD");
    is_coarser && start.is_some_and(|start| word[start..].eq_ignore_ascii_case("lod") && begins_a_word(start))
}

/// Those primitives as what rides along when the model is opened.
///
/// # Errors
/// Those of [`Model::moving_scene`].
pub fn left_out_passengers(model: &Model) -> Result<Vec<Passenger>, Error> {
    let passenger = |number: usize| Passenger {
        name: model.primitives[number].name.clone(),
        kind: PassengerKind::Primitive(number as u32),
    };
    Ok(left_out_primitives(model)?.into_iter().map(passenger).collect())
}

/// Which primitives of a model with a skin are left out: one line for each reason, and one for those that are solved all the same,
/// because the session that has the model open does not have them as passengers. The model's own clip moves what is left out, so that
/// nothing is said of it then.
pub(super) fn left_out_warnings(
    model: &Model,
    primitives: &[Primitive],
    is_own_clip: bool,
) -> Result<Vec<String>, Error> {
    let numbers = left_out_primitives(model)?.into_iter();
    let (riding, solved): (Vec<usize>, Vec<usize>) =
        numbers.partition(|number| primitives.get(*number).is_some_and(|p| p.is_passenger));
    let mut lines = match is_own_clip {
        true => Vec::new(),
        false => reasons(model, riding, ["not solved"; 2]),
    };
    let consequences = [
        "solved with the body; a session that has it as a passenger leaves it out",
        "solved with the body; a session that has them as passengers leaves them out",
    ];
    lines.extend(reasons(model, solved, consequences));
    Ok(lines)
}

/// Why primitives are left out, one line for each reason, and what that means for one and for several.
pub(super) fn reasons(model: &Model, numbers: Vec<usize>, consequences: [&str; 2]) -> Vec<String> {
    let (coarser, unskinned): (Vec<usize>, Vec<usize>) = numbers
        .into_iter()
        .partition(|number| is_coarser_level(&model.primitives[*number]));
    let reasons = [
        (unskinned, ["has no skin, and is", "have no skin, and are"]),
        (
            coarser,
            [
                "is a coarser level of detail, and is",
                "are coarser levels of detail, and are",
            ],
        ),
    ];
    let lines = reasons.into_iter().filter(|(numbers, _)| !numbers.is_empty());
    lines
        .map(|(numbers, [of_one, of_many])| {
            let (reason, consequence) = match numbers.len() {
                1 => (of_one, consequences[0]),
                _ => (of_many, consequences[1]),
            };
            format!("{} {reason} {consequence}", primitive_names(model, &numbers))
        })
        .collect()
}

/// The names of some primitives, or their numbers where they have none.
pub(super) fn primitive_names(model: &Model, numbers: &[usize]) -> String {
    const LISTED: usize = 8;
    let name = |number: &usize| match model.primitives.get(*number) {
        Some(primitive) if !primitive.name.is_empty() => format!("\"{}\"", primitive.name),
        _ => format!("primitive {number}"),
    };
    let names: Vec<String> = numbers.iter().take(LISTED).map(name).collect();
    let more = numbers.len() - names.len();
    match more {
        0 => names.join(", "),
        _ => format!("{} and {more} more", names.join(", ")),
    }
}

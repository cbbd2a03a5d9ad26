//! What no skin places, in a model that has one: hulls for collisions, props, floors. Rigs are found without it, and clips are solved
//! without it.

use crate::asset::{Model, MovingScene, Primitive};
use crate::engine::{Passenger, PassengerKind};
use crate::wire::Error;

/// What is not solved where a clip moves a model that has a skin: primitives that no skin places, such as hulls for collisions. The
/// model's own clip moves them by their nodes; with any other they ride along with the surface that is solved. Empty for a model
/// without a skin, or one whose skins place nothing.
///
/// # Errors
/// Those of [`Model::moving_scene`].
pub fn unskinned_primitives(model: &Model) -> Result<Vec<usize>, Error> {
    let has_skin = |scene: &MovingScene| scene.is_joint.contains(&true) && scene.primitives.iter().any(|p| p.has_skin);
    let Some(scene) = model.moving_scene()?.filter(has_skin) else {
        return Ok(Vec::new());
    };
    let primitives = scene.primitives.iter().enumerate();
    Ok(primitives
        .filter(|(_, p)| !p.has_skin)
        .map(|(number, _)| number)
        .collect())
}

/// Those primitives as what rides along when the model is opened.
///
/// # Errors
/// Those of [`Model::moving_scene`].
pub fn unskinned_passengers(model: &Model) -> Result<Vec<Passenger>, Error> {
    let passenger = |number: usize| Passenger {
        name: model.primitives[number].name.clone(),
        kind: PassengerKind::Primitive(number as u32),
    };
    Ok(unskinned_primitives(model)?.into_iter().map(passenger).collect())
}

/// Which primitives of a model with a skin no skin places: one line for those that are solved, because the session that has the model
/// open does not have them as passengers, and one for the others unless the model's own clip moves them.
pub(super) fn unskinned_warnings(
    model: &Model,
    primitives: &[Primitive],
    is_own_clip: bool,
) -> Result<Vec<String>, Error> {
    let numbers = unskinned_primitives(model)?.into_iter();
    let (riding, solved): (Vec<usize>, Vec<usize>) =
        numbers.partition(|number| primitives.get(*number).is_some_and(|p| p.is_passenger));
    let line = |numbers: Vec<usize>, consequence: [&str; 2]| {
        let (verb, end) = match numbers.len() {
            0 => return None,
            1 => ("has", consequence[0]),
            _ => ("have", consequence[1]),
        };
        Some(format!(
            "{} {verb} no skin, and {end}",
            primitive_names(model, &numbers)
        ))
    };
    let lines = [
        line(riding, ["is not solved", "are not solved"]).filter(|_| !is_own_clip),
        line(
            solved,
            [
                "is solved with what has one; a session that has it as a passenger leaves it out",
                "are solved with what has one; a session that has them as passengers leaves them out",
            ],
        ),
    ];
    Ok(lines.into_iter().flatten().collect())
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

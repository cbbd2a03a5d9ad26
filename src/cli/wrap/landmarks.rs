//! Files of landmarks: a list of pairs of places, each a vertex number or a point.

use crate::engine::Error;
use crate::wire::pb::edit_request::wrap::Landmark;
use serde_json::Value;

/// Reads a list of landmarks. What is wrapped is called `own`: the template, or in a transfer the source.
pub(in crate::cli) fn landmarks_from_json(text: &[u8], own: &str) -> Result<Vec<Landmark>, String> {
    let value: Value = serde_json::from_slice(text).map_err(|e| e.to_string())?;
    let Value::Array(list) = value else {
        return Err(format!("a list of {{\"{own}\": PLACE, \"target\": PLACE}} is needed"));
    };
    list.iter()
        .enumerate()
        .map(|(k, one)| landmark(one, own).map_err(|e| format!("[{k}]: {e}")))
        .collect()
}

/// An error about a landmark by the names that files have, where `names` are those of the request and of the file.
pub(in crate::cli) fn in_names_of_file(error: Error, names: [[&str; 2]; 2]) -> Error {
    let Error::Invalid { field, problem } = error else {
        return error;
    };
    let renamed = names.iter().find_map(|[seen, name]| {
        let place = ["Vertex", "Point"].iter();
        let mut ends = place.map(|kind| format!(".{seen}{kind}"));
        let head = ends.find_map(|end| field.strip_suffix(&end))?;
        let at = head.rfind("landmarks[")?;
        Some(format!("{}.{name}", &head[at..]))
    });
    Error::Invalid {
        field: renamed.unwrap_or(field),
        problem,
    }
}

fn landmark(value: &Value, own: &str) -> Result<Landmark, String> {
    let Value::Object(members) = value else {
        return Err(format!("an object with \"{own}\" and \"target\" is needed"));
    };
    let known = ["name", own, "target"];
    if let Some(odd) = members.keys().find(|key| !known.contains(&key.as_str())) {
        return Err(format!("\"{odd}\" is not known; allowed are name, {own} and target"));
    }
    let place = |key: &str| {
        let value = members.get(key).ok_or(format!("\"{key}\" is missing"))?;
        place(value).ok_or(format!(
            "\"{key}\" is {value}; a vertex number, counted from 0, or [x, y, z] is needed"
        ))
    };
    let (own, target) = (place(own)?, place("target")?);
    Ok(Landmark {
        name: members
            .get("name")
            .and_then(Value::as_str)
            .unwrap_or_default()
            .to_owned(),
        own_vertex: own.0,
        own_point: own.1,
        target_vertex: target.0,
        target_point: target.1,
    })
}

fn place(value: &Value) -> Option<(Option<u32>, Vec<f64>)> {
    match value {
        Value::Number(number) => Some((Some(u32::try_from(number.as_u64()?).ok()?), Vec::new())),
        Value::Array(numbers) if numbers.len() == 3 => {
            let point: Option<Vec<f64>> = numbers.iter().map(Value::as_f64).collect();
            Some((None, point?))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_vertices_or_points_and_others_are_refused_by_name() {
        let read = |text: &str| landmarks_from_json(text.as_bytes(), "template");
        let both = read(r#"[{"name": "nose", "template": 12, "target": [0, 1.5, -2]}]"#).expect("right");
        assert_eq!(
            (both[0].own_vertex, &both[0].target_point[..]),
            (Some(12), &[0.0, 1.5, -2.0][..])
        );
        for (text, said) in [
            (r#"{"nose": 1}"#, "a list"),
            (
                r#"[{"template": 1, "target": 2}, {"template": 1}]"#,
                "[1]: \"target\" is missing",
            ),
            (r#"[{"template": -1, "target": 2}]"#, "[0]: \"template\" is -1"),
            (r#"[{"template": 1, "target": [1, 2]}]"#, "[0]: \"target\" is [1,2]"),
            (
                r#"[{"template": 1, "target": 2, "weight": 3}]"#,
                "[0]: \"weight\" is not known",
            ),
        ] {
            assert!(read(text).is_err_and(|e| e.contains(said)), "{text}");
        }
        let of_source = landmarks_from_json(br#"[{"template": 1, "target": 2}]"#, "source");
        assert!(of_source.is_err_and(|e| e.contains("allowed are name, source and target")));
        let wrong = Error::invalid("steps[0].edit.wrap.landmarks[3].ownVertex", "is 9");
        let names = [["own", "template"], ["target", "target"]];
        assert_eq!(
            in_names_of_file(wrong, names),
            Error::invalid("landmarks[3].template", "is 9")
        );
    }
}

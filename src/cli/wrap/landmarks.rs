//! Files of landmarks: a list of pairs of places, each a vertex number or a point.

use crate::wire::pb::edit_request::wrap::Landmark;
use serde_json::Value;

/// Reads a list of landmarks. What is wrapped is the template, or in a transfer the source.
pub(in crate::cli) fn landmarks_from_json(text: &[u8]) -> Result<Vec<Landmark>, String> {
    let value: Value = serde_json::from_slice(text).map_err(|e| e.to_string())?;
    let Value::Array(list) = value else {
        return Err("a list of {\"template\": PLACE, \"target\": PLACE} is needed".into());
    };
    list.iter()
        .enumerate()
        .map(|(k, one)| landmark(one).map_err(|e| format!("[{k}]: {e}")))
        .collect()
}

fn landmark(value: &Value) -> Result<Landmark, String> {
    let Value::Object(members) = value else {
        return Err("an object with \"template\" and \"target\" is needed".into());
    };
    if let Some(odd) = members
        .keys()
        .find(|key| !["name", "template", "source", "target"].contains(&key.as_str()))
    {
        return Err(format!(
            "\"{odd}\" is not known; allowed are name, template (or source) and target"
        ));
    }
    let own = match members.contains_key("source") {
        true => "source",
        false => "template",
    };
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
        let read = |text: &str| landmarks_from_json(text.as_bytes());
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
    }
}

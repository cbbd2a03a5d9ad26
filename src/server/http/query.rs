//! Query parameters: known names only, each once.

use super::problem::{Problem, clip};
use crate::session::Error;
use axum::extract::Query;
use http::Uri;
use percent_encoding::percent_decode_str;
use std::collections::BTreeMap;

/// The parameters of a request, by name.
///
/// # Errors
/// One that is not in `allowed`, or twice, or not readable, with what is allowed. `allowed` names ending in `.` allow
/// everything that begins with them.
pub(super) fn parameters(uri: &Uri, allowed: &[&str]) -> Result<BTreeMap<String, String>, Problem> {
    // What is no UTF-8 would become other text in silence.
    let is_text = |query| percent_decode_str(query).decode_utf8().is_ok();
    if !uri.query().is_none_or(is_text) {
        return Err(Error::malformed("the query is not UTF-8").into());
    }
    let Ok(Query(pairs)) = Query::<Vec<(String, String)>>::try_from_uri(uri) else {
        return Err(Error::malformed("the query is not readable").into());
    };
    let mut parameters = BTreeMap::new();
    for (name, value) in pairs {
        if !allowed
            .iter()
            .any(|a| name == *a || (a.ends_with('.') && name.starts_with(a)))
        {
            let names: Vec<&str> = allowed.iter().copied().filter(|a| !a.ends_with('.')).collect();
            let list = if names.is_empty() {
                "none here".to_owned()
            } else {
                names.join(", ")
            };
            return Err(refuse(&name, &format!("is not a query parameter; allowed are {list}")));
        }
        if parameters.insert(name.clone(), value).is_some() {
            return Err(refuse(&name, "is given twice"));
        }
    }
    Ok(parameters)
}

fn refuse(name: &str, problem: &str) -> Problem {
    let name = clip(name);
    let error = Error {
        field: Some(name.clone()),
        ..Error::malformed(format!("{name}: {problem}"))
    };
    error.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_parameters_are_taken_once() {
        let uri: Uri = "/x?format=glb&label=a%20b".parse().unwrap();
        let found = parameters(&uri, &["format", "label"]).unwrap();
        assert_eq!(found["label"], "a b");
        assert!(parameters(&uri, &["format"]).is_err());
        assert!(parameters(&"/x?format=glb&format=obj".parse().unwrap(), &["format"]).is_err());
        assert!(parameters(&"/x?format=%ff%fe".parse().unwrap(), &["format"]).is_err());
        assert!(parameters(&"/x".parse().unwrap(), &[]).unwrap().is_empty());
    }
}

//! Cases of a suite that are chosen by name.

use crate::check::CASE_SUFFIX;
use crate::cli::failure::CliFailure;
use std::collections::BTreeSet;
use std::path::Path;

/// Most names of a suite that a refusal lists.
const LISTED: usize = 40;

/// Which of the case files are chosen by names, in which `*` stands for any letters; all of them where there are none.
///
/// # Errors
/// A name that no case has, with those that there are.
pub(super) fn choose_cases<'a>(
    suite: &Path,
    files: &'a BTreeSet<String>,
    names: &[String],
) -> Result<BTreeSet<&'a str>, CliFailure> {
    if names.is_empty() {
        return Ok(files.iter().map(String::as_str).collect());
    }
    let mut chosen = BTreeSet::new();
    for name in names {
        let fitting = files.iter().filter(|file| fits(name, case_name(file)));
        let fitting: Vec<&str> = fitting.map(String::as_str).collect();
        if fitting.is_empty() {
            let listed: Vec<&str> = files.iter().take(LISTED).map(|file| case_name(file)).collect();
            let more = match files.len().saturating_sub(LISTED) {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            let there = format!("there are {}{more}", listed.join(", "));
            let problem = format!("no case of the suite {} is named so; {there}", suite.display());
            return Err(CliFailure::Input(format!("--case {name}: {problem}")));
        }
        chosen.extend(fitting);
    }
    Ok(chosen)
}

/// The name of the case in a file.
fn case_name(file: &str) -> &str {
    file.strip_suffix(CASE_SUFFIX).unwrap_or(file)
}

/// Whether a name fits a pattern, in which `*` stands for any letters, none too.
fn fits(pattern: &str, name: &str) -> bool {
    let Some((first, rest)) = pattern.split_once('*') else {
        return pattern == name;
    };
    let Some(mut left) = name.strip_prefix(first) else {
        return false;
    };
    let mut parts: Vec<&str> = rest.split('*').collect();
    let last = parts.pop().unwrap_or_default();
    for part in parts {
        match left.find(part) {
            Some(at) => left = &left[at + part.len()..],
            None => return false,
        }
    }
    left.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::fits;

    #[test]
    fn a_star_stands_for_any_letters() {
        for (pattern, name, wanted) in [
            ("bend", "bend", true),
            ("bend", "bend-2", false),
            ("bend*", "bend", true),
            ("*-2", "bend-2", true),
            ("b*d*2", "bend-2", true),
            ("b*x*2", "bend-2", false),
            ("*", "bend", true),
            ("be*end", "bend", false),
            ("bend*bend", "bend", false),
        ] {
            assert_eq!(fits(pattern, name), wanted, "{pattern} {name}");
        }
    }
}

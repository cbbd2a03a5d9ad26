//! The reports of a suite's shards, joined into the one that a run of the whole suite would have made.

use super::super::shard::split_digest;
use super::{ShardFacts, SuiteReport, printable};
use std::collections::BTreeMap;

/// Most shards that are named where they are missing.
const NAMED: usize = 8;

/// Digest characters that errors show.
const DIGEST: usize = 19;

/// A named report is a report with the name of its file.
type NamedReport = (String, SuiteReport);

/// Joins the reports of all shards of a suite, each given with the name of its file. What comes out says nothing of shards.
///
/// # Errors
/// Why they cannot be joined: reports of no shard, of different suites, splits or builds, and shards that are doubled or missing.
pub fn merge_reports(reports: Vec<NamedReport>) -> Result<SuiteReport, String> {
    let mut shards: BTreeMap<u32, NamedReport> = BTreeMap::new();
    let mut first: Option<(String, SuiteReport, ShardFacts)> = None;
    for (file, report) in reports {
        let Some(facts) = report.shard.clone() else {
            return Err(format!(
                "{file} is the report of a whole suite; --merge joins the reports of shards, which --shard K/N makes"
            ));
        };
        match &first {
            Some((one, a, of_a)) => check_same(one, a, of_a, &file, &report, &facts)?,
            None => first = Some((file.clone(), bare(&report), facts.clone())),
        }
        if let Some((other, _)) = shards.get(&facts.number) {
            return Err(format!("shard {facts} is there twice: {other} and {file}"));
        }
        shards.insert(facts.number, (file, report));
    }
    let Some((_, mut merged, facts)) = first else {
        return Err("there is no report to join".into());
    };
    check_all_there(&shards, &facts)?;
    check_cases(&shards, &facts)?;
    for (_, report) in shards.into_values() {
        for note in report.notes {
            if !merged.notes.contains(&note) {
                merged.notes.push(note);
            }
        }
        merged.cases.extend(report.cases);
    }
    merged.sort_cases();
    Ok(merged)
}

/// The report of a whole suite with the names of this one, and without cases.
fn bare(report: &SuiteReport) -> SuiteReport {
    SuiteReport {
        suite: report.suite.clone(),
        how: report.how.clone(),
        notes: Vec::new(),
        shard: None,
        cases: Vec::new(),
    }
}

/// Refuses a report that does not belong to the first one.
fn check_same(
    one: &str,
    a: &SuiteReport,
    of_a: &ShardFacts,
    other: &str,
    b: &SuiteReport,
    of_b: &ShardFacts,
) -> Result<(), String> {
    let differ = |what: &str, a: String, b: String, needed: &str| {
        let (a, b) = (printable(&a), printable(&b));
        Err(format!("{one} and {other} are of different {what}: {a}, {b}; {needed}"))
    };
    if (&a.suite, &of_a.suite, of_a.cases) != (&b.suite, &of_b.suite, of_b.cases) {
        let describe =
            |r: &SuiteReport, f: &ShardFacts| format!("\"{}\" with {} cases, {}", r.suite, f.cases, clipped(&f.suite));
        let needed = "the same cases, jobs and goldens are needed for all shards";
        return differ("suites", describe(a, of_a), describe(b, of_b), needed);
    }
    if of_a.of != of_b.of {
        let needed = "all shards are needed of one split";
        return differ("numbers of shards", of_a.to_string(), of_b.to_string(), needed);
    }
    if of_a.split != of_b.split {
        let needed = "the same --costs, or none, is needed for all shards";
        return differ("splits", clipped(&of_a.split), clipped(&of_b.split), needed);
    }
    if of_a.build != of_b.build {
        let needed = "one build is needed for all shards, another may differ in bits";
        return differ("builds", of_a.build.clone(), of_b.build.clone(), needed);
    }
    if a.how != b.how {
        let needed = "all shards are run in process, or all on a server";
        return differ("runs", a.how.clone(), b.how.clone(), needed);
    }
    Ok(())
}

/// The start of a digest, enough to distinguish it.
fn clipped(digest: &str) -> String {
    digest.chars().take(DIGEST).collect()
}

/// Refuses a split of which shards are missing.
fn check_all_there(shards: &BTreeMap<u32, NamedReport>, facts: &ShardFacts) -> Result<(), String> {
    let of = facts.of;
    let missing: Vec<String> = (1..=of)
        .filter(|number| !shards.contains_key(number))
        .map(|number| format!("{number}/{of}"))
        .collect();
    if missing.is_empty() {
        return Ok(());
    }
    let named = missing[..missing.len().min(NAMED)].join(", ");
    let more = match missing.len().saturating_sub(NAMED) {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    let (word, verb) = match missing.len() {
        1 => ("shard", "is"),
        _ => ("shards", "are"),
    };
    let there: usize = shards.values().map(|(_, report)| report.cases.len()).sum();
    Err(format!(
        "{word} {named}{more} {verb} missing: {there} of {} cases are there",
        facts.cases
    ))
}

/// Refuses cases that are not those of the split.
fn check_cases(shards: &BTreeMap<u32, NamedReport>, facts: &ShardFacts) -> Result<(), String> {
    let of_shard = |(number, (_, report)): (&u32, &NamedReport)| {
        let names = report.cases.iter().map(|c| c.name.clone());
        names.map(|name| (name, *number)).collect::<Vec<_>>()
    };
    let cases: Vec<(String, u32)> = shards.iter().flat_map(of_shard).collect();
    let named: Vec<(&str, u32)> = cases.iter().map(|(name, number)| (name.as_str(), *number)).collect();
    if cases.len() == facts.cases && split_digest(&named, facts.of) == facts.split {
        return Ok(());
    }
    Err(format!(
        "the reports hold {} cases, which are not the {} cases of the suite as it was split: a report was changed",
        cases.len(),
        facts.cases
    ))
}

#[cfg(test)]
mod tests {
    use super::super::samples;
    use super::*;

    /// The sample suite in shards, its cases dealt out one by one.
    fn dealt(of: u32) -> Vec<NamedReport> {
        let whole = samples::sample_suite();
        let numbers = |k: usize| k as u32 % of + 1;
        let names: Vec<(&str, u32)> = whole
            .cases
            .iter()
            .enumerate()
            .map(|(k, c)| (c.name.as_str(), numbers(k)))
            .collect();
        let split = split_digest(&names, of);
        let report = |number: u32| {
            let mut report = whole.clone();
            let facts = samples::sample_shard(number, of);
            report.shard = Some(ShardFacts {
                split: split.clone(),
                ..facts
            });
            let mut k = 0;
            report.cases.retain(|_| {
                k += 1;
                numbers(k - 1) == number
            });
            (format!("{number}.json"), report)
        };
        (1..=of).map(report).collect()
    }

    fn facts(reports: &mut [NamedReport], k: usize) -> &mut ShardFacts {
        reports[k].1.shard.as_mut().expect("a shard")
    }

    #[test]
    fn shards_in_any_order_make_the_whole() {
        for of in [1, 2, 3, 5, 7] {
            let mut reports = dealt(of);
            reports.reverse();
            assert_eq!(merge_reports(reports), Ok(samples::sample_suite()), "{of}");
        }
    }

    #[test]
    fn cases_come_in_the_order_of_their_files() {
        let mut whole = samples::sample_suite();
        // As files "a-b.case.json" comes before "a.case.json".
        for (case, name) in whole.cases.iter_mut().zip(["a", "a-b", "a.b", "b", "B"]) {
            case.name = name.into();
        }
        whole.sort_cases();
        let names: Vec<&str> = whole.cases.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["B", "a-b", "a.b", "a", "b"]);
    }

    #[test]
    fn what_does_not_belong_together_is_refused() {
        let refused = |change: &dyn Fn(&mut Vec<NamedReport>), words: &[&str]| {
            let mut reports = dealt(3);
            change(&mut reports);
            let reported = merge_reports(reports).expect_err(words[0]);
            assert!(words.iter().all(|w| reported.contains(w)), "{words:?}: {reported}");
        };
        refused(&|r| r.clear(), &["no report"]);
        refused(&|r| r.truncate(1), &["shards 2/3, 3/3 are missing: 2 of 5 cases"]);
        refused(
            &|r| facts(r, 2).suite = "sha256:other".into(),
            &[
                "1.json and 3.json are of different suites",
                "sha256:other",
                "same cases",
            ],
        );
        refused(
            &|r| r[1].1.suite = "another".into(),
            &["different suites", "\"another\" with 5 cases"],
        );
        refused(&|r| facts(r, 1).cases = 6, &["different suites", "6 cases"]);
        refused(&|r| facts(r, 1).of = 4, &["different numbers of shards: 1/3, 2/4"]);
        refused(
            &|r| facts(r, 1).split = "sha256:s".into(),
            &["different splits", "--costs"],
        );
        refused(
            &|r| r[1].1.how = "on a server".into(),
            &["different runs: in process, on a server"],
        );
        refused(
            &|r| drop(r[1].1.cases.pop()),
            &["hold 4 cases", "the 5 cases", "changed"],
        );
        refused(
            &|r| {
                let moved = r[0].1.cases.remove(0);
                r[1].1.cases.push(moved);
            },
            &["changed"],
        );
        let mut many = dealt(5);
        for report in &mut many {
            let facts = report.1.shard.as_mut().expect("a shard");
            (facts.number, facts.of) = (1, 40);
        }
        many.truncate(1);
        let reported = merge_reports(many).expect_err("missing");
        assert!(
            reported.contains("shards 2/40, 3/40") && reported.contains("9/40 and 31 more are missing"),
            "{reported}"
        );
    }
}

//! The report as one page that needs nothing else: no script, no file, no network.

use super::super::metric::MetricKind;
use super::super::verdict::{CaseStatus, MetricDifference};
use super::{CaseReport, SuiteReport, printable, verdict_line};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use quick_xml::escape::escape;
use std::fmt::Write as _;

/// Writes the report as one page.
pub fn html_report(report: &SuiteReport) -> String {
    let mut body = String::new();
    let suite = escape_text(&report.suite);
    let part = report.shard.as_ref().map(|facts| {
        let (shard, here, of) = (facts.shard, report.cases.len(), facts.cases);
        format!(", shard {shard}: {here} of {of} cases")
    });
    let _ = writeln!(
        body,
        "<h1>{suite}</h1>\n<p class=\"soft\">pliant check, {}{}</p>",
        escape_text(&report.how),
        part.unwrap_or_default()
    );
    body += "<p class=\"counts\">";
    for status in [
        CaseStatus::Failed,
        CaseStatus::Passed,
        CaseStatus::Skipped,
        CaseStatus::Blessed,
    ] {
        let count = report.count_cases(status);
        if count > 0 {
            let name = status.name();
            let _ = write!(body, "<span class=\"{name}\">{count} {name}</span>");
        }
    }
    body += "</p>\n<table class=\"cases\">\n<thead><tr><th>case</th><th>result</th><th></th></tr></thead>\n<tbody>\n";
    for case in &report.cases {
        let (name, status) = (escape_text(&case.name), case.verdict.status.name());
        let _ = writeln!(
            body,
            "<tr><td><a href=\"#{name}\">{name}</a></td><td class=\"{status}\">{status}</td><td>{}</td></tr>",
            escape_text(&verdict_line(&case.verdict))
        );
    }
    body += "</tbody>\n</table>\n";
    // What failed is what people came for.
    let (failed, rest): (Vec<_>, Vec<_>) = report
        .cases
        .iter()
        .partition(|c| c.verdict.status == CaseStatus::Failed);
    failed.into_iter().chain(rest).for_each(|c| write_case(&mut body, c));
    html_page(
        &format!("{suite}: {} failed", report.count_cases(CaseStatus::Failed)),
        &body,
    )
}

fn write_case(body: &mut String, case: &CaseReport) {
    let (name, status) = (escape_text(&case.name), case.verdict.status.name());
    let _ = write!(
        body,
        "<section id=\"{name}\" class=\"{status}\">\n<header><h2>{name}</h2><span class=\"word {status}\">{status}</span></header>\n"
    );
    if !case.title.is_empty() {
        let _ = writeln!(body, "<p>{}</p>", escape_text(&case.title));
    }
    let verdict = &case.verdict;
    if verdict.reasons.is_empty() {
        let _ = writeln!(body, "<p>{}</p>", escape_text(&verdict_line(verdict)));
    } else {
        *body += "<ul class=\"reasons\">\n";
        for r in &verdict.reasons {
            let _ = writeln!(body, "<li><code>{}</code> {}</li>", r.code, escape_text(&r.text));
        }
        *body += "</ul>\n";
    }
    for note in &case.notes {
        let _ = writeln!(body, "<p class=\"soft\">{}</p>", escape_text(note));
    }
    if !case.pictures.is_empty() {
        *body += "<div class=\"pictures\">\n";
        for plate in &case.pictures {
            let _ = writeln!(
                body,
                "<figure><img width=\"{}\" height=\"{}\" alt=\"{}: {}\" src=\"data:image/png;base64,{}\"><figcaption><b>{}</b>, {}</figcaption></figure>",
                plate.size[0],
                plate.size[1],
                plate.caption,
                escape_text(&plate.description),
                STANDARD.encode(&plate.png),
                plate.caption,
                escape_text(&plate.description)
            );
        }
        *body += "</div>\n";
    }
    write_facts(body, case);
    *body += "</section>\n";
}

/// Writes the numbers and digests, open where something is wrong.
fn write_facts(body: &mut String, case: &CaseReport) {
    let open = if case.verdict.status == CaseStatus::Failed {
        " open"
    } else {
        ""
    };
    let _ = writeln!(body, "<details{open}><summary>numbers</summary>");
    let _ = writeln!(
        body,
        "<p class=\"soft\">model <code>{}</code></p>",
        escape_text(&case.model)
    );
    for (what, digest) in [("digest", &case.digest), ("stored digest", &case.stored_digest)] {
        if !digest.is_empty() {
            let _ = writeln!(
                body,
                "<p class=\"soft\">{what} <code>{}</code></p>",
                escape_text(digest)
            );
        }
    }
    if !case.verdict.measures.is_empty() {
        *body += "<table>\n<thead><tr><th>metric</th><th>unit</th><th>difference</th><th>allowed</th><th>stored</th><th>now</th><th>where, why allowed</th></tr></thead>\n<tbody>\n";
        case.verdict.measures.iter().for_each(|m| write_difference(body, m));
        *body += "</tbody>\n</table>\n<p class=\"soft\">The unit diagonal is the length of the diagonal of the stored shape's bounding box; coordinates are in model units.</p>\n";
    }
    *body += "</details>\n";
}

fn write_difference(body: &mut String, m: &MetricDifference) {
    let number = |x: Option<f64>| x.map_or(m.absent_word().into(), |x| m.metric.format_value(x));
    let (stored, now) = match m.metric.kind() {
        MetricKind::Shape => (String::new(), String::new()),
        _ => (number(m.stored), number(m.value)),
    };
    let words: Vec<&str> = [m.place.as_str(), m.reason.as_str()]
        .into_iter()
        .filter(|t| !t.is_empty())
        .collect();
    let _ = writeln!(
        body,
        "<tr{}><td>{}</td><td>{}</td><td class=\"number\">{}</td><td class=\"number\">{}</td><td class=\"number\">{stored}</td><td class=\"number\">{now}</td><td>{}</td></tr>",
        if m.is_within_bound() { "" } else { " class=\"over\"" },
        m.metric.name(),
        m.metric.unit().name(),
        number(m.difference),
        m.metric.format_value(m.allowed),
        escape_text(&words.join("; "))
    );
}

/// Escapes a text so that it is nothing but text, in an element or an attribute.
fn escape_text(text: &str) -> String {
    escape(printable(text).as_str()).into_owned()
}

/// All of the page's style. It names no other file.
pub(super) const STYLE: &str = "
:root { color-scheme: light dark; --ink: #1d2430; --soft: #5a6472; --ground: #ffffff; --card: #f5f6f8; --line: #d7dce2;
  --passed: #1a7f37; --failed: #c02626; --skipped: #8a6100; --blessed: #3557c9; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ee; --soft: #9aa4b2; --ground: #14171c; --card: #1d2127; --line: #333a44;
  --passed: #4cc46a; --failed: #ff7b72; --skipped: #e0b04c; --blessed: #8ea8ff; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 82rem; padding: 1.5rem 1.25rem 4rem; background: var(--ground); color: var(--ink);
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.5rem; margin: 0 0 .25rem; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 0; overflow-wrap: anywhere; }
p { margin: .25rem 0; overflow-wrap: anywhere; }
a { color: inherit; }
.soft { color: var(--soft); }
.counts { display: flex; flex-wrap: wrap; gap: .5rem 1.5rem; margin: .75rem 0 1.5rem; font-weight: 600; }
.passed { color: var(--passed); } .failed { color: var(--failed); } .skipped { color: var(--skipped); }
.blessed { color: var(--blessed); }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .3rem .75rem .3rem 0; border-bottom: 1px solid var(--line); vertical-align: top;
  overflow-wrap: anywhere; }
th { color: var(--soft); font-weight: 500; }
td.number, .cases td:nth-child(-n+2), .cases th { white-space: nowrap; }
section { border: 1px solid var(--line); border-left: 4px solid currentColor; border-radius: 6px; margin: 1.25rem 0;
  padding: 1rem 1.25rem; }
section > * { color: var(--ink); }
section > header { display: flex; flex-wrap: wrap; gap: .25rem .75rem; align-items: baseline; margin-bottom: .5rem; }
.word { font-weight: 700; text-transform: uppercase; font-size: .8rem; letter-spacing: .05em; }
ul.reasons { margin: .5rem 0; padding-left: 1.2rem; }
code { font: .92em ui-monospace, monospace; background: var(--card); padding: .05em .35em; border-radius: 4px;
  overflow-wrap: anywhere; }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(21rem, 100%), 1fr)); gap: 1rem; margin: 1rem 0; }
figure { margin: 0; background: var(--card); border: 1px solid var(--line); border-radius: 6px; overflow: hidden; }
figure img { display: block; width: 100%; height: auto; }
figcaption { padding: .4rem .7rem; font-size: .85rem; color: var(--soft); }
figcaption b { color: var(--ink); }
details { margin-top: .5rem; } summary { cursor: pointer; color: var(--soft); }
tr.over td { color: var(--failed); font-weight: 600; }
@media print { details > * { display: block; } section { break-inside: avoid; } }
";

/// The page around `body`, both already escaped.
pub(super) fn html_page(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::super::samples;

    #[test]
    fn the_page_is_whole_and_texts_stay_texts() {
        let page = super::html_report(&samples::sample_suite());
        assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
        assert!(
            !page.contains("<script") && !page.contains("<i>") && !page.contains("<note>") && !page.contains("<b> &")
        );
        assert!(page.contains("&lt;script&gt;") && page.contains("data:image/png;base64,AQID"));
        assert!(
            !page.contains("http://") && !page.contains("https://"),
            "it names no other file"
        );
        assert!(page.contains("prefers-color-scheme: dark"));
        assert!(
            page.contains("<td>maxDisplacement</td><td>diagonal</td>"),
            "each number has its unit"
        );
        let mut part = samples::sample_suite();
        part.shard = Some(samples::sample_shard(2, 3));
        let part = super::html_report(&part);
        assert!(part.contains("pliant check, in process, shard 2/3: 5 of 5 cases</p>"));
        assert!(page.contains("pliant check, in process</p>"));
        // Failed cases come first, then the others in their order.
        let at = |name: &str| page.find(&format!("<section id=\"{name}\"")).expect(name);
        assert!(at("d-failed") < at("e-broken") && at("e-broken") < at("a-passed") && at("a-passed") < at("c-skipped"));
        for tag in ["section", "table", "figure", "details", "ul", "tr"] {
            let count = |text: &str| page.matches(text).count();
            let opened = count(&format!("<{tag}>")) + count(&format!("<{tag} "));
            assert_eq!(opened, count(&format!("</{tag}>")), "{tag}");
        }
    }
}

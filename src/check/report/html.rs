//! The report as one page that needs nothing else: no script, no file, no network.

use super::super::metric::MetricKind;
use super::super::named::Named as _;
use super::super::verdict::{CaseStatus, MetricDifference};
use super::{CaseReport, SuiteReport, printable, verdict_line};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use quick_xml::escape::escape;
use std::fmt::Write as _;

/// The page around what is written here, with places for the title, the style and the body.
const PAGE: &str = include_str!("report.html");
/// All of the page's style. It names no other file.
const STYLE: &str = include_str!("report.css");

/// Writes the report as one page.
pub fn html_report(report: &SuiteReport) -> String {
    let mut body = String::new();
    let suite = escape_text(&report.suite);
    let part = report.shard.as_ref().map(|facts| {
        let (here, of) = (report.cases.len(), facts.cases);
        format!(", shard {facts}: {here} of {of} cases")
    });
    let _ = writeln!(
        body,
        "<h1>{suite}</h1>\n<p class=\"soft\">pliant check, {}{}</p>",
        escape_text(&report.how),
        part.unwrap_or_default()
    );
    body += "<p class=\"counts\">";
    let mut counts = report.counts();
    counts.sort_by_key(|(_, name)| *name != CaseStatus::Failed.name());
    for (count, name) in counts {
        let _ = write!(body, "<span class=\"{name}\">{count} {name}</span>");
    }
    body += "</p>\n<table class=\"cases\">\n<thead><tr><th>case</th><th>result</th><th></th></tr></thead>\n<tbody>\n";
    for case in &report.cases {
        let (name, status) = (escape_text(&case.name), case.status.name());
        let _ = writeln!(
            body,
            "<tr><td><a href=\"#{name}\">{name}</a></td><td class=\"{status}\">{status}</td><td>{}</td></tr>",
            escape_text(&verdict_line(case))
        );
    }
    body += "</tbody>\n</table>\n";
    // What failed is what people came for.
    let (failed, rest): (Vec<_>, Vec<_>) = (report.cases.iter()).partition(|c| c.status == CaseStatus::Failed);
    failed.into_iter().chain(rest).for_each(|c| write_case(&mut body, c));
    let title = format!("{suite}: {} failed", report.count_cases(CaseStatus::Failed));
    // From the last place to the first: what is filled in may contain the names of places itself.
    let page = PAGE.replacen("{body}", &body, 1).replacen("{style}", STYLE, 1);
    page.replacen("{title}", &title, 1)
}

fn write_case(body: &mut String, case: &CaseReport) {
    let (name, status) = (escape_text(&case.name), case.status.name());
    let _ = write!(
        body,
        "<section id=\"{name}\" class=\"{status}\">\n<header><h2>{name}</h2><span class=\"word {status}\">{status}</span></header>\n"
    );
    if !case.title.is_empty() {
        let _ = writeln!(body, "<p>{}</p>", escape_text(&case.title));
    }
    if case.reasons.is_empty() {
        let _ = writeln!(body, "<p>{}</p>", escape_text(&verdict_line(case)));
    } else {
        *body += "<ul class=\"reasons\">\n";
        for r in &case.reasons {
            let _ = writeln!(body, "<li><code>{}</code> {}</li>", r.code.name(), escape_text(&r.text));
        }
        *body += "</ul>\n";
    }
    for note in &case.notes {
        let _ = writeln!(body, "<p class=\"soft\">{}</p>", escape_text(note));
    }
    if !case.pictures.is_empty() {
        *body += "<div class=\"pictures\">\n";
        for picture in &case.pictures {
            let ([width, height], caption) = (picture.size, picture.caption.name());
            let (description, data) = (escape_text(&picture.description), STANDARD.encode(&picture.png));
            let _ = writeln!(
                body,
                "<figure><img width=\"{width}\" height=\"{height}\" alt=\"{caption}: {description}\" \
                 src=\"data:image/png;base64,{data}\"><figcaption><b>{caption}</b>, {description}</figcaption></figure>"
            );
        }
        *body += "</div>\n";
    }
    write_facts(body, case);
    *body += "</section>\n";
}

/// Writes the numbers and digests, open where something is wrong.
fn write_facts(body: &mut String, case: &CaseReport) {
    let open = if case.status == CaseStatus::Failed { " open" } else { "" };
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
    if !case.measures.is_empty() {
        *body += "<table>\n<thead><tr><th>metric</th><th>unit</th><th>difference</th><th>allowed</th><th>stored</th><th>now</th><th>where, why allowed</th></tr></thead>\n<tbody>\n";
        case.measures.iter().for_each(|m| write_difference(body, m));
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
        if m.holds { "" } else { " class=\"over\"" },
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

//! The report as JUnit XML, which CI systems read: a test case for each case, a property for each metric.

use super::super::metric::format_exact;
use super::super::named::Named as _;
use super::super::verdict::{CaseStatus, ReasonCode, VerdictReason};
use super::{CaseReport, SuiteReport, printable};
use quick_xml::events::{BytesDecl, BytesText, Event};
use quick_xml::writer::Writer;
use std::io;

type XmlWriter = Writer<Vec<u8>>;

/// Writes the document, in UTF-8.
///
/// # Errors
/// In words; never for texts in memory.
pub fn junit_report(report: &SuiteReport) -> Result<Vec<u8>, String> {
    let mut xml = Writer::new_with_indent(Vec::new(), b' ', 2);
    write_report(report, &mut xml).map_err(|e| e.to_string())?;
    let mut bytes = xml.into_inner();
    bytes.push(b'\n');
    Ok(bytes)
}

fn write_report(report: &SuiteReport, xml: &mut XmlWriter) -> io::Result<()> {
    xml.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    let broken = report.cases.iter().filter(|c| is_error(c)).count();
    let counts = [
        ("tests", report.cases.len()),
        ("failures", report.count_cases(CaseStatus::Failed) - broken),
        ("errors", broken),
        ("skipped", report.count_cases(CaseStatus::Skipped)),
    ];
    let mut counts: Vec<(&str, String)> = counts.map(|(name, n)| (name, n.to_string())).into();
    if let Some(took) = report.cases.iter().filter_map(|c| c.milliseconds).reduce(|a, b| a + b) {
        counts.push(("time", seconds(took)));
    }
    let counts = || counts.iter().map(|(name, n)| (*name, n.as_str()));
    let suite = printable(&report.suite);
    let all = xml.create_element("testsuites").with_attributes(counts());
    all.write_inner_content(|xml| {
        let element = xml.create_element("testsuite").with_attribute(("name", suite.as_str()));
        element.with_attributes(counts()).write_inner_content(|xml| {
            let mut facts = vec![("how".to_owned(), printable(&report.how))];
            facts.extend(report.shard.as_ref().map(|f| ("shard".to_owned(), f.to_string())));
            write_properties(xml, &facts)?;
            report.cases.iter().try_for_each(|c| write_case(xml, &suite, c))
        })?;
        Ok(())
    })?;
    Ok(())
}

/// Writes a time as the format has it.
fn seconds(milliseconds: f64) -> String {
    format!("{:.6}", milliseconds / 1000.0)
}

/// Whether a case failed because it could not be run.
fn is_error(case: &CaseReport) -> bool {
    case.status == CaseStatus::Failed && case.reasons.first().is_some_and(|r| r.code == ReasonCode::NotRun)
}

fn write_case(xml: &mut XmlWriter, suite: &str, case: &CaseReport) -> io::Result<()> {
    let class = format!("pliant.check.{suite}");
    let element = xml.create_element("testcase");
    let mut element = element.with_attributes([("classname", class.as_str()), ("name", case.name.as_str())]);
    let took = case.milliseconds.map(seconds);
    if let Some(took) = &took {
        element = element.with_attribute(("time", took.as_str()));
    }
    element.write_inner_content(|xml| {
        write_properties(xml, &case_properties(case))?;
        let reasons = &case.reasons;
        let Some(first) = reasons.first() else { return Ok(()) };
        let name = match case.status {
            CaseStatus::Failed if is_error(case) => "error",
            CaseStatus::Failed => "failure",
            CaseStatus::Skipped => "skipped",
            CaseStatus::Passed | CaseStatus::Blessed => return Ok(()),
        };
        let message = printable(&first.text);
        let element = xml.create_element(name).with_attribute(("message", message.as_str()));
        if name == "skipped" {
            element.write_empty()?;
            return Ok(());
        }
        let describe = |r: &VerdictReason| format!("{}: {}", r.code.name(), printable(&r.text));
        let text: Vec<String> = reasons.iter().map(describe).collect();
        let element = element.with_attribute(("type", first.code.name()));
        element.write_text_content(BytesText::new(&text.join("\n")))?;
        Ok(())
    })?;
    Ok(())
}

/// What is known of a case: for each metric the difference from the golden, which is what is compared and not the
/// metric's own value, and what is allowed where that is not 0.
fn case_properties(case: &CaseReport) -> Vec<(String, String)> {
    let mut facts = vec![
        ("title".to_owned(), printable(&case.title)),
        ("model".to_owned(), printable(&case.model)),
        ("digest".to_owned(), printable(&case.digest)),
        ("storedDigest".to_owned(), printable(&case.stored_digest)),
    ];
    facts.retain(|(_, text)| !text.is_empty());
    for m in &case.measures {
        let name = m.metric.name();
        let Some(difference) = m.difference else {
            facts.push((name.into(), m.absent_word().into()));
            continue;
        };
        facts.push((name.into(), format_exact(difference)));
        if m.allowed > 0.0 {
            facts.push((format!("{name}.allowed"), format_exact(m.allowed)));
            facts.push((format!("{name}.reason"), printable(&m.reason)));
        }
    }
    facts
}

fn write_properties(xml: &mut XmlWriter, facts: &[(String, String)]) -> io::Result<()> {
    if facts.is_empty() {
        return Ok(());
    }
    xml.create_element("properties").write_inner_content(|xml| {
        facts.iter().try_for_each(|(name, value)| {
            let element = xml.create_element("property");
            element
                .with_attributes([("name", name.as_str()), ("value", value.as_str())])
                .write_empty()?;
            Ok(())
        })
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::samples;
    use quick_xml::events::Event;
    use quick_xml::reader::Reader;

    #[test]
    fn the_document_is_well_formed_and_escaped() {
        let bytes = super::junit_report(&samples::sample_suite()).expect("written");
        let text = String::from_utf8(bytes).expect("UTF-8");
        let mut reader = Reader::from_str(&text);
        reader.config_mut().check_end_names = true;
        let (mut elements, mut depth) = (Vec::new(), 0);
        loop {
            match reader.read_event().expect("well-formed") {
                Event::Eof => break,
                Event::Start(e) => {
                    depth += 1;
                    elements.push(e.name().as_ref().to_owned());
                    assert!(e.attributes().all(|a| a.is_ok()));
                }
                Event::Empty(e) => {
                    elements.push(e.name().as_ref().to_owned());
                    assert!(e.attributes().all(|a| a.is_ok()));
                }
                Event::End(_) => depth -= 1,
                _ => {}
            }
        }
        assert_eq!(depth, 0);
        let count = |name: &str| elements.iter().filter(|e| *e == name).count();
        assert_eq!(
            (count("testcase"), count("failure"), count("error"), count("skipped")),
            (5, 1, 1, 1)
        );
        assert!(
            !text.contains("<script>") && !text.contains('\u{1}') && !text.contains("]]>"),
            "{text}"
        );
        assert!(text.contains("su&lt;i&gt;te"));
        assert!(!text.contains("time=") && !text.contains("name=\"shard\""));
        assert!(
            text.contains(r#"tests="5" failures="1" errors="1" skipped="1""#),
            "{text}"
        );
        assert!(
            text.contains(r#"<property name="flippedTriangles" value="2"/>"#),
            "{text}"
        );
        assert!(
            text.contains(r#"name="maxDisplacement.allowed" value="0.000001""#),
            "{text}"
        );
    }

    #[test]
    fn times_and_the_shard_are_reported_where_they_are_known() {
        let mut report = samples::sample_suite();
        report.cases[0].milliseconds = Some(1500.0);
        report.cases[1].milliseconds = Some(0.25);
        report.shard = Some(samples::sample_shard(2, 3));
        let text = String::from_utf8(super::junit_report(&report).expect("written")).expect("UTF-8");
        assert!(
            text.contains(r#"skipped="1" time="1.500250""#)
                && text.contains(r#"name="a-passed" time="1.500000""#)
                && text.contains(r#"name="c-skipped">"#)
                && text.contains(r#"<property name="shard" value="2/3"/>"#),
            "{text}"
        );
    }
}

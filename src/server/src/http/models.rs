//! The model in its current shape, and its vertex buffer, for download: with entity tags, conditional requests and ranges (RFC 9110
//! sections 8.8.3, 13 and 14).

use super::problem::{Problem, clip};
use super::request::{SessionCall, parameters};
use crate::messages::parse_format_name;
use axum::body::Body;
use axum::response::Response;
use bytes::Bytes;
use glam::DVec3;
use http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};
use pliant_asset::FollowedCounts;
use pliant_session::{Error, ExportedModel};
use xxhash_rust::xxh3::xxh3_64;

/// The header that counts what followed the shape of an exported model.
const FOLLOWED: HeaderName = HeaderName::from_static("x-pliant-followed");

/// The header that says what positions of a buffer are relative to: x, y, z with blanks between them.
pub(super) const ORIGIN: HeaderName = HeaderName::from_static("x-pliant-origin");

/// The value of [`ORIGIN`]; `None` where nothing has to be added.
pub(super) fn origin_value(origin: DVec3) -> Option<HeaderValue> {
    let told = HeaderValue::from_str(&format!("{} {} {}", origin.x, origin.y, origin.z)).ok();
    told.filter(|_| origin != DVec3::ZERO)
}

/// `GET …/model`. A glTF file with external buffers is the main file with a `Link` header for every companion; with
/// `?uri=` it is that companion.
pub(super) async fn model(call: SessionCall, uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    call.check_session().await?;
    let tenant = &call.caller.tenant;
    let mut found = parameters(&uri, &["format", "uri"])?;
    let named = found.remove("format");
    let format = named
        .as_ref()
        .map(|name| parse_format_name("format", name))
        .transpose()?;
    let wanted = found.remove("uri").filter(|uri| !uri.is_empty());
    if wanted.is_none() && headers.contains_key(header::IF_NONE_MATCH) {
        let etag = call.manager.export_etag(tenant, &call.id, format).await?;
        if let Some(response) = unchanged(&etag, &headers) {
            return Ok(response);
        }
    }
    let exported = call.manager.export(tenant, &call.id, format).await?;
    match wanted {
        None => main_file(&call.id, named.as_deref(), exported, &headers),
        Some(uri) => companion(exported, &uri, &headers),
    }
}

/// The main file of an export. `named`: what the caller calls its format.
pub(super) fn main_file(
    id: &str,
    named: Option<&str>,
    exported: ExportedModel,
    headers: &HeaderMap,
) -> Result<Response, Problem> {
    let ExportedModel { written, format, etag } = exported;
    let file_name = format!("{id}.{}", named.unwrap_or(format.name()).to_ascii_lowercase());
    let warnings = pliant_wire::written_warnings(&written).into_iter();
    let warnings: Vec<String> = warnings.map(|w| format!("{}: {}", w.code, w.message)).collect();
    let download = Download {
        bytes: Bytes::from(written.main),
        media_type: format.media_type(),
        etag,
        file_name,
    };
    let mut response = download.respond(headers)?;
    if let Some(text) = followed_text(&written.followed)
        && let Ok(value) = HeaderValue::from_str(&text)
    {
        response.headers_mut().insert(FOLLOWED, value);
    }
    add_warnings(response.headers_mut(), warnings.iter().map(String::as_str));
    for uri in written.companions.keys() {
        let target = utf8_percent_encode(uri, NON_ALPHANUMERIC);
        if let Ok(link) = HeaderValue::from_str(&format!(
            "</v1/sessions/{id}/model?format={format}&uri={target}>; rel=\"item\""
        )) {
            response.headers_mut().append(header::LINK, link);
        }
    }
    Ok(response)
}

/// Adds a header for each warning.
pub(super) fn add_warnings<'a>(headers: &mut HeaderMap, warnings: impl Iterator<Item = &'a str>) {
    let plain = |c: char| if c.is_ascii_graphic() || c == ' ' { c } else { '?' };
    for warning in warnings {
        let line: String = clip(warning).replace('…', "...").chars().map(plain).collect();
        if let Ok(value) = HeaderValue::from_str(&line) {
            headers.append(HeaderName::from_static("x-pliant-warning"), value);
        }
    }
}

/// What followed the shape, in numbers; `None` where the file holds nothing of the kind.
fn followed_text(counts: &FollowedCounts) -> Option<String> {
    (!counts.is_none()).then(|| {
        format!(
            "joints={}/{}, clips={}/{}, morph-targets={}/{}, passengers={}/{}, passenger-nodes={}/{}",
            counts.moved_joints,
            counts.joints,
            counts.rewritten_clips,
            counts.clips,
            counts.carried_morph_targets,
            counts.morph_targets,
            counts.moved_passengers,
            counts.passengers,
            counts.moved_passenger_nodes,
            counts.passenger_nodes
        )
    })
}

fn companion(exported: ExportedModel, uri: &str, headers: &HeaderMap) -> Result<Response, Problem> {
    let ExportedModel {
        mut written,
        format,
        etag,
    } = exported;
    let Some(bytes) = written.companions.remove(uri) else {
        let known: Vec<&str> = written.companions.keys().map(String::as_str).collect();
        let list = if known.is_empty() {
            format!("this {format} file has none")
        } else {
            format!("there are {}", clip(&known.join(", ")))
        };
        return Err(Error::invalid("uri", format!("\"{}\" names no companion file; {list}", clip(uri))).into());
    };
    let etag = format!("\"{}-{:016x}\"", etag.trim_matches('"'), xxh3_64(uri.as_bytes()));
    let file_name = uri.rsplit('/').next().unwrap_or(uri).to_owned();
    Download {
        bytes: Bytes::from(bytes),
        media_type: "application/octet-stream",
        etag,
        file_name,
    }
    .respond(headers)
}

/// `GET …/positions`: little-endian x, y, z per render vertex, relative to the header `x-pliant-origin` where it is there.
pub(super) async fn positions(call: SessionCall, uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    call.check_session().await?;
    let tenant = &call.caller.tenant;
    parameters(&uri, &[])?;
    let positions = call.manager.positions(tenant, &call.id).await?;
    let file_name = format!("{}.f32", call.id);
    let download = Download {
        bytes: positions.bytes,
        media_type: "application/octet-stream",
        etag: positions.etag,
        file_name,
    };
    let mut response = download.respond(&headers)?;
    let origin = origin_value(positions.origin).map(|value| (ORIGIN, value));
    response.headers_mut().extend(origin);
    Ok(response)
}

/// Something to download.
pub(super) struct Download {
    /// The whole of it.
    pub bytes: Bytes,
    /// Its media type.
    pub media_type: &'static str,
    /// Strong entity tag, with or without its quotes.
    pub etag: String,
    /// Name under which a browser saves it.
    pub file_name: String,
}

/// Which bytes to send.
#[derive(Debug, PartialEq, Eq)]
enum Span {
    Whole,
    Part { first: u64, last: u64 },
    Unsatisfiable,
}

impl Download {
    /// Answers a GET with these headers: 304 for a tag that the client holds, 206 for a range, 416 for one past the end.
    pub fn respond(self, request: &HeaderMap) -> Result<Response<Body>, Problem> {
        let etag = quoted(&self.etag);
        let tag = HeaderValue::from_str(&etag).map_err(|_| Problem::internal("entity tag"))?;
        if let Some(response) = unchanged(&etag, request) {
            return Ok(response);
        }

        let total = self.bytes.len() as u64;
        let unchanged = request
            .get(header::IF_RANGE)
            .is_none_or(|v| v.as_bytes() == etag.as_bytes());
        let span = match request.get(header::RANGE).and_then(|v| v.to_str().ok()) {
            Some(range) if unchanged => span(range, total),
            _ => Span::Whole,
        };
        let (status, body) = match span {
            Span::Whole => (StatusCode::OK, self.bytes),
            Span::Part { first, last } => (
                StatusCode::PARTIAL_CONTENT,
                self.bytes.slice(first as usize..=last as usize),
            ),
            Span::Unsatisfiable => {
                return Err(Problem::new(
                    StatusCode::RANGE_NOT_SATISFIABLE,
                    "OUT_OF_RANGE",
                    format!("the range lies outside of the {total} bytes that there are"),
                )
                .with_header(header::CONTENT_RANGE, format!("bytes */{total}")));
            }
        };
        let mut response = Response::new(Body::from(body));
        *response.status_mut() = status;
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(self.media_type));
        headers.insert(header::ETAG, tag);
        headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
        // A session's shape changes; a cache may keep it but must ask.
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
        if let Ok(disposition) = HeaderValue::from_str(&disposition(&self.file_name)) {
            headers.insert(header::CONTENT_DISPOSITION, disposition);
        }
        if let Span::Part { first, last } = span
            && let Ok(range) = HeaderValue::from_str(&format!("bytes {first}-{last}/{total}"))
        {
            headers.insert(header::CONTENT_RANGE, range);
        }
        Ok(response)
    }
}

/// The answer 304, when the client holds what `etag` stands for.
pub(super) fn unchanged(etag: &str, request: &HeaderMap) -> Option<Response<Body>> {
    let etag = quoted(etag);
    let known = request.get(header::IF_NONE_MATCH)?.to_str().ok()?;
    if !matches_tag(known, &etag) {
        return None;
    }
    let mut response = Response::new(Body::empty());
    *response.status_mut() = StatusCode::NOT_MODIFIED;
    response
        .headers_mut()
        .insert(header::ETAG, HeaderValue::from_str(&etag).ok()?);
    Some(response)
}

fn quoted(tag: &str) -> String {
    if tag.starts_with('"') {
        tag.to_owned()
    } else {
        format!("\"{tag}\"")
    }
}

/// `If-None-Match` compares weakly: a `W/` mark makes no difference.
fn matches_tag(known: &str, etag: &str) -> bool {
    known
        .split(',')
        .map(|t| t.trim())
        .any(|t| t == "*" || t.strip_prefix("W/").unwrap_or(t) == etag)
}

fn disposition(name: &str) -> String {
    let plain: String = name
        .chars()
        .map(|c| {
            if c.is_ascii_graphic() && c != '"' && c != '\\' {
                c
            } else {
                '_'
            }
        })
        .collect();
    format!("attachment; filename=\"{plain}\"")
}

/// Reads a `Range` header. It ignores all but a single byte range, as the standard allows.
fn span(range: &str, total: u64) -> Span {
    let Some(spec) = range.strip_prefix("bytes=").map(str::trim).filter(|s| !s.contains(',')) else {
        return Span::Whole;
    };
    let Some((first, last)) = spec.split_once('-') else {
        return Span::Whole;
    };
    match (first.trim(), last.trim()) {
        ("", suffix) => match suffix.parse::<u64>() {
            Ok(0) => Span::Unsatisfiable,
            Ok(_) if total == 0 => Span::Unsatisfiable,
            Ok(count) => Span::Part {
                first: total.saturating_sub(count),
                last: total - 1,
            },
            Err(_) => Span::Whole,
        },
        (first, last) => {
            let Ok(first) = first.parse::<u64>() else {
                return Span::Whole;
            };
            let last = match last {
                "" => u64::MAX,
                text => match text.parse::<u64>() {
                    Ok(last) if last >= first => last,
                    _ => return Span::Whole,
                },
            };
            if first >= total {
                Span::Unsatisfiable
            } else {
                Span::Part {
                    first,
                    last: last.min(total - 1),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_as_the_standard_says() {
        assert_eq!(span("bytes=0-9", 100), Span::Part { first: 0, last: 9 });
        assert_eq!(span("bytes=90-", 100), Span::Part { first: 90, last: 99 });
        assert_eq!(span("bytes=90-200", 100), Span::Part { first: 90, last: 99 });
        assert_eq!(span("bytes=-10", 100), Span::Part { first: 90, last: 99 });
        assert_eq!(span("bytes=-1000", 100), Span::Part { first: 0, last: 99 });
        assert_eq!(span("bytes=100-", 100), Span::Unsatisfiable);
        assert_eq!(span("bytes=-0", 100), Span::Unsatisfiable);
        assert_eq!(span("bytes=-1", 0), Span::Unsatisfiable);
    }

    #[test]
    fn what_is_no_range_is_ignored() {
        for range in [
            "bytes=9-0",
            "bytes=a-b",
            "items=0-9",
            "bytes=0-1,4-5",
            "bytes=",
            "bytes=18446744073709551616-",
        ] {
            assert_eq!(span(range, 100), Span::Whole, "{range}");
        }
    }

    #[test]
    fn tags_match_in_lists_and_weakly() {
        assert!(matches_tag("\"a\", W/\"b\"", "\"b\""));
        assert!(matches_tag("*", "\"b\""));
        assert!(!matches_tag("\"a\"", "\"b\""));
    }

    #[test]
    fn a_file_name_cannot_break_out_of_its_quotes() {
        assert_eq!(disposition("a\"b\r\nc.glb"), "attachment; filename=\"a_b__c.glb\"");
    }

    #[test]
    fn long_warnings_stay_plain_in_their_header() {
        let mut headers = HeaderMap::new();
        add_warnings(&mut headers, ["é".repeat(200).as_str()].into_iter());
        let value = headers["x-pliant-warning"].to_str().expect("plain characters");
        assert_eq!(value, format!("{}...", "?".repeat(100)));
    }
}

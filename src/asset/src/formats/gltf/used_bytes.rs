//! Which bytes of the buffers are used by what, and how those go that no view needs any more.

use super::document::GltfDocument;
use super::schema::{MESHOPT, WholeNumber};
use super::text::{JsonEdits, parse_index, value_of};
use serde::de::{DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use std::collections::BTreeSet;
use std::fmt;
use std::ops::Range;

/// Bytes that something uses.
#[derive(Debug, Clone, Copy)]
struct ByteSpan {
    start: u64,
    end: u64,
    /// Elements at a stride, for an accessor; everything between, for all else.
    elements: Option<StridedElements>,
}

#[derive(Debug, Clone, Copy)]
struct StridedElements {
    accessor: usize,
    stride: u64,
    size: u64,
}

impl ByteSpan {
    /// All of so many bytes.
    fn whole(start: u64, length: u64) -> Self {
        Self {
            start,
            end: start + length,
            elements: None,
        }
    }

    /// Whether two uses have a byte in common; `self` is an accessor's.
    fn overlaps(&self, other: &Self) -> bool {
        if self.end <= other.start || other.end <= self.start {
            return false;
        }
        let (Some(a), Some(b)) = (self.elements, other.elements) else {
            return true;
        };
        if a.stride != b.stride {
            return true;
        }
        // Interleaved: the other's elements must lie in the gaps.
        let lag = (i128::from(other.start) - i128::from(self.start)).rem_euclid(i128::from(a.stride.max(1)));
        lag < i128::from(a.size) || lag + i128::from(b.size) > i128::from(a.stride)
    }
}

/// All uses of every buffer, by where they start.
pub(super) struct ByteSpans {
    /// Per buffer: uses, and the furthest end among a use and all before it.
    buffers: Vec<Vec<(ByteSpan, u64)>>,
    own: Vec<Option<(usize, ByteSpan)>>,
}

impl ByteSpans {
    /// Finds who uses which bytes: accessors, and views that anything else names.
    pub(super) fn collect(doc: &GltfDocument<'_>) -> Self {
        let mut buffers: Vec<Vec<(ByteSpan, u64)>> = vec![Vec::new(); doc.buffers.len()];
        let mut own = Vec::with_capacity(doc.accessors.len());
        let mut read_by_accessors = BTreeSet::new();
        let mut read_otherwise = views_named_elsewhere(doc);
        for (i, accessor) in doc.accessors.values.iter().enumerate() {
            if let Some(sparse) = &accessor.sparse {
                read_otherwise.extend([sparse.indices.buffer_view.index(), sparse.values.buffer_view.index()]);
            }
            let mut span = None;
            if let Some(index) = accessor.buffer_view
                && let Some(view) = doc.views.get(index.index())
            {
                match doc.layout(i) {
                    Some(layout) => {
                        read_by_accessors.insert(index.index());
                        let start = view.offset() + accessor.offset();
                        let last = accessor.count.0.saturating_sub(1) * layout.stride;
                        let elements = StridedElements {
                            accessor: i,
                            stride: layout.stride,
                            size: layout.element,
                        };
                        let found = ByteSpan {
                            start,
                            end: start + last + layout.element,
                            elements: Some(elements),
                        };
                        span = view.compression().is_none().then_some((view.buffer.index(), found));
                    }
                    None => drop(read_otherwise.insert(index.index())),
                }
            }
            if let Some((buffer, span)) = span {
                buffers[buffer].push((span, 0));
            }
            own.push(span);
        }
        for (i, view) in doc.views.values.iter().enumerate() {
            // A view that nothing seems to use belongs to something we do not know.
            if read_otherwise.contains(&i) || !read_by_accessors.contains(&i) {
                let span = ByteSpan::whole(view.offset(), view.byte_length.0);
                buffers[view.buffer.index()].push((span, 0));
            }
            if let Some(c) = view.compression() {
                let span = ByteSpan::whole(c.offset(), c.byte_length.0);
                buffers[c.buffer.index()].push((span, 0));
            }
        }
        for spans in &mut buffers {
            spans.sort_by_key(|(span, _)| (span.start, span.end));
            let mut furthest = 0;
            for (span, reach) in spans {
                furthest = furthest.max(span.end);
                *reach = furthest;
            }
        }
        Self { buffers, own }
    }

    /// Whether nothing but this accessor uses its bytes.
    pub(super) fn is_alone(&self, accessor: usize) -> bool {
        let Some(Some((buffer, own))) = self.own.get(accessor) else {
            return false;
        };
        let spans = &self.buffers[*buffer];
        let after = spans.partition_point(|(span, _)| span.start < own.end);
        // Backwards until nothing earlier reaches this far.
        spans[..after]
            .iter()
            .rev()
            .take_while(|(_, reach)| *reach > own.start)
            .all(|(span, _)| {
                let is_self = span.elements.is_some_and(|e| e.accessor == accessor);
                is_self || !own.overlaps(span)
            })
    }
}

impl ByteSpans {
    /// Whether nothing but this accessor's sparse values uses their bytes.
    pub(super) fn is_sparse_alone(&self, doc: &GltfDocument<'_>, accessor: usize) -> bool {
        let Some(sparse) = &doc.accessors.values[accessor].sparse else {
            return false;
        };
        let values = sparse.values.buffer_view;
        let names = |named: Option<WholeNumber>| usize::from(named == Some(values));
        let uses = doc.accessors.values.iter().map(|a| {
            let of_sparse = a.sparse.as_ref();
            names(a.buffer_view)
                + names(of_sparse.map(|s| s.indices.buffer_view))
                + names(of_sparse.map(|s| s.values.buffer_view))
        });
        let Some(view) = doc.views.get(values.index()).filter(|_| uses.sum::<usize>() == 1) else {
            return false;
        };
        let (start, end) = (view.offset(), view.offset() + view.byte_length.0);
        let others = self.buffers[view.buffer.index()].iter();
        others.filter(|(span, _)| span.start < end && start < span.end).count() == 1
    }
}

/// Views that are named outside the accessors: by images, by compressed primitives, by extensions that we do not know.
fn views_named_elsewhere(doc: &GltfDocument<'_>) -> BTreeSet<usize> {
    const KEY: &str = "\"bufferView\"";
    let accessors = doc.array(&doc.accessors).map_or(0..0, |part| {
        let start = part.as_ptr() as usize - doc.text.as_ptr() as usize;
        start..start + part.len()
    });
    doc.text
        .match_indices(KEY)
        .filter(|(at, _)| !accessors.contains(at))
        .filter_map(|(at, _)| {
            let value = doc.text[at + KEY.len()..].trim_start().strip_prefix(':')?.trim_start();
            let end = value.find([',', '}', ']', ' ', '\n', '\r', '\t'])?;
            parse_index(&value[..end])
        })
        .collect()
}

/// Places that stay multiples of this stay aligned for every type of number that a view may hold.
const ALIGNMENT: usize = 8;

/// How often a document names each buffer view, unknown extensions included; `None` when that cannot be determined.
pub(super) fn count_view_uses(doc: &GltfDocument<'_>) -> Option<Vec<usize>> {
    let mut uses = vec![0; doc.views.len()];
    let counter = ViewUseCounter {
        uses: &mut uses,
        names_views: false,
        in_metadata: false,
    };
    counter
        .deserialize(&mut serde_json::Deserializer::from_str(doc.text))
        .ok()?;
    Some(uses)
}

/// Walks a value and counts the numbers that name views.
struct ViewUseCounter<'c> {
    uses: &'c mut [usize],
    /// Whether a number here is that of a view.
    names_views: bool,
    /// Metadata extensions name views by keys of many names: all numbers in them count.
    in_metadata: bool,
}

impl ViewUseCounter<'_> {
    fn count_use(&mut self, view: usize) {
        if let Some(uses) = self.uses.get_mut(view).filter(|_| self.names_views) {
            *uses += 1;
        }
    }
}

impl<'de> DeserializeSeed<'de> for ViewUseCounter<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for ViewUseCounter<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("any value")
    }

    fn visit_unit<E>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_bool<E>(self, _: bool) -> Result<(), E> {
        Ok(())
    }

    fn visit_str<E>(self, _: &str) -> Result<(), E> {
        Ok(())
    }

    fn visit_i64<E>(self, _: i64) -> Result<(), E> {
        Ok(())
    }

    fn visit_u64<E>(mut self, value: u64) -> Result<(), E> {
        self.count_use(usize::try_from(value).unwrap_or(usize::MAX));
        Ok(())
    }

    fn visit_f64<E>(mut self, value: f64) -> Result<(), E> {
        if value >= 0.0 && value.fract() == 0.0 {
            self.count_use(value as usize);
        }
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        loop {
            let item = ViewUseCounter {
                uses: &mut *self.uses,
                names_views: self.names_views,
                in_metadata: self.in_metadata,
            };
            if list.next_element_seed(item)?.is_none() {
                return Ok(());
            }
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<String>()? {
            let in_metadata = self.in_metadata || key.contains("_metadata");
            map.next_value_seed(ViewUseCounter {
                uses: &mut *self.uses,
                names_views: in_metadata || key == "bufferView",
                in_metadata,
            })?;
        }
        Ok(())
    }
}

/// What is cut out of one buffer.
pub(super) struct BufferCuts {
    buffer: usize,
    /// For each view whether nothing uses it.
    is_unused: Vec<bool>,
    /// In order, apart from each other, each a whole number of alignments long.
    ranges: Vec<Range<usize>>,
    /// For each range how many bytes are gone up to its end.
    gone: Vec<u64>,
}

impl BufferCuts {
    /// Finds what only unused views have of a buffer.
    pub(super) fn new(doc: &GltfDocument<'_>, buffer: usize, unused: &[usize]) -> Self {
        let mut is_unused = vec![false; doc.views.len()];
        unused.iter().for_each(|&v| is_unused[v] = true);
        let range = |offset: u64, length: u64| {
            let start = usize::try_from(offset).unwrap_or(usize::MAX);
            start..start.saturating_add(usize::try_from(length).unwrap_or(usize::MAX))
        };
        let (mut dropped, mut kept) = (Vec::new(), Vec::new());
        for (view, is_unused) in doc.views.values.iter().zip(&is_unused) {
            let own = range(view.offset(), view.byte_length.0);
            if view.buffer.index() == buffer {
                if *is_unused { &mut dropped } else { &mut kept }.push(own);
            }
            if let Some(inner) = view.compression().filter(|c| c.buffer.index() == buffer) {
                kept.push(range(inner.offset(), inner.byte_length.0));
            }
        }
        dropped.sort_by_key(|r| (r.start, r.end));
        kept.sort_by_key(|r| (r.start, r.end));
        // The farthest end of a kept view and all before it.
        let mut farthest = 0;
        kept.iter_mut().for_each(|r| {
            farthest = farthest.max(r.end);
            r.end = farthest;
        });
        let mut ranges: Vec<Range<usize>> = Vec::new();
        for own in dropped {
            let before = kept.partition_point(|k| k.start < own.end);
            let is_shared = before > 0 && kept[before - 1].end > own.start;
            let last = ranges.last().map_or(0, |r| r.end);
            let whole = own.len() / ALIGNMENT * ALIGNMENT;
            if !is_shared && own.start >= last && whole > 0 {
                ranges.push(own.start..own.start + whole);
            }
        }
        let mut total = 0;
        let add = |r: &Range<usize>| {
            total += r.len() as u64;
            total
        };
        Self {
            buffer,
            is_unused,
            gone: ranges.iter().map(add).collect(),
            ranges,
        }
    }

    /// The bytes that stay.
    pub(super) fn kept_bytes(&self, bytes: &[u8]) -> Vec<u8> {
        let mut kept = Vec::with_capacity(bytes.len());
        let mut next = 0;
        for range in &self.ranges {
            kept.extend_from_slice(bytes.get(next..range.start).unwrap_or_default());
            next = range.end;
        }
        kept.extend_from_slice(bytes.get(next..).unwrap_or_default());
        kept
    }

    /// Lets the views that are used say where their bytes are now.
    pub(super) fn move_views<'a>(&self, doc: &GltfDocument<'a>, edits: &mut JsonEdits<'a>) {
        for (v, view) in doc.views.values.iter().enumerate() {
            let item = doc.item(&doc.views, v);
            if view.buffer.index() == self.buffer && !self.is_unused[v] {
                self.move_offset(item, view.offset(), edits);
            }
            if let Some(inner) = view.compression().filter(|c| c.buffer.index() == self.buffer) {
                let extensions = value_of(item, "extensions").unwrap_or("{}");
                for text in MESHOPT.iter().filter_map(|name| value_of(extensions, name)) {
                    self.move_offset(text, inner.offset(), edits);
                }
            }
        }
    }

    fn move_offset<'a>(&self, object: &'a str, offset: u64, edits: &mut JsonEdits<'a>) {
        let before = self.ranges.partition_point(|r| r.end as u64 <= offset);
        if before > 0 {
            edits.set(object, "byteOffset", offset - self.gone[before - 1]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::document::{GLTF_FORMAT, ParsedDocument};
    use super::*;
    use crate::files::ReadWatch;
    use crate::{FileSet, Limits};
    use pliant_exec::progress::Silent;

    const JSON: &str = concat!(
        r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":64,"uri":"b.bin"},{"byteLength":64,"uri":"c.bin"}],"#,
        r#""bufferViews":[{"buffer":0,"byteLength":8},{"buffer":0,"byteOffset":8,"byteLength":19},"#,
        r#"{"buffer":0,"byteOffset":28,"byteLength":4},{"buffer":0,"byteOffset":32,"byteLength":16},"#,
        r#"{"buffer":0,"byteOffset":40,"byteLength":4},{"buffer":1,"byteOffset":40,"byteLength":4},"#,
        r#"{"buffer":1,"byteLength":8,"extensions":{"EXT_meshopt_compression":{"buffer":0,"byteOffset":56,"#,
        r#""byteLength":8,"byteStride":4,"count":2,"mode":"ATTRIBUTES"}}},"#,
        r#"{"buffer":0,"byteOffset":48,"byteLength":8}],"#,
        r#""accessors":[{"bufferView":4.0,"componentType":5126,"count":1,"type":"SCALAR"}],"#,
        r#""images":[{"bufferView":2,"mimeType":"image/png"},{"bufferView":2,"mimeType":"image/png"}],"#,
        r#""extensions":{"EXT_structural_metadata":{"values":3},"X_other":{"list":[{"bufferView":5}],"values":1}}}"#
    );

    fn parse_unchecked(files: &FileSet) -> ParsedDocument {
        let limits = Limits::default();
        let watch = ReadWatch::new(&limits, &Silent, 0);
        ParsedDocument::parse(files, GLTF_FORMAT, &watch).expect("a document")
    }

    #[test]
    fn uses_are_counted_wherever_a_view_is_named() {
        let files = FileSet::single("a.gltf", JSON);
        let parsed = parse_unchecked(&files);
        let doc = parsed.of(&files).expect("a document");
        assert_eq!(count_view_uses(&doc), Some(vec![0, 0, 2, 1, 1, 1, 0, 0]));
    }

    #[test]
    fn bytes_that_others_have_too_stay_and_views_behind_follow() {
        let files = FileSet::single("a.gltf", JSON);
        let parsed = parse_unchecked(&files);
        let doc = parsed.of(&files).expect("a document");
        let bytes: Vec<u8> = (0..64).collect();
        // View 3 has bytes of view 4; of view 1 whole alignments go, so that those behind stay aligned.
        let cuts = BufferCuts::new(&doc, 0, &[1, 3, 7]);
        let kept = cuts.kept_bytes(&bytes);
        assert_eq!(kept, [&bytes[..8], &bytes[24..48], &bytes[56..]].concat());
        let mut edits = JsonEdits::new(doc.text);
        cuts.move_views(&doc, &mut edits);
        let moved: serde_json::Value = serde_json::from_str(&edits.apply()).expect("JSON");
        let offset = |object: &serde_json::Value| object["byteOffset"].as_u64().unwrap_or(0) as usize;
        let views = &moved["bufferViews"];
        let inner = &views[6]["extensions"]["EXT_meshopt_compression"];
        let found = [&views[0], &views[2], &views[4], inner].map(|object| kept[offset(object)]);
        assert_eq!(found, [0, 28, 40, 56]);
        assert_eq!((offset(&views[5]), offset(&views[6])), (40, 0), "another buffer stays");
    }
}

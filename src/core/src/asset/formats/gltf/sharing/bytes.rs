//! Which bytes of the buffers are used by whom.

use super::super::accessors::AccessorLayout;
use super::super::document::GltfDocument;
use super::super::schema::WholeNumber;
use super::super::text::parse_index;
use std::collections::BTreeSet;

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
pub(in super::super) struct ByteSpans {
    /// Per buffer: uses, and the furthest end among a use and all before it.
    buffers: Vec<Vec<(ByteSpan, u64)>>,
    own: Vec<Option<(usize, ByteSpan)>>,
}

impl ByteSpans {
    /// Finds who uses which bytes: accessors, and views that anything else names.
    pub(in super::super) fn collect(doc: &GltfDocument<'_>) -> Self {
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
                match AccessorLayout::of(accessor, doc.views.values) {
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
            // A view that nobody seems to use belongs to something we do not know.
            if read_otherwise.contains(&i) || !read_by_accessors.contains(&i) {
                let (start, end) = (view.offset(), view.offset() + view.byte_length.0);
                buffers[view.buffer.index()].push((
                    ByteSpan {
                        start,
                        end,
                        elements: None,
                    },
                    0,
                ));
            }
            if let Some(c) = view.compression() {
                let (start, end) = (c.offset(), c.offset() + c.byte_length.0);
                buffers[c.buffer.index()].push((
                    ByteSpan {
                        start,
                        end,
                        elements: None,
                    },
                    0,
                ));
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
    pub(in super::super) fn is_alone(&self, accessor: usize) -> bool {
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
    let accessors = doc.accessors.text.map_or(0..0, |part| {
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

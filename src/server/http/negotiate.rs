//! Which of the offered media types a client prefers (RFC 9110 section 12.5.1).

/// The index in `offers` of the type that `accept` likes best; the first offer for an empty or absent header, `None` when
/// nothing offered is acceptable. Among equals the more specific range wins, then the order of `accept`.
pub(super) fn choose(accept: Option<&str>, offers: &[&str]) -> Option<usize> {
    let accept = accept.map(str::trim).filter(|a| !a.is_empty());
    let Some(accept) = accept else {
        return (!offers.is_empty()).then_some(0);
    };
    let mut best: Option<(f32, u8, usize, usize)> = None;
    for (position, range) in accept.split(',').enumerate() {
        let mut parameters = range.split(';').map(str::trim);
        let range = parameters.next().unwrap_or_default();
        let quality = parameters
            .find_map(|p| p.strip_prefix("q="))
            .map_or(1.0, |q| q.parse::<f32>().unwrap_or(0.0));
        if quality.is_nan() || quality <= 0.0 {
            continue;
        }
        for (index, offer) in offers.iter().enumerate() {
            let Some(specific) = specificity(range, offer) else {
                continue;
            };
            let better = best.is_none_or(|(q, s, p, i)| {
                (quality, specific, std::cmp::Reverse(position), std::cmp::Reverse(index))
                    .partial_cmp(&(q, s, std::cmp::Reverse(p), std::cmp::Reverse(i)))
                    .is_some_and(|o| o.is_gt())
            });
            if better {
                best = Some((quality, specific, position, index));
            }
        }
    }
    best.map(|(_, _, _, index)| index)
}

fn specificity(range: &str, offer: &str) -> Option<u8> {
    if range == "*/*" {
        return Some(0);
    }
    if let Some(group) = range.strip_suffix("/*") {
        return offer
            .split('/')
            .next()
            .is_some_and(|g| g.eq_ignore_ascii_case(group))
            .then_some(1);
    }
    range.eq_ignore_ascii_case(offer).then_some(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFFERS: [&str; 3] = ["application/json", "application/octet-stream", "model/gltf-binary"];

    #[test]
    fn the_first_offer_is_the_default() {
        assert_eq!(choose(None, &OFFERS), Some(0));
        assert_eq!(choose(Some("*/*"), &OFFERS), Some(0));
        assert_eq!(choose(Some("  "), &OFFERS), Some(0));
    }

    #[test]
    fn quality_then_precision_then_order_decide() {
        assert_eq!(choose(Some("application/octet-stream"), &OFFERS), Some(1));
        assert_eq!(
            choose(Some("application/json;q=0.5, model/gltf-binary"), &OFFERS),
            Some(2)
        );
        assert_eq!(choose(Some("*/*, model/gltf-binary"), &OFFERS), Some(2));
        assert_eq!(choose(Some("model/*"), &OFFERS), Some(2));
        assert_eq!(
            choose(Some("Application/JSON, application/octet-stream"), &OFFERS),
            Some(0)
        );
    }

    #[test]
    fn what_is_not_offered_or_refused_is_not_chosen() {
        assert_eq!(choose(Some("image/png"), &OFFERS), None);
        assert_eq!(choose(Some("application/json;q=0"), &OFFERS), None);
    }
}

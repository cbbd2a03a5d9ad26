//! How a session is built: its options, checked.

use super::check::{enumerated, number};
use super::{Error, pb};
use crate::asset::Format;
use crate::deform::{BodyOptions, CoarseOperators, EdgeWeights, FreePartPolicy, VolumeMode};
use crate::graph::VolumeOptions;
use crate::mesh::Weld;

/// Options of a session, checked.
#[derive(Debug, Clone)]
pub(crate) struct OpenOptions {
    pub format: Option<Format>,
    pub weld: Weld,
    pub policy: FreePartPolicy,
    pub body: BodyOptions,
}

impl OpenOptions {
    /// Checks the options of a session; fields are named as in JSON.
    pub fn check(create: &pb::CreateOptions) -> Result<Self, Error> {
        let format = match create.format.as_str() {
            "" => None,
            name => Some(Format::from_name(name).ok_or_else(|| {
                Error::invalid(
                    "format",
                    format!("is \"{name}\", allowed are {}", Format::name_list("and")),
                )
            })?),
        };
        let length = |value: f64, field: &str| match number(value, field)? {
            v if v < 0.0 => Err(Error::invalid(field, format!("is {v}, it must not be negative"))),
            0.0 => Ok(None),
            v => Ok(Some(v)),
        };
        let weld = match &create.weld {
            Some(weld) => length(weld.tolerance, "weld.tolerance")?.map_or(Weld::Exact, Weld::Tolerance),
            None => Weld::Exact,
        };
        let policy = match enumerated(create.components, "components")? {
            pb::create_options::Components::Follow => FreePartPolicy::Follow,
            pb::create_options::Components::Hold => FreePartPolicy::Hold,
            pb::create_options::Components::Free => FreePartPolicy::Free,
        };
        let weights = match enumerated(create.weights, "weights")? {
            pb::create_options::Weights::Uniform => EdgeWeights::Uniform,
            pb::create_options::Weights::Cotangent => EdgeWeights::Cotangent,
        };
        let operators = match enumerated(create.operators, "operators")? {
            pb::create_options::Operators::FiniteVolume => CoarseOperators::FiniteVolume,
            pb::create_options::Operators::Paper => CoarseOperators::Paper,
        };
        let volume = create.volume_graph.unwrap_or_default();
        let mode = match enumerated(volume.mode, "volumeGraph.mode")? {
            pb::create_options::volume_graph::Mode::Auto => VolumeMode::Auto,
            pb::create_options::volume_graph::Mode::Off => VolumeMode::Off,
            pb::create_options::volume_graph::Mode::Required => VolumeMode::Required,
        };
        let valence = match volume.valence {
            0 | 14 => 14,
            8 => 8,
            other => {
                return Err(Error::invalid(
                    "volumeGraph.valence",
                    format!("is {other}, allowed are 14 and 8, or 0 for 14"),
                ));
            }
        };
        let graph = VolumeOptions {
            interval: length(volume.interval, "volumeGraph.interval")?,
            valence,
            shell_offset: length(volume.shell_offset, "volumeGraph.shellOffset")?,
            weights,
            ..Default::default()
        };
        Ok(Self {
            format,
            weld,
            policy,
            body: BodyOptions {
                volume: mode,
                graph,
                operators,
                apart: false,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_operators_can_be_chosen() {
        use pb::create_options::Operators as Wanted;
        for (wanted, chosen) in [
            (Wanted::FiniteVolume, CoarseOperators::FiniteVolume),
            (Wanted::Paper, CoarseOperators::Paper),
        ] {
            let create = pb::CreateOptions {
                operators: wanted.into(),
                ..Default::default()
            };
            let choices = OpenOptions::check(&create).ok();
            assert_eq!(choices.map(|c| c.body.operators), Some(chosen));
        }
        let unknown = pb::CreateOptions {
            operators: 7,
            ..Default::default()
        };
        assert!(OpenOptions::check(&unknown).is_err());
    }
}

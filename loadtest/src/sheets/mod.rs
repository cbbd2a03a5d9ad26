//! Pictures for people: what deforming does to many models, and the figures of the paper.

pub(crate) mod contact_sheet;
pub(crate) mod paper_figures;

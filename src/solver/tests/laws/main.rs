//! Laws that the solver keeps on any graph: equations hold, constants and bounds survive, columns and threads are
//! independent, hard cases end with a result or say why not.

mod case;
mod constraints;
mod contract;
mod edits;
mod equations;
mod graphs;
mod hard;
mod paper;
mod repair;
mod starts;

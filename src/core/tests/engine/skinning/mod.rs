//! Laws of skins: of the decomposition of an animation, and of weights for the bones of a rig.

mod decomposition;
mod joined;
mod weights;

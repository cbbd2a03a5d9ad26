//! Which build and processor made a result. Within one, the same inputs give the same bits; another may differ in late digits.

/// The sources of what computes and the compiler, as a digest, and the processor.
pub fn build_identity() -> String {
    format!("{}-{}", env!("COMPUTING_SOURCES"), std::env::consts::ARCH)
}

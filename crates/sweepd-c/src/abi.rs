//! The version of the ABI, for the library and for `build.rs`.

/// It changes with a function's parameters or meaning, and so does `SWEEPD_ABI_VERSION` of `sweepd.h`.
pub const VERSION: u32 = 1;

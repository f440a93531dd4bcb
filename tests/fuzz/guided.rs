//! The target that `SWEEPD_FUZZ_TARGET` names, for libFuzzer. One program for all of them, since
//! linking fifteen takes longer than many a run.
#![no_main]

mod targets;

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;

static RUN: LazyLock<targets::Run> = LazyLock::new(|| {
    let name = std::env::var("SWEEPD_FUZZ_TARGET").expect("SWEEPD_FUZZ_TARGET, the name of a target");
    targets::named(&name)
});

fuzz_target!(|input: &[u8]| RUN(input));

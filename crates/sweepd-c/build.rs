//! Gives the library its name for the loader, with the version of the ABI.

use std::env;
use std::os::unix::fs::symlink;
use std::path::Path;

/// Programs ask the loader for this file. The number is `ABI_VERSION` of the library.
const SONAME: &str = "libsweepd.so.1";

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,{SONAME}");
    // iceoryx2 exports a function of its own. A program with another iceoryx2 would have them meet.
    println!("cargo:rustc-cdylib-link-arg=-Wl,--exclude-libs,ALL");
    // Cargo names no file so. Beside the library, target/release is as good as a folder in which it is
    // installed. If cargo puts this folder elsewhere, the link is of no use and does no harm.
    let out = env::var_os("OUT_DIR").unwrap_or_default();
    if let Some(target) = Path::new(&out).ancestors().nth(3) {
        // It may be there.
        let _ = symlink("libsweepd.so", target.join(SONAME));
    }
}

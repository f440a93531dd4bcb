//! Gives the library its name for the loader, with the version of the ABI.

use std::env;
use std::os::unix::fs::symlink;
use std::path::Path;

#[path = "src/abi.rs"]
mod abi;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=src/abi.rs");
    // Programs ask the loader for this file.
    let soname = format!("libsweepd.so.{}", abi::VERSION);
    println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,{soname}");
    // iceoryx2 exports a function of its own. A program with another iceoryx2 would have them meet.
    println!("cargo:rustc-cdylib-link-arg=-Wl,--exclude-libs,ALL");
    // Cargo names no file so. Beside the library, target/release is as good as a folder in which it is
    // installed. If cargo puts this folder elsewhere, the link is of no use and does no harm.
    let out = env::var_os("OUT_DIR").unwrap_or_default();
    if let Some(target) = Path::new(&out).ancestors().nth(3) {
        // It may be there.
        let _ = symlink("libsweepd.so", target.join(soname));
    }
}

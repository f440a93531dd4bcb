//! libsweepd, and programs in C and C++ that use it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use crate::{pool, root};

/// An example of the client in Rust, built as these tests are, with the same features: `cargo test`
/// has done so before.
pub fn rust_example(name: &str) -> PathBuf {
    pool::share();
    build(&["--example", name]);
    profile().join("examples").join(name)
}

/// The folder of libsweepd, which no test makes cargo build: with the same features, that takes
/// nothing else.
pub fn library() -> &'static Path {
    // Before the lock, for which one that is alone may wait.
    pool::share();
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        build(&["--lib", "--example", "consumer"]);
        profile()
    })
}

fn build(what: &[&str]) {
    let mut cargo = Command::new(env!("CARGO"));
    cargo
        .args("build --quiet --locked --offline --features slow-tests".split(' '))
        .args(what)
        // Where .ci/run has it, it is for the times of tests: cargo would compile all again.
        .env_remove("RUSTC_BOOTSTRAP")
        .current_dir(root());
    if !cfg!(debug_assertions) {
        cargo.arg("--release");
    }
    assert!(cargo.status().unwrap().success(), "{what:?} is not built");
}

/// The folder of the profile: this test is in target/debug/deps.
fn profile() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    test.ancestors().nth(2).unwrap().to_owned()
}

/// Compiles a program that uses libsweepd; nothing may be warned of.
pub fn compile(compiler: &str, options: &[&str], source: &Path, program: &Path) {
    let library = library();
    let mut command = Command::new(compiler);
    command
        .args(options)
        .args("-O2 -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Werror -I".split(' '))
        .arg(root().join("examples"))
        .arg(source)
        .arg("-o")
        .arg(program)
        .arg("-L")
        .arg(library)
        .arg(format!("-Wl,-rpath,{}", library.display()))
        .args(["-lsweepd", "-lm", "-lpthread"]);
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{}: {}",
        source.display(),
        String::from_utf8_lossy(&output.stderr)
    );
}

/// `library.c`, compiled into a folder.
pub fn c_program(folder: &Path) -> PathBuf {
    let program = folder.join("library");
    let source = root().join("crates/sweepd-testkit/src/library.c");
    compile("cc", &["-std=c99"], &source, &program);
    program
}

//! Programs of the package `sweepd-tools`, which `sweepd` starts: what a robot does without, or what
//! must not share a process with the driver.

use std::env;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Builds them in a checkout, where this program was built.
const BUILD: &str = if cfg!(debug_assertions) {
    "cargo build -p sweepd-tools"
} else {
    "cargo build --release -p sweepd-tools"
};

/// The program of this name: beside the executable of this process, else in a folder of `PATH`.
/// Relative folders of `PATH` are left out: no program is started from the folder that the user
/// happens to be in.
pub fn find(name: &str) -> Option<PathBuf> {
    let own = env::current_exe().unwrap_or_default();
    let beside = own.parent().map(Path::to_owned);
    let path = env::var_os("PATH").unwrap_or_default();
    first(name, beside.into_iter().chain(env::split_paths(&path)))
}

/// What to say of a program that [`find`] does not find: its name, where it was looked for, and the
/// cure. It fits behind "the file is read by".
pub fn missing(name: &str) -> String {
    format!(
        "{name}, which is not beside sweepd or on PATH: install the package sweepd-tools (cargo install sweepd-tools; \
         in a checkout, {BUILD})"
    )
}

/// The first program of this name in these folders.
fn first(name: &str, folders: impl Iterator<Item = PathBuf>) -> Option<PathBuf> {
    for folder in folders {
        let path = folder.join(name);
        if folder.is_absolute() && is_program(&path) {
            return Some(path);
        }
    }
    None
}

fn is_program(path: &Path) -> bool {
    path.metadata()
        .is_ok_and(|file| file.is_file() && file.permissions().mode() & 0o111 != 0)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn the_first_program_of_the_name_is_found_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let folders = ["text", "folder", "one", "two"].map(|name| folder.path().join(name));
        for path in &folders {
            fs::create_dir(path).unwrap();
        }
        let [text, inner, one, two] = &folders;
        fs::write(text.join("tool"), "no program").unwrap();
        fs::create_dir(inner.join("tool")).unwrap();
        for path in [one, two] {
            fs::write(path.join("tool"), "#!/bin/sh\n").unwrap();
            fs::set_permissions(path.join("tool"), fs::Permissions::from_mode(0o755)).unwrap();
        }
        assert_eq!(
            first("tool", folders.iter().cloned()),
            Some(one.join("tool"))
        );
        assert_eq!(first("tool", folders[..2].iter().cloned()), None);
        assert_eq!(first("other", folders.iter().cloned()), None);
        // A relative folder, which an empty one is, too.
        let relative = pathdiff(one);
        assert!(is_program(&relative.join("tool")));
        assert_eq!(first("tool", [relative, PathBuf::new()].into_iter()), None);
    }

    /// A path from the current folder to this one.
    fn pathdiff(absolute: &Path) -> PathBuf {
        let depth = env::current_dir().unwrap().components().count() - 1;
        let up: PathBuf = std::iter::repeat_n("..", depth).collect();
        up.join(absolute.strip_prefix("/").unwrap())
    }
}

//! The page: the files in `src/view/page`, embedded. Nothing else can be read.

use hyper::body::Bytes;

/// An embedded file.
pub(super) struct File {
    /// Its name after `/page/`; that of the first is `/` too.
    name: &'static str,
    /// Its media type.
    pub(super) kind: &'static str,
    bytes: &'static [u8],
}

impl File {
    /// What is in it.
    pub(super) fn bytes(&self) -> Bytes {
        Bytes::from_static(self.bytes)
    }
}

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const PICTURE: &str = "image/svg+xml";

macro_rules! files {
    ($($name:literal $kind:ident),* $(,)?) => {
        &[$(File {
            name: $name,
            kind: $kind,
            bytes: include_bytes!(concat!("page/", $name)),
        }),*]
    };
}

/// All files of the page, `index.html` first.
const FILES: &[File] = files![
    "index.html" HTML,
    "style.css" STYLE,
    "icon.svg" PICTURE,
    "main.js" SCRIPT,
    "camera.js" SCRIPT,
    "cloud.js" SCRIPT,
    "facts.js" SCRIPT,
    "image.js" SCRIPT,
    "palette.js" SCRIPT,
    "plots.js" SCRIPT,
    "save.js" SCRIPT,
    "sweep.js" SCRIPT,
    "table.js" SCRIPT,
    "timeline.js" SCRIPT,
    "tuning.js" SCRIPT,
];

/// The file at a path of the server.
pub(super) fn find(path: &str) -> Option<&'static File> {
    if path == "/" {
        return FILES.first();
    }
    let name = path.strip_prefix("/page/")?;
    FILES.iter().find(|file| file.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_files_of_the_list_are_found() {
        assert!(find("/").is_some_and(|file| file.kind == HTML));
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/view/page");
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), FILES.len());
        for file in FILES {
            assert!(find(&format!("/page/{}", file.name)).is_some());
        }
        for path in [
            "",
            "/page",
            "/page/",
            "/index.html",
            "/page/../page.rs",
            "/page//etc/passwd",
            "//",
            "/socket",
        ] {
            assert!(find(path).is_none(), "{path}");
        }
    }
}

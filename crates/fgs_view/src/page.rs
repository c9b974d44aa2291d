//! The page's own files, which are part of the program.

use std::borrow::Cow;
use std::collections::BTreeMap;

/// A file to be served or written.
#[derive(Clone, Debug)]
pub struct File {
    pub content_type: &'static str,
    pub bytes: Cow<'static, [u8]>,
    pub is_gzip: bool,
}

/// Files by their paths from the page, with `/`.
pub type Files = BTreeMap<String, File>;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const TEXT: &str = "text/plain; charset=utf-8";

macro_rules! web {
    ($name:literal) => {
        include_bytes!(concat!("../web/", $name))
    };
}

/// All but what there is to be shown, `scene.json`.
pub fn page() -> Files {
    let files: [(&str, &'static str, &'static [u8]); 8] = [
        ("index.html", HTML, web!("index.html")),
        ("style.css", CSS, web!("style.css")),
        ("app.js", SCRIPT, web!("app.js")),
        ("space.js", SCRIPT, web!("space.js")),
        ("plots.js", SCRIPT, web!("plots.js")),
        (
            "vendor/LICENSE-three.txt",
            TEXT,
            web!("vendor/LICENSE-three.txt"),
        ),
        (
            "vendor/LICENSE-spark.txt",
            TEXT,
            web!("vendor/LICENSE-spark.txt"),
        ),
        (
            "vendor/LICENSE-fflate.txt",
            TEXT,
            web!("vendor/LICENSE-fflate.txt"),
        ),
    ];
    let mut page: Files = files
        .into_iter()
        .map(|(name, content_type, bytes)| (name.to_owned(), plain(content_type, bytes)))
        .collect();
    let viewer = File {
        is_gzip: true,
        ..plain(SCRIPT, web!("vendor/spark-three.min.js.gz"))
    };
    page.insert("vendor/spark-three.min.js".into(), viewer);
    page
}

fn plain(content_type: &'static str, bytes: &'static [u8]) -> File {
    File {
        content_type,
        bytes: bytes.into(),
        is_gzip: false,
    }
}

/// A file that is made.
pub fn made(content_type: &'static str, bytes: Vec<u8>) -> File {
    File {
        content_type,
        bytes: bytes.into(),
        is_gzip: false,
    }
}

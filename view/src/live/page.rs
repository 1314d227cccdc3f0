//! The files of the page, part of the program: nothing is loaded from elsewhere.

/// A file of the page.
#[derive(Debug, Clone, Copy)]
pub struct File {
    /// Its path below the page; empty for the page itself.
    pub path: &'static str,
    /// Its type.
    pub media_type: &'static str,
    /// Its content.
    pub bytes: &'static [u8],
}

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

/// Makes a list of files: path, type, and where the content lies.
macro_rules! files {
    ($($path:literal $media_type:ident $file:literal,)+) => {
        /// All files.
        pub const FILES: &[File] = &[$(File {
            path: $path,
            media_type: $media_type,
            bytes: include_bytes!($file),
        },)+];
    };
}

const PICTURE: &str = "image/svg+xml";
const TEXT: &str = "text/plain; charset=utf-8";

files! {
    "" HTML "page/index.html",
    "fleet.html" HTML "page/fleet.html",
    "fleet.css" STYLE "page/fleet.css",
    "fleet.js" SCRIPT "page/fleet.js",
    "card.js" SCRIPT "page/card.js",
    "theme.js" SCRIPT "page/theme.js",
    "page.css" STYLE "page/page.css",
    "main.js" SCRIPT "page/main.js",
    "store.js" SCRIPT "page/store.js",
    "scene.js" SCRIPT "page/scene.js",
    "charts.js" SCRIPT "page/charts.js",
    "panels.js" SCRIPT "page/panels.js",
    "timeline.js" SCRIPT "page/timeline.js",
    "icon.svg" PICTURE "page/icon.svg",
    "uplot/uPlot.iife.min.js" SCRIPT "page/uplot/uPlot.iife.min.js",
    "uplot/uPlot.min.css" STYLE "page/uplot/uPlot.min.css",
    "uplot/LICENSE" TEXT "page/uplot/LICENSE",
}

/// The file of a path; `None` when the page has none.
pub fn file(path: &str) -> Option<&'static File> {
    FILES.iter().find(|file| file.path == path)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of the whole page, bytes.
    const BYTES_MAX: usize = 300_000;

    #[test]
    fn the_page_is_small_and_loads_nothing_from_elsewhere() {
        let bytes: usize = FILES.iter().map(|file| file.bytes.len()).sum();
        assert!(bytes <= BYTES_MAX, "{bytes} bytes");
        for file in FILES.iter().filter(|file| !file.path.starts_with("uplot/")) {
            let text = String::from_utf8_lossy(file.bytes);
            let text = text.replace("http://www.w3.org/2000/svg", "");
            for foreign in ["http://", "https://", "//cdn", "@import"] {
                assert!(!text.contains(foreign), "{}: {foreign}", file.path);
            }
            // Text from a run is set as text, never as HTML.
            for acting in [
                "innerHTML",
                "outerHTML",
                "insertAdjacentHTML",
                "document.write",
                "eval(",
            ] {
                assert!(!text.contains(acting), "{}: {acting}", file.path);
            }
        }
    }

    #[test]
    fn what_the_page_names_is_among_its_files() {
        for file in FILES.iter().filter(|file| file.media_type != TEXT) {
            let text = String::from_utf8_lossy(file.bytes);
            let quoted = text.split('"').skip(1).step_by(2);
            let named =
                quoted.filter(|name| !name.contains(' ') && !file.path.starts_with("uplot/"));
            for name in named.filter(|name| name.ends_with(".js") || name.ends_with(".css")) {
                let path = name.trim_start_matches("./");
                assert!(super::file(path).is_some(), "{}: {name}", file.path);
            }
        }
        assert!(super::file("../main.rs").is_none() && super::file("nothing").is_none());
    }
}

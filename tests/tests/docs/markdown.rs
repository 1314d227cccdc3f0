//! Reads what a Markdown page refers to: its code, its links, its headings.

/// A piece of code on a page.
pub struct Code {
    /// Line of the page, from 1.
    pub line: usize,
    /// The text without its backticks; one line of a fenced block, its continuation
    /// lines joined.
    pub text: String,
    /// The text stands in a fenced block.
    pub is_fenced: bool,
}

/// What one page refers to.
#[derive(Default)]
pub struct Page {
    /// Code in the order of the page.
    pub code: Vec<Code>,
    /// Line and target of each link and picture.
    pub links: Vec<(usize, String)>,
    /// The anchors of the headings, as GitHub derives them.
    pub anchors: Vec<String>,
}

/// Reads a page.
pub fn read(text: &str) -> Page {
    let mut page = Page::default();
    let mut is_fenced = false;
    let mut joined = String::new();
    for (number, line) in text.lines().enumerate() {
        let line_number = number + 1;
        if line.trim_start().starts_with("```") {
            is_fenced = !is_fenced;
            continue;
        }
        if is_fenced {
            // One space between the parts: two of them begin a remark.
            joined.push_str(match joined.is_empty() {
                true => line,
                false => line.trim_start(),
            });
            if joined.ends_with('\\') {
                joined.truncate(joined.trim_end_matches(['\\', ' ']).len());
                joined.push(' ');
            } else {
                page.code.push(Code {
                    line: line_number,
                    text: std::mem::take(&mut joined),
                    is_fenced,
                });
            }
            continue;
        }
        let prose = take_code(line, line_number, &mut page.code);
        if line.starts_with('#') {
            page.anchors.push(anchor(line.trim_start_matches('#')));
        }
        page.links
            .extend(targets(&prose).map(|target| (line_number, target.to_string())));
    }
    page
}

/// Moves the inline code of a line into `code` and returns the rest.
fn take_code(line: &str, number: usize, code: &mut Vec<Code>) -> String {
    let mut rest = line;
    let mut prose = String::new();
    while let Some(start) = rest.find('`') {
        let ticks = rest[start..].len() - rest[start..].trim_start_matches('`').len();
        let after = &rest[start + ticks..];
        let Some(end) = after.find(&"`".repeat(ticks)) else {
            break;
        };
        prose.push_str(&rest[..start]);
        code.push(Code {
            line: number,
            text: after[..end].trim().to_string(),
            is_fenced: false,
        });
        rest = &after[end + ticks..];
    }
    prose + rest
}

/// The targets of the links and pictures in prose.
fn targets(prose: &str) -> impl Iterator<Item = &str> {
    let parts = prose.split("](").skip(1);
    parts.filter_map(|part| Some(part.split_once(')')?.0))
}

/// The anchor of a heading: lower case, spaces as hyphens, no punctuation.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    kept.chars()
        .filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

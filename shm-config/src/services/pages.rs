//! The service table as a page and as a picture.
//!
//! Both are checked in; `tests/services.rs` compares them with the table.

use std::fmt::Write as _;

use super::{Delivery, Leaves, Process, Rate, Recorded, Row, SERVICES, TakenFrom};

/// The processes from left to right, in the order in which a tick passes through them.
const COLUMNS: [Process; 7] = [
    Process::World,
    Process::Planner,
    Process::Controller,
    Process::Gate,
    Process::Learner,
    Process::Recorder,
    Process::Supervisor,
];

/// Left end of the rows' names, px.
const NAME_X: usize = 20;
/// The first process's column, px.
const FIRST_X: usize = 190;
/// From column to column, px.
const COLUMN_PX: usize = 110;
/// The column of commands that publish, px.
const TOOL_X: usize = FIRST_X + COLUMNS.len() * COLUMN_PX;
/// Right of the last column, px.
const RATE_X: usize = TOOL_X + 70;
/// Width of the picture, px.
const WIDTH: usize = RATE_X + 240;
/// The first row, px from the top.
const FIRST_Y: usize = 80;
/// From row to row, px.
const ROW_PX: usize = 30;

/// The module's documentation: `docs/services.md`.
pub fn markdown() -> String {
    let mut page = String::from(
        "The service table: every flow of data between two processes is one row.\n\n\
         This page is generated from the table in `shm-config/src/services/mod.rs`. The names of \
         consumers that a message wakes are bold; commands such as `status` may read every \
         service. The recorder reads each row that is recorded; \"and in the step\" means that \
         `step` has the message that its tick used, too.\n\n\
         | service | message | bytes | from | to | delivery | published | refused when older than \
         | recorded | leaves the machine |\n|---|---|--:|---|---|---|---|---|---|---|\n",
    );
    for row in SERVICES {
        let _ = writeln!(
            page,
            "| `{}` | `{}` | {} | {} | {} | {} | {} | {} | {} | {} |",
            row.name,
            row.message.name,
            row.message.bytes,
            sources(row),
            readers(row),
            match row.delivery {
                Delivery::Latest => "newest".into(),
                Delivery::Queue(depth) => format!("queue of {depth}"),
            },
            published(row.rate),
            match row.age_limit.key() {
                Some(key) => format!("`{key}`"),
                None if row.age_limit == super::AgeLimit::OwnExpiry => "its own expiry".into(),
                None => "-".into(),
            },
            match row.recorded {
                Recorded::Yes => "yes",
                Recorded::No => "no",
                Recorded::InStep => "yes, and in the step",
            },
            match row.leaves {
                Leaves::No => "no",
                Leaves::Newest => "newest",
                Leaves::Every => "every",
            },
        );
    }
    page.push_str("\nContent of each service:\n\n");
    for row in SERVICES {
        let _ = writeln!(page, "- `{}`: {}", row.name, row.about.trim());
    }
    page
}

fn sources(row: &Row) -> String {
    let processes = row.producers.iter().map(|process| process.to_string());
    let tools = row.tools.iter().map(|tool| format!("`{tool}`"));
    let mut text = processes.chain(tools).collect::<Vec<_>>().join(", ");
    if row.taken_from == TakenFrom::Anyone {
        text.push_str("; taken from any process of the user");
    }
    text
}

fn readers(row: &Row) -> String {
    let name = |process: &Process| match row.wakes.contains(process) {
        true => format!("**{process}**"),
        false => process.to_string(),
    };
    row.consumers
        .iter()
        .map(name)
        .collect::<Vec<_>>()
        .join(", ")
}

fn published(rate: Rate) -> String {
    match rate {
        Rate::Tick(process) => format!("each tick of the {process}"),
        Rate::Hz(hz) => format!("{hz} Hz"),
        Rate::Event(event) => event.into(),
    }
}

/// The picture of the flows: `docs/data-flow.svg`. A column for each process, a line for
/// each service.
pub fn picture() -> String {
    let bottom = FIRST_Y + SERVICES.len() * ROW_PX;
    let height = bottom + 50;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" \
         font-family=\"DejaVu Sans, Helvetica, Arial, sans-serif\" font-size=\"13\">\n\
         <rect width=\"{WIDTH}\" height=\"{height}\" rx=\"10\" fill=\"#ffffff\"/>\n"
    );
    for process in COLUMNS {
        let x = column_x(process);
        let is_in_tick = matches!(
            process,
            Process::World | Process::Planner | Process::Controller
        );
        let (fill, edge) = match is_in_tick {
            true => ("#dcebf7", "#7fa6c7"),
            false => ("#fbf0dc", "#cfae74"),
        };
        let (left, top) = (x - 48, 20);
        let _ = writeln!(
            svg,
            "<rect x=\"{left}\" y=\"{top}\" width=\"96\" height=\"32\" rx=\"6\" fill=\"{fill}\" \
             stroke=\"{edge}\"/><text x=\"{x}\" y=\"41\" text-anchor=\"middle\" \
             fill=\"#1d2b38\">{process}</text><path d=\"M{x} 52 V{bottom}\" stroke=\"{edge}\" \
             stroke-width=\"1\"/>"
        );
    }
    for (k, row) in SERVICES.iter().enumerate() {
        draw_row(&mut svg, row, FIRST_Y + k * ROW_PX);
    }
    let legend_y = bottom + 24;
    let _ = writeln!(
        svg,
        "<text x=\"{NAME_X}\" y=\"{legend_y}\" fill=\"#5a6875\" font-size=\"12\">blue: always \
         answers by the deadline; sand: at its own pace, no tick waits for it. Dot: publishes; \
         filled arrow: is woken; open arrow: polls; dashed: a queue.</text>\n</svg>"
    );
    svg
}

fn column_x(process: Process) -> usize {
    let column = COLUMNS.iter().position(|column| *column == process);
    FIRST_X + column.unwrap_or(COLUMNS.len()) * COLUMN_PX
}

fn draw_row(svg: &mut String, row: &Row, y: usize) {
    let mut sources: Vec<_> = row.producers.iter().map(|p| column_x(*p)).collect();
    if !row.tools.is_empty() {
        sources.push(TOOL_X);
    }
    let readers = row.consumers.iter().map(|p| column_x(*p));
    let ends = || sources.iter().copied().chain(readers.clone());
    let (left, right) = (ends().min().unwrap_or(0), ends().max().unwrap_or(0));
    let dashes = match row.delivery {
        Delivery::Latest => "",
        Delivery::Queue(_) => " stroke-dasharray=\"6 4\"",
    };
    let text_y = y + 4;
    let _ = writeln!(
        svg,
        "<text x=\"{NAME_X}\" y=\"{text_y}\" fill=\"#1d2b38\">{}</text><path d=\"M{left} {y} \
         H{right}\" stroke=\"#2b3a4a\" stroke-width=\"1.6\"{dashes}/><text x=\"{RATE_X}\" \
         y=\"{text_y}\" fill=\"#5a6875\" font-size=\"12\">{}</text>",
        row.name,
        published(row.rate)
    );
    for x in &sources {
        let _ = writeln!(
            svg,
            "<circle cx=\"{x}\" cy=\"{y}\" r=\"4\" fill=\"#2b3a4a\"/>"
        );
    }
    if let ([tool, ..], text_x) = (row.tools, TOOL_X + 8) {
        let above_y = y - 5;
        let _ = writeln!(
            svg,
            "<text x=\"{text_x}\" y=\"{above_y}\" fill=\"#5a6875\" font-size=\"11\">{tool}</text>"
        );
    }
    let first = sources.iter().copied().min().unwrap_or(left);
    for process in row.consumers {
        let x = column_x(*process);
        // The arrow points away from the nearest source on its left, if there is one.
        let tail = if first < x { x - 10 } else { x + 10 };
        let fill = match row.wakes.contains(process) {
            true => "#2b3a4a",
            false => "#ffffff",
        };
        let (above, below) = (y - 5, y + 5);
        let _ = writeln!(
            svg,
            "<path d=\"M{x} {y} L{tail} {above} V{below} Z\" fill=\"{fill}\" stroke=\"#2b3a4a\"/>"
        );
    }
}

//! Tables on the screen, and the description of the machine.

use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table, TableStyle};
use rustix::termios::tcgetwinsize;
use serde::Serialize;

/// One line below the header and one below the table, without lines between rows.
const STYLE: TableStyle = TableStyle::new()
    .header_separator(LineStyle::new('─', '─', '─', '─'))
    .bottom_border(LineStyle::new('─', '─', '─', '─'));

/// Bytes as hexadecimal digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// An empty table in the given style, at most as wide as the terminal; without a terminal
/// as wide as its rows.
pub fn fitted(style: TableStyle) -> Table {
    let mut table = Table::new();
    table
        .load_style(style)
        .set_content_arrangement(ContentArrangement::Dynamic);
    if let Ok(size) = tcgetwinsize(std::io::stdout())
        && size.ws_col > 0
    {
        table.set_width(size.ws_col);
    }
    table
}

/// An empty table in the style of this program; all columns but the first are
/// right-aligned.
pub fn table(header: &[&str]) -> Table {
    let mut table = fitted(STYLE);
    table.set_header(header);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

/// The machine of a measurement.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// The processor's name, if the system provides it.
    pub processor: Option<String>,
    /// Number of cores.
    pub cores: usize,
    /// Load average of the last minute before the run; above 0 the run competes with other
    /// work.
    pub load: Option<f64>,
}

impl Machine {
    /// Describes this machine as it is now.
    ///
    /// # Errors
    /// If the number of cores is unknown.
    pub fn here() -> anyhow::Result<Machine> {
        let processors = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let named = processors.lines().find_map(|line| {
            let (key, name) = line.split_once(':')?;
            (key.trim() == "model name").then(|| name.trim().to_string())
        });
        let load = std::fs::read_to_string("/proc/loadavg").ok();
        Ok(Machine {
            processor: named,
            cores: std::thread::available_parallelism()?.get(),
            load: load.and_then(|text| text.split(' ').next()?.parse().ok()),
        })
    }
}

impl std::fmt::Display for Machine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Machine {
            processor,
            cores,
            load,
        } = self;
        let processor = processor.as_deref().unwrap_or("unknown processor");
        let load = load.map_or("unknown".into(), |load| format!("{load:.1}"));
        write!(f, "{cores} cores, {processor}, load before the run {load}")
    }
}

//! The wire as a Python module: a process in Python uses the tables of this crate, so
//! no layout or limit is written twice.
//!
//! `cargo run -p shm-config --example python_wire` prints the module; a test
//! compares it with the one checked in beside the process that reads it.

use std::fmt::Write;

use crate::histogram::{BUCKETS, HALF_SHIFT, UNIT_SHIFT};
use crate::layout::Layout;
use crate::message::{
    Bend, Camera, Checkpoint, Command, Driver, Ego, Episode, FRAME_BYTES_MAX, FRAME_SIDES_PX,
    FUTURE_TOLERANCE_NS, Frame, FrameRequest, Grant, Header, Health, HealthState, Histogram,
    LATE_TICKS, LateTick, Observation, Outcome, Part, PixelFormat, Progress, Proposal, Reason,
    RefusalKind, Road, Roster, Scheduling, TOP_DOWN_ACROSS_M, TOP_DOWN_AHEAD, TOP_DOWN_HEIGHT_M,
    Timing, View,
};
use crate::palette;
use crate::run;
use crate::services::{self, Process, Service, TakenFrom};
use crate::wire::{LAYOUT_KEY, NODES_MAX, PUBLISHERS_MAX, SUBSCRIBERS_MAX};

const TITLE: &str = r#""""The wire of VLAPS: messages, services, limits.

Generated from the crate `shm-config`; do not edit. Renew it with
    cargo run -p shm-config --example python_wire > sim/metadrive/wire_layout.py
"""
"#;

/// The name that iceoryx2 compares, and a comparison of what ctypes made of the fields with
/// the layout of the other processes.
const STRUCT: &str = r#"

class Struct(ctypes.Structure):
    @classmethod
    def type_name(cls):
        return cls.__name__


def check(message, size, offsets):
    found = tuple(getattr(message, name).offset for name, _ in message._fields_)
    assert (ctypes.sizeof(message), found) == (size, offsets), message
"#;

/// The text of the module, with all that a world process needs.
pub fn module() -> String {
    let mut out = String::from(TITLE);
    out.push_str("\nimport ctypes\nfrom collections import namedtuple\n");
    limits(&mut out);
    colours(&mut out);
    word_lists(&mut out);
    out.push_str(STRUCT);
    messages(&mut out);
    service_rows(&mut out);
    out
}

fn word_lists(out: &mut String) {
    macro_rules! lists {
        ($($words:ident),+) => {
            $(word_list(out, stringify!($words), $words::ALL, $words::code, $words::word);)+
        };
    }
    lists!(
        Process,
        HealthState,
        Grant,
        Part,
        Scheduling,
        Outcome,
        Driver,
        Reason,
        RefusalKind,
        Bend,
        View,
        PixelFormat
    );
}

/// Each message, after those that it holds.
fn messages(out: &mut String) {
    macro_rules! each {
        ($($message:ident),+) => { $(message::<$message>(out);)+ };
    }
    each!(
        Header,
        Ego,
        Road,
        Checkpoint,
        Observation,
        Command,
        Progress,
        Episode,
        Health,
        Histogram,
        LateTick,
        Timing,
        Camera,
        Frame,
        Proposal,
        FrameRequest,
        Roster
    );
}

fn service_rows(out: &mut String) {
    out.push_str(
        "\n\nService = namedtuple(\"Service\", \"name message from_ to depth most history open\")\n\n",
    );
    service(out, "OBSERVATION", &services::OBSERVATION);
    service(out, "COMMAND", &services::COMMAND);
    service(out, "FRAME_REQUEST", &services::FRAME_REQUEST);
    service(out, "FRAME", &services::FRAME);
    service(out, "ROSTER", &services::ROSTER);
    service(out, "PROGRESS", &services::PROGRESS);
    service(out, "EPISODE", &services::EPISODE);
    service(out, "HEALTH_WORLD", &services::health(Process::World));
    service(out, "TIMING_WORLD", &services::timing(Process::World));
}

fn limits(out: &mut String) {
    let mut line = |name: &str, value: String| line(out, &format!("{name} = {value}"));
    line("USER_DIR", format!("{:?}", run::USER_DIR));
    line("PREFIX", format!("{:?}", run::PREFIX));
    line("ALIVE_FILE", format!("{:?}", run::ALIVE_FILE));
    line("SHARED_MEMORY_DIR", format!("{:?}", run::SHARED_MEMORY_DIR));
    line("PUBLISHERS_MAX", PUBLISHERS_MAX.to_string());
    line("SUBSCRIBERS_MAX", SUBSCRIBERS_MAX.to_string());
    line("NODES_MAX", NODES_MAX.to_string());
    line("LAYOUT_KEY", format!("{LAYOUT_KEY:?}"));
    line("FUTURE_TOLERANCE_NS", FUTURE_TOLERANCE_NS.to_string());
    line("HISTOGRAM_UNIT_SHIFT", UNIT_SHIFT.to_string());
    line("HISTOGRAM_HALF_SHIFT", HALF_SHIFT.to_string());
    line("HISTOGRAM_BUCKETS", BUCKETS.to_string());
    line("LATE_TICKS", LATE_TICKS.to_string());
    line("FRAME_BYTES_MAX", FRAME_BYTES_MAX.to_string());
    line("FRAME_SIDE_MIN_PX", FRAME_SIDES_PX.start().to_string());
    line("FRAME_SIDE_MAX_PX", FRAME_SIDES_PX.end().to_string());
    line("TOP_DOWN_ACROSS_M", format!("{TOP_DOWN_ACROSS_M:?}"));
    line("TOP_DOWN_AHEAD", format!("{TOP_DOWN_AHEAD:?}"));
    line("TOP_DOWN_HEIGHT_M", format!("{TOP_DOWN_HEIGHT_M:?}"));
}

fn colours(out: &mut String) {
    line(out, "\n\nclass Palette:");
    for (name, [red, green, blue]) in palette::ALL {
        line(out, &format!("    {name} = ({red}, {green}, {blue})"));
    }
}

fn line(out: &mut String, text: &str) {
    // Writing to a String cannot fail.
    let _ = writeln!(out, "{text}");
}

fn word_list<T: Copy>(
    out: &mut String,
    name: &str,
    all: &[T],
    code: fn(T) -> u32,
    word: fn(T) -> &'static str,
) {
    line(out, &format!("\n\nclass {name}:"));
    for &value in all {
        let constant = word(value).to_uppercase().replace([' ', '-'], "_");
        line(out, &format!("    {constant} = {}", code(value)));
    }
    let words: Vec<_> = all
        .iter()
        .map(|&value| format!("{}: {:?}", code(value), word(value)))
        .collect();
    line(out, &format!("    WORDS = {{{}}}", words.join(", ")));
}

/// A type of the field tables in Python's words.
fn python_type(name: &str) -> String {
    if let Some(array) = name
        .strip_prefix('[')
        .and_then(|name| name.strip_suffix(']'))
        && let Some((element, count)) = array.split_once(';')
    {
        return format!("{} * {}", python_type(element.trim()), count.trim());
    }
    match name {
        "f32" => "ctypes.c_float".into(),
        "f64" => "ctypes.c_double".into(),
        "u8" => "ctypes.c_uint8".into(),
        "u32" => "ctypes.c_uint32".into(),
        "u64" => "ctypes.c_uint64".into(),
        // A nested message, printed above.
        message => message.into(),
    }
}

fn message<M: Layout>(out: &mut String) {
    line(out, &format!("\n\nclass {}(Struct):", M::NAME));
    line(out, &format!("    LAYOUT = \"{:016x}\"", M::FINGERPRINT));
    line(out, "    _fields_ = [");
    for field in M::FIELDS {
        let kind = python_type(field.type_name);
        line(out, &format!("        (\"{}\", {kind}),", field.name));
    }
    line(out, "    ]");
    let end = M::FIELDS
        .last()
        .map_or(0, |field| field.offset + field.size);
    let offsets = M::FIELDS.iter().map(|field| field.offset.to_string());
    let offsets = offsets.collect::<Vec<_>>().join(", ");
    line(out, &format!("\n\ncheck({}, {end}, ({offsets},))", M::NAME));
}

fn service<M: Layout>(out: &mut String, constant: &str, service: &Service<M>) {
    let (depth, history) = service.row.delivery.queue();
    let most = service.row.recorded_depth();
    let open = match service.row.taken_from {
        TakenFrom::Anyone => "True",
        TakenFrom::Producer => "False",
    };
    let to: Vec<_> = service
        .row
        .wakes
        .iter()
        .map(|process| format!("{:?}", process.word()))
        .collect();
    let to = match to.as_slice() {
        [] => "()".to_string(),
        to => format!("({},)", to.join(", ")),
    };
    line(
        out,
        &format!(
            "{constant} = Service({:?}, {}, {:?}, {to}, {depth}, {most}, {history}, {open})",
            service.name,
            M::NAME,
            service.from.word(),
        ),
    );
}

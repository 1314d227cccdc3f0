//! What the header and the description for other languages are made of: the messages
//! and closed lists of `shm-config`, and the structs of this library.

use serde_json::{Map, Value, json};
use shm_config::layout::{FNV_BASIS, Field, Layout, Table, fnv1a};
use shm_config::message::{
    Admission, BEAMS_MAX, Bend, Driver, FEATURES, FaultKind, Grant, HealthState, Intent, Judge,
    Lateness, Outcome, PLANNED_MAX, Part, PixelFormat, PlanOutcome, PolicyState, Preference,
    Reason, RefusalKind, Scheduling, Stage, Verdict, View, WAYPOINTS_MAX,
};
use shm_config::services::{Process, SERVICES};

use crate::failure::{Answer, Kind};
use crate::port::Use;
use crate::world::Tick;

/// Raised when a function of the library changes its arguments or its meaning.
pub const ABI: u32 = 1;

/// A closed list: its name, and each word with its code.
pub struct List {
    /// The list's name, such as `Outcome`.
    pub name: &'static str,
    /// Words and codes, in order.
    pub words: Vec<(&'static str, u32)>,
}

/// Every message, each after those that it contains; the library's own last.
pub fn tables() -> Vec<&'static Table> {
    let mut tables = Vec::new();
    for row in SERVICES {
        add(&mut tables, row.message.table);
    }
    add(&mut tables, Tick::TABLE);
    tables
}

fn add(tables: &mut Vec<&'static Table>, table: &'static Table) {
    if tables.iter().any(|known| known.name == table.name) {
        return;
    }
    for nested in table.nested {
        add(tables, nested);
    }
    tables.push(table);
}

/// Bytes of a message.
pub fn size(table: &Table) -> usize {
    table
        .fields
        .last()
        .map_or(0, |field| field.offset + field.size)
}

/// The numbers of the header: a name and a value.
pub const CONSTANTS: [(&str, usize); 4] = [
    ("BEAMS_MAX", BEAMS_MAX),
    ("WAYPOINTS_MAX", WAYPOINTS_MAX),
    ("PLANNED_MAX", PLANNED_MAX),
    ("FEATURES", FEATURES),
];

/// The hash of all that the header says: layouts, codes, constants, and the version of
/// the functions. A header and a library with different ones refuse each other.
pub fn layout() -> u64 {
    layout_with(&lists(), &CONSTANTS)
}

/// The hash with these lists and constants.
pub fn layout_with(lists: &[List], constants: &[(&str, usize)]) -> u64 {
    let mut hash = fnv1a(FNV_BASIS, &ABI.to_le_bytes());
    for row in SERVICES {
        hash = fnv1a(hash, row.name.as_bytes());
        hash = fnv1a(hash, &row.message.fingerprint.to_le_bytes());
    }
    hash = fnv1a(hash, &Tick::FINGERPRINT.to_le_bytes());
    for list in lists {
        hash = fnv1a(hash, list.name.as_bytes());
        for (word, code) in &list.words {
            hash = fnv1a(hash, word.as_bytes());
            hash = fnv1a(hash, &code.to_le_bytes());
        }
    }
    for (name, value) in constants {
        hash = fnv1a(hash, name.as_bytes());
        hash = fnv1a(hash, &(*value as u64).to_le_bytes());
    }
    hash
}

/// Every closed list that a field may hold, and those of the library.
pub fn lists() -> Vec<List> {
    macro_rules! lists {
        ($($list:ident),+ $(,)?) => { vec![$( List {
            name: stringify!($list),
            words: $list::ALL.iter().map(|value| (value.word(), value.code())).collect(),
        } ),+] };
    }
    lists![
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
        PixelFormat,
        PlanOutcome,
        Lateness,
        Preference,
        Judge,
        Verdict,
        PolicyState,
        Admission,
        Intent,
        Stage,
        FaultKind,
        Answer,
        Kind,
        Use,
    ]
}

/// What a field is, in lines. Links of the source are words in another language.
pub fn documented(field: &Field) -> Vec<String> {
    let lines = field.doc.iter();
    lines
        .map(|line| line.trim().replace("[`", "`").replace("`]", "`"))
        .collect()
}

/// Everything as JSON: `layout`, `messages` (name, bytes, fields of name, type, offset and
/// doc), `lists` (name, words with codes), `services` (name, message).
pub fn json() -> Value {
    let message = |table: &&'static Table| {
        let fields = table.fields.iter().map(|field| {
            json!({
                "name": field.name,
                "type": field.type_name,
                "offset": field.offset,
                "doc": documented(field).join(" "),
            })
        });
        json!({
            "name": table.name,
            "bytes": size(table),
            "fields": fields.collect::<Vec<_>>(),
        })
    };
    let list = |list: List| {
        let words = list.words.iter();
        let words: Map<_, _> = words
            .map(|(word, code)| (word.to_string(), json!(code)))
            .collect();
        (list.name.to_string(), Value::Object(words))
    };
    let service = |name: &&'static str, message: &str| json!({"name": name, "message": message});
    let services = SERVICES.iter().flat_map(|row| {
        let message = row.message.name;
        row.instances.iter().map(move |name| service(name, message))
    });
    json!({
        "layout": format!("{:016x}", layout()),
        "messages": tables().iter().map(message).collect::<Vec<_>>(),
        "lists": lists().into_iter().map(list).collect::<Map<_, _>>(),
        "services": services.collect::<Vec<_>>(),
    })
}

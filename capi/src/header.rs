//! The C header, written from the tables of the messages.
//!
//! `cargo run -p capi --example header > capi/include/vlaps.h` renews the file; a test
//! compares it.

use std::fmt::Write;

use shm_config::layout::Table;

use crate::description::{CONSTANTS, List, documented, layout, lists, size, tables};

/// The part before the messages.
const TOP: &str = include_str!("header/top.h");
/// The functions.
const FUNCTIONS: &str = include_str!("header/functions.h");

/// The text of the header.
pub fn text() -> String {
    let mut out = String::from(TOP);
    line(
        &mut out,
        &format!("#define VLAPS_LAYOUT UINT64_C(0x{:016x})\n", layout()),
    );
    for (name, value) in CONSTANTS {
        line(&mut out, &format!("#define VLAPS_{name} {value}"));
    }
    for list in lists() {
        word_list(&mut out, &list);
    }
    for table in tables() {
        message(&mut out, table);
    }
    out.push_str(FUNCTIONS);
    out
}

fn line(out: &mut String, text: &str) {
    // Writing to a String cannot fail.
    let _ = writeln!(out, "{text}");
}

/// `LateTick` as `late_tick`.
fn snake(name: &str) -> String {
    let mut out = String::new();
    for (k, letter) in name.char_indices() {
        if letter.is_uppercase() && k > 0 {
            out.push('_');
        }
        out.extend(letter.to_lowercase());
    }
    out
}

/// A list whose words are the library's own has no second part in its names.
fn word_list(out: &mut String, list: &List) {
    let name = snake(list.name);
    line(out, &format!("\nenum vlaps_{name} {{"));
    for (word, code) in &list.words {
        let word = word.to_uppercase().replace([' ', '-'], "_");
        let constant = match list.name {
            "Answer" | "Use" => format!("VLAPS_{word} = {code}"),
            "Kind" => format!("VLAPS_{word} = -{code}"),
            _ => format!("VLAPS_{}_{word} = {code}", name.to_uppercase()),
        };
        line(out, &format!("    {constant},"));
    }
    line(out, "};");
}

/// A field in C: its type, and the length of an array after its name.
fn field(type_name: &str, name: &str) -> String {
    if let Some(array) = type_name
        .strip_prefix('[')
        .and_then(|rest| rest.strip_suffix(']'))
        && let Some((element, count)) = array.split_once(';')
    {
        return field(element.trim(), &format!("{name}[{}]", count.trim()));
    }
    let kind = match type_name {
        "f32" => "float".into(),
        "f64" => "double".into(),
        "u8" => "uint8_t".into(),
        "u32" => "uint32_t".into(),
        "u64" => "uint64_t".into(),
        message => format!("vlaps_{}", snake(message)),
    };
    format!("{kind} {name}")
}

fn message(out: &mut String, table: &Table) {
    let name = format!("vlaps_{}", snake(table.name));
    line(out, &format!("\ntypedef struct {name} {{"));
    for part in table.fields {
        let said = documented(part).join("\n     * ");
        line(out, &format!("    /* {said} */"));
        line(out, &format!("    {};", field(part.type_name, part.name)));
    }
    line(out, &format!("}} {name};"));
    line(
        out,
        &format!(
            "VLAPS_ASSERT(sizeof({name}) == {}, \"{name}\");",
            size(table)
        ),
    );
    for part in table.fields {
        let (part, offset) = (part.name, part.offset);
        line(
            out,
            &format!("VLAPS_ASSERT(offsetof({name}, {part}) == {offset}, \"{name}.{part}\");"),
        );
    }
}

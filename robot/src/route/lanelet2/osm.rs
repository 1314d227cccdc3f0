//! The elements of an OSM file that make lanelets.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt::Debug;
use std::str::FromStr;

use roxmltree::{Document, Node as Xml, ParsingOptions};

/// Most nodes of the XML: four for each hundred bytes of the longest file, and more than that
/// is no map.
const XML_NODES_MAX: u32 = 1 << 21;

/// A node: where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Node {
    /// Latitude and longitude, degrees.
    pub(super) degrees: [f64; 2],
    /// In the frame of the map, m.
    pub(super) local_m: Option<[f64; 2]>,
}

/// What is not deleted.
#[derive(Debug, Default)]
pub(super) struct Elements {
    pub(super) nodes: BTreeMap<i64, Node>,
    pub(super) ways: BTreeMap<i64, Vec<i64>>,
    /// The ways of the left and the right bound.
    pub(super) lanelets: BTreeMap<i64, [i64; 2]>,
}

impl Elements {
    pub(super) fn read(text: &str) -> Result<Self, String> {
        let options = ParsingOptions {
            nodes_limit: XML_NODES_MAX,
            ..ParsingOptions::default()
        };
        let document = Document::parse_with_options(text, options);
        let document = document.map_err(|error| error.to_string())?;
        let root = document.root_element();
        if !root.has_tag_name("osm") {
            return Err("it is no OSM file".into());
        }
        let mut elements = Self::default();
        for xml in root.children().filter(Xml::is_element) {
            if xml.attribute("action") == Some("delete")
                || xml.attribute("visible") == Some("false")
            {
                continue;
            }
            match xml.tag_name().name() {
                "node" => insert(&mut elements.nodes, xml, node(xml)?)?,
                "way" => insert(&mut elements.ways, xml, way(xml)?)?,
                "relation" if tag(xml, "type") == Some("lanelet") => {
                    insert(&mut elements.lanelets, xml, lanelet(xml)?)?;
                }
                _ => {}
            }
        }
        match elements.lanelets.is_empty() {
            true => Err("it has no lanelet".into()),
            false => Ok(elements),
        }
    }
}

fn insert<T>(elements: &mut BTreeMap<i64, T>, xml: Xml<'_, '_>, element: T) -> Result<(), String> {
    match elements.entry(number(xml, "id")?) {
        Entry::Vacant(place) => {
            place.insert(element);
            Ok(())
        }
        Entry::Occupied(place) => Err(format!("two elements have the id {}", place.key())),
    }
}

/// A number among the attributes.
fn number<T: FromStr>(xml: Xml<'_, '_>, name: &str) -> Result<T, String> {
    let text = xml.attribute(name).unwrap_or_default();
    let wrong = |_| wrong(xml, name, text);
    text.parse().map_err(wrong)
}

fn wrong(xml: Xml<'_, '_>, name: &str, value: impl Debug) -> String {
    let line = xml.document().text_pos_at(xml.range().start).row;
    let element = xml.tag_name().name();
    format!("line {line}: <{element}> with {name}={value:?}")
}

/// The value of a tag.
fn tag<'a>(xml: Xml<'a, '_>, key: &str) -> Option<&'a str> {
    let mut tags = xml.children().filter(|child| child.has_tag_name("tag"));
    let found = tags.find(|tag| tag.attribute("k") == Some(key))?;
    found.attribute("v")
}

fn node(xml: Xml<'_, '_>) -> Result<Node, String> {
    let within = |name: &str, limit_deg: f64| match number(xml, name)? {
        deg if (-limit_deg..=limit_deg).contains(&deg) => Ok(deg),
        deg => Err(wrong(xml, name, deg)),
    };
    let local = |key: &str| {
        let text = tag(xml, key)?;
        let number = text.parse().ok().filter(|number: &f64| number.is_finite());
        Some(number.ok_or_else(|| wrong(xml, key, text)))
    };
    let pair = |x: &str, y: &str| Some([local(x)?, local(y)?]);
    let local_m = match pair("local_x", "local_y").or_else(|| pair("x", "y")) {
        Some([x, y]) => Some([x?, y?]),
        None => None,
    };
    // A map of local coordinates alone may leave them out.
    let degrees = match (local_m, xml.has_attribute("lat")) {
        (Some(_), false) => [0.0, 0.0],
        _ => [within("lat", 90.0)?, within("lon", 180.0)?],
    };
    Ok(Node { degrees, local_m })
}

fn way(xml: Xml<'_, '_>) -> Result<Vec<i64>, String> {
    let nodes = xml.children().filter(|child| child.has_tag_name("nd"));
    nodes.map(|node| number(node, "ref")).collect()
}

fn lanelet(xml: Xml<'_, '_>) -> Result<[i64; 2], String> {
    let bound = |role: &str| {
        let mut members = xml
            .children()
            .filter(|child| child.has_tag_name("member") && child.attribute("role") == Some(role));
        match (members.next(), members.next()) {
            (Some(member), None) if member.attribute("type") == Some("way") => {
                number(member, "ref")
            }
            (Some(member), None) => Err(wrong(member, "type", member.attribute("type"))),
            (None, _) => Err(wrong(xml, role, "no member")),
            (Some(_), Some(_)) => Err(wrong(xml, role, "more than one member")),
        }
    };
    Ok([bound("left")?, bound("right")?])
}

use super::*;

/// Nodes in the order of their number: x to the east, y to the north, m.
const PLACES: [(f64, f64); 10] = [
    // Left and right of a road along x, with a bend to the left at its end.
    (0.0, 2.0),
    (0.0, -2.0),
    (50.0, 2.0),
    (50.0, -2.0),
    (90.0, 5.0),
    (90.0, 1.0),
    // A place more on the left bound of the second lanelet.
    (70.0, 3.5),
    // Beside the first.
    (0.0, 6.0),
    (50.0, 6.0),
    (-40.0, 2.0),
];

fn way(id: i64, nodes: &[i64]) -> String {
    let nodes: String = nodes
        .iter()
        .map(|node| format!("<nd ref='{node}'/>"))
        .collect();
    format!("<way id='{id}'>{nodes}</way>")
}

fn lanelet(id: i64, left: i64, right: i64) -> String {
    format!(
        "<relation id='{id}'><member type='way' ref='{left}' role='left'/>\
         <member type='way' ref='{right}' role='right'/>\
         <member type='relation' ref='{id}' role='regulatory_element'/>\
         <tag k='type' v='lanelet'/></relation>"
    )
}

/// Two lanelets behind each other and one beside the first, in which a bound is drawn
/// backwards; the node writes a place in its own way.
fn map_of(node: impl Fn(i64, (f64, f64)) -> String) -> String {
    let nodes: String = PLACES
        .iter()
        .enumerate()
        .map(|(k, place)| node(k as i64 + 1, *place))
        .collect();
    let ways = [
        way(11, &[1, 3]),
        way(12, &[4, 2]),
        way(13, &[3, 7, 5]),
        way(14, &[4, 6]),
        way(15, &[9, 8]),
        // Nothing uses it, and it has a node that the file has not.
        way(16, &[1, 999]),
    ];
    let lanelets = [
        lanelet(101, 11, 12),
        lanelet(102, 13, 14),
        lanelet(103, 15, 11),
    ];
    format!(
        "<?xml version='1.0'?><osm version='0.6'>{nodes}{}{}\
         <relation id='200'><tag k='type' v='regulatory_element'/></relation></osm>",
        ways.concat(),
        lanelets.concat()
    )
}

fn local(x_tag: &str, y_tag: &str) -> String {
    map_of(|id, (x, y)| {
        format!(
            "<node id='{id}' lat='0' lon='0'><tag k='{x_tag}' v='{x}'/><tag k='{y_tag}' v='{y}'/></node>"
        )
    })
}

/// Metres of a degree of latitude and of longitude at 49 degrees north, on WGS 84.
const DEGREE_M: (f64, f64) = (111_209.0, 73_173.0);

fn geographic() -> String {
    map_of(|id, (x, y)| {
        let (latitude, longitude) = (49.0 + y / DEGREE_M.0, 8.4 + x / DEGREE_M.1);
        format!("<node id='{id}' visible='true' lat='{latitude:.11}' lon='{longitude:.11}'/>")
    })
}

fn read(text: &str) -> Result<Map, String> {
    Map::of(text, Path::new("map.osm"))
}

#[test]
fn a_route_goes_over_named_lanelets_or_successors() {
    let map = read(&local("local_x", "local_y")).expect("a map");
    assert_eq!(map.lanelets().collect::<Vec<_>>(), [101, 102, 103]);
    assert_eq!(map.place(49.0, 8.4), None);
    let named = map.over(&[101, 102]).expect("a route");
    let (start, goal) = (Point::new(5.0, 0.5), Point::new(85.0, 2.0));
    let found = map.between(start, goal).expect("a route");
    assert_eq!(named, found);
    assert!(!named.is_closed());
    assert!(
        (named.length_m() - 90.0).abs() < 0.3,
        "{}",
        named.length_m()
    );
    let (map_from_road, left_m, right_m) = named.at(25.0);
    assert!((map_from_road.translation.vector - Point::new(25.0, 0.0).coords).norm() < 1e-9);
    assert_eq!((left_m, right_m), (2.0, 2.0));
    // Its own row where the left bound has a place.
    assert_eq!(map.lanelets[&102].rows.len(), 3);
    assert_eq!(
        read(&local("x", "y"))
            .expect("a map")
            .over(&[101, 102])
            .expect("a route"),
        named
    );
}

#[test]
fn degrees_are_metres_to_the_east_and_north_of_a_node() {
    let map = read(&geographic()).expect("a map");
    let route = map.over(&[101, 102]).expect("a route");
    // The node with the least number is at (0, 2).
    let (map_from_road, left_m, _) = route.at(25.0);
    let place = map_from_road.translation.vector;
    assert!(
        (place - Point::new(25.0, -2.0).coords).norm() < 1e-3,
        "{place}"
    );
    assert!((left_m - 2.0).abs() < 1e-3);
    // A place 10 km away, by the length of the ellipsoid's arcs: the plane is 4 mm short.
    let north = map
        .place(49.0 + 10_000.0 / DEGREE_M.0, 8.4)
        .expect("a place");
    assert!((north.coords.norm() - 10_000.0).abs() < 10.0, "{north}");
    let east = map.place(49.0, 8.4 + 10.0 / DEGREE_M.1).expect("a place");
    assert!(
        (east.x - 10.0).abs() < 1e-3 && (east.y + 2.0).abs() < 1e-3,
        "{east}"
    );
}

#[test]
fn bounds_that_are_drawn_backwards_are_turned() {
    let text = local("x", "y");
    let turned = text
        .replace(&way(11, &[1, 3]), &way(11, &[3, 1]))
        .replace(&way(14, &[4, 6]), &way(14, &[6, 4]));
    let [plain, turned] = [text, turned].map(|text| read(&text).expect("a map"));
    // What is left of one lanelet is right of the one beside it.
    for ids in [vec![101, 102], vec![103]] {
        assert_eq!(
            plain.over(&ids).expect("a route"),
            turned.over(&ids).expect("a route")
        );
    }
}

#[test]
fn a_circle_of_lanelets_is_a_closed_route() {
    let ring = "<osm>\
        <node id='1' lat='0' lon='0'><tag k='x' v='12'/><tag k='y' v='0'/></node>\
        <node id='2' lat='0' lon='0'><tag k='x' v='16'/><tag k='y' v='0'/></node>\
        <node id='3' lat='0' lon='0'><tag k='x' v='-12'/><tag k='y' v='0'/></node>\
        <node id='4' lat='0' lon='0'><tag k='x' v='-16'/><tag k='y' v='0'/></node>\
        <node id='5' lat='0' lon='0'><tag k='x' v='0'/><tag k='y' v='12'/></node>\
        <node id='6' lat='0' lon='0'><tag k='x' v='0'/><tag k='y' v='16'/></node>\
        <node id='7' lat='0' lon='0'><tag k='x' v='0'/><tag k='y' v='-12'/></node>\
        <node id='8' lat='0' lon='0'><tag k='x' v='0'/><tag k='y' v='-16'/></node>";
    let ways = [
        way(11, &[1, 5, 3]),
        way(12, &[2, 6, 4]),
        way(13, &[3, 7, 1]),
        way(14, &[4, 8, 2]),
    ];
    let lanelets = [lanelet(21, 11, 12), lanelet(22, 13, 14)];
    let map = read(&format!(
        "{ring}{}{}</osm>",
        ways.concat(),
        lanelets.concat()
    ));
    let map = map.expect("a map");
    let round = map.over(&[21, 22]).expect("a route");
    assert!(round.is_closed());
    assert!((round.length_m() - 4.0 * 14.0 * 2.0_f64.sqrt()).abs() < 1e-9);
    // A search of a circle ends, with a way or without.
    let (start, goal) = (Point::new(13.0, 1.0), Point::new(13.0, -1.0));
    assert!(map.between(start, goal).is_ok());
    assert!(map.between(start, Point::new(500.0, 0.0)).is_err());
}

#[test]
fn what_gives_no_route_is_said_in_one_line() {
    let text = local("x", "y");
    let refused = |from: &str, to: &str, said: &str| {
        let text = text.replacen(from, to, 1);
        let error = read(&text).expect_err(said);
        assert!(
            error.contains(said) && error.lines().count() == 1,
            "{said}: {error}"
        );
    };
    refused(
        "<osm version='0.6'>",
        "<gpx>",
        "expected 'gpx' tag, not 'osm'",
    );
    refused(
        "<nd ref='3'/>",
        "<nd ref='77'/>",
        "lanelet 101: way 11: the file has no node 77",
    );
    refused(
        "ref='12' role",
        "ref='77' role",
        "lanelet 101: the file has no way 77",
    );
    refused(
        "type='way' ref='12'",
        "type='relation' ref='101'",
        "type=Some(\"relation\")",
    );
    refused(
        "role='right'",
        "role='left'",
        "left=\"more than one member\"",
    );
    refused("role='right'", "role='centerline'", "right=\"no member\"");
    refused("<nd ref='3'/>", "", "way 11 has fewer than two places");
    refused("<node id='2'", "<node id='1'", "two elements have the id 1");
    refused("<node id='1'", "<node id='one'", "<node> with id=\"one\"");
    refused("lat='0'", "lat='91'", "lat=91.0");
    refused("lat='0'", "lat='nan'", "lat=NaN");
    refused("k='x' v='0'", "k='x' v='inf'", "x=\"inf\"");
    refused(
        "<tag k='x' v='0'/>",
        "",
        "9 of 10 nodes have local coordinates",
    );
    refused(
        "v='50'",
        "v='5e7'",
        "is not a number of metres up to 1,000,000",
    );
    let error = read("<osm/>").expect_err("no lanelet");
    assert!(error.contains("it has no lanelet"), "{error}");
    let error = read("<commonRoad/>").expect_err("another format");
    assert!(error.contains("it is no OSM file"), "{error}");
}

#[test]
fn ways_that_lead_nowhere_are_refused() {
    let map = read(&local("x", "y")).expect("a map");
    let said = |route: Result<Route, RouteError>| route.expect_err("refused").to_string();
    assert!(said(map.over(&[])).contains("at least one lanelet"));
    assert!(said(map.over(&[101, 7])).contains("map.osm: no lanelet 7"));
    assert!(said(map.over(&[102, 101])).contains("lanelet 101 does not follow 102"));
    assert!(said(map.over(&[101, 103])).contains("does not follow"));
    let (first, beside) = (Point::new(5.0, 0.0), Point::new(20.0, 4.0));
    assert!(said(map.between(first, beside)).contains("changes of lanes are not planned"));
    assert!(
        said(map.between(Point::new(-90.0, 0.0), first)).contains("the start is on no lanelet")
    );
    assert!(said(map.between(first, Point::new(0.0, 90.0))).contains("the goal is on no lanelet"));
}

#[test]
fn hostile_files_are_refused() {
    let entities = "<!DOCTYPE osm [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;&a;'>]>";
    let hostile = local("x", "y").replace("<osm version", &format!("{entities}<osm version"));
    let error = read(&hostile).expect_err("refused");
    assert!(error.contains("DTD"), "{error}");
    // More elements than a map has, and elements in elements.
    let many = format!("<osm>{}</osm>", "<a/>".repeat(1 << 21));
    assert!(read(&many).expect_err("refused").contains("limit"));
    let deep = format!("<osm>{}", "<a>".repeat(100_000));
    assert!(read(&deep).is_err());
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("long.osm");
    let file = std::fs::File::create(&path).expect("a file");
    file.set_len(BYTES_MAX + 1).expect("its length");
    let error = Map::read(&path).expect_err("refused").to_string();
    assert!(error.contains("long.osm: is longer than"), "{error}");
}

#[test]
fn the_rows_of_lanelets_that_share_their_bounds_are_limited() {
    // Each lanelet has a row for each place of both bounds, so 2,048 of 32 bytes.
    let (places, lanelets) = (1024, 1 + ROWS_OF_MAP_MAX / 2048);
    let bound = |first: usize, y: i64| -> String {
        let node = |k: usize| {
            format!(
                "<node id='{}' lat='0' lon='0'><tag k='x' v='{k}'/><tag k='y' v='{y}'/></node>",
                first + k
            )
        };
        (0..places).map(node).collect()
    };
    let ids = |first: usize| -> Vec<i64> { (0..places).map(|k| (first + k) as i64).collect() };
    let text = |lanelets: usize| {
        let relations: String = (0..lanelets)
            .map(|k| lanelet(10_000 + k as i64, 1, 2))
            .collect();
        format!(
            "<osm>{}{}{}{}{relations}</osm>",
            bound(100, 2),
            bound(2000, -2),
            way(1, &ids(100)),
            way(2, &ids(2000))
        )
    };
    assert_eq!(read(&text(2)).expect("a map").lanelets().count(), 2);
    let error = read(&text(lanelets)).expect_err("refused");
    assert!(error.contains("more than 1048576 places"), "{error}");
}

#[test]
fn deleted_elements_are_not_read() {
    let text =
        local("x", "y").replace("<relation id='103'>", "<relation id='103' action='delete'>");
    let map = read(&text).expect("a map");
    assert_eq!(map.lanelets().collect::<Vec<_>>(), [101, 102]);
}

//! The server for Foxglove: a client subscribes and decodes, a slow one misses what is
//! counted, and a foreign one is refused.

#[allow(dead_code)] // the test of a living set uses the rest
mod viewer;

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use recorder::schema::ENCAPSULATION;
use serde_json::Value;
use shm_config::config::Config;
use shm_config::layout::Layout as _;
use shm_config::message::Step;
use view::live::foxglove::{Board, FoxgloveServer, Shown};
use viewer::{Viewer, pose};

fn serve(address: [u8; 4]) -> (FoxgloveServer, Arc<Board>) {
    let board = Arc::<Board>::default();
    let address = SocketAddr::from((address, 0));
    let server = FoxgloveServer::start(address, board.clone()).expect("a port");
    (server, board)
}

/// A step of a car that drives along x, with an observation and no plan.
fn step(tick: u64) -> Step {
    let mut step = Step::default();
    (step.header.tick, step.header.sequence) = (tick, tick);
    step.header.taken_ns = tick * 100_000_000;
    step.observation_age_ns = 1_000_000;
    let observation = &mut step.observation;
    observation.header = step.header;
    (observation.road.left_m, observation.road.right_m) = (5.0, 5.0);
    observation.checkpoints[0].x_body_m = 30.0;
    observation.checkpoints[1].x_body_m = 60.0;
    observation.ego.x_world_m = tick as f64;
    observation.ego.y_world_m = -2.5;
    observation.ego.heading_world_rad = 0.5;
    observation.beam_count = 4;
    observation.ranges_m[..4].copy_from_slice(&[50.0, 3.25, 50.0, 12.5]);
    step
}

#[test]
fn a_client_subscribes_and_decodes_what_comes() {
    let (server, board) = serve([127, 0, 0, 1]);
    let mut shown = Shown::new(board.clone(), &Config::default());
    // Without a client nothing is made.
    shown.step(&step(1));
    let mut viewer = Viewer::connect(&server.url(), &[]).expect("a connection");
    assert_eq!(viewer.info["name"], "vlaps");
    assert_eq!(viewer.info["capabilities"], serde_json::json!([]));
    let of = |viewer: &Viewer, topic: &str, key: &str| viewer.channels[topic][key].clone();
    assert_eq!(
        of(&viewer, "/ros/scene", "schemaName"),
        "visualization_msgs/msg/MarkerArray"
    );
    assert_eq!(of(&viewer, "/tf", "encoding"), "cdr");
    let schema = of(&viewer, "/ros/pose", "schema");
    let schema = schema.as_str().expect("a schema");
    assert!(schema.contains("MSG: geometry_msgs/Pose\n"), "{schema}");
    viewer.subscribe(7, "/ros/pose");
    viewer.subscribe(8, "/step");
    viewer.patience(Duration::from_millis(100));
    // It hears of steps once its request has arrived.
    let mut tick = 1;
    let (mut poses, mut steps) = (Vec::new(), Vec::new());
    while poses.is_empty() || steps.is_empty() {
        tick += 1;
        shown.step(&step(tick));
        while let Some((id, _, cdr)) = viewer.data() {
            if id == 7 { &mut poses } else { &mut steps }.push(cdr);
        }
    }
    let ([x, y], heading, frame) = pose(poses.last().expect("a pose"));
    assert_eq!((x, y, frame.as_str()), (tick as f64, -2.5, "map"));
    assert!((heading - 0.5).abs() < 1e-12, "{heading}");
    let cdr = steps.last().expect("a step");
    let got = Step::from_bytes(&cdr[ENCAPSULATION.len()..]).expect("a step");
    assert_eq!(got.as_bytes(), step(tick).as_bytes());
    // No more after it unsubscribes; what a client may not ask is refused in words.
    viewer.ask(&serde_json::json!({"op": "unsubscribe", "subscriptionIds": [7, 8]}));
    viewer.ask(&serde_json::json!({"op": "setParameters", "parameters": []}));
    let refused = viewer.text();
    assert_eq!(
        (&refused["op"], &refused["level"]),
        (&"status".into(), &1.into())
    );
    shown.step(&step(tick + 1));
    assert_eq!(viewer.data(), None);
    drop(viewer);
}

#[test]
fn a_client_that_does_not_read_delays_no_other_and_its_losses_are_counted() {
    let (server, board) = serve([127, 0, 0, 1]);
    let mut shown = Shown::new(board.clone(), &Config::default());
    let [mut quick, mut stalled] =
        [(); 2].map(|()| Viewer::connect(&server.url(), &[]).expect("a connection"));
    for viewer in [&mut quick, &mut stalled] {
        viewer.subscribe(1, "/step");
        viewer.subscribe(2, "/ros/scene");
        viewer.patience(Duration::from_secs(5));
    }
    // Until both have subscribed, and the buffers of the stalled one are full: 20 MB.
    let tick_of = |cdr: &[u8]| {
        let step = Step::from_bytes(&cdr[ENCAPSULATION.len()..]).expect("a step");
        step.header.tick
    };
    let mut first = None;
    for tick in 1..=4_000 {
        shown.step(&step(tick));
        // It gets each step in its turn, while the other one reads nothing.
        let mut came = false;
        while let Some((id, _, cdr)) = quick.data() {
            came = id == 1 && tick_of(&cdr) == tick;
            if came {
                first.get_or_insert(tick);
                break;
            }
        }
        assert!(came || first.is_none(), "step {tick} did not come");
    }
    assert!(first.is_some());
    // The stalled one wakes up: it gets what was under way, and then the newest.
    let mut got = Vec::new();
    while got.last() != Some(&4_000) {
        let (id, _, cdr) = stalled.data().expect("the newest comes at last");
        if id == 1 {
            got.push(tick_of(&cdr));
        }
    }
    assert!(got.is_sorted());
    let missed = 4_000 - got.len() as u64;
    let (sent, skipped) = board.counts();
    assert!(missed > 100, "{missed} missed");
    assert!(
        skipped >= missed - got[0],
        "{skipped} counted, {missed} missed"
    );
    assert!(sent > 4_000, "{sent}");
}

#[test]
fn a_foreign_page_and_an_address_without_its_token_are_refused() {
    let (near, _board) = serve([127, 0, 0, 1]);
    let refused = |url: &str, origin: &str| Viewer::connect(url, &[("origin", origin)]).err();
    assert_eq!(refused(&near.url(), "https://evil.example"), Some(403));
    assert_eq!(refused(&near.url(), "https://app.foxglove.dev"), None);
    assert_eq!(
        refused(&format!("{}more", near.url()), "file://"),
        Some(404)
    );
    let (open, _board) = serve([0, 0, 0, 0]);
    let url = open.url().replace("0.0.0.0", "127.0.0.1");
    assert_eq!(refused(&url, "https://anywhere.example"), None);
    let (bare, token) = url
        .rsplit_once("//")
        .expect("a scheme")
        .1
        .split_once('/')
        .expect("a path");
    assert_eq!(token.len(), 33, "{token}");
    assert_eq!(refused(&format!("ws://{bare}/"), "file://"), Some(403));
}

/// The topics in the strings of a layout: `/ros/scene`, `/step.command.steer`.
fn topics(value: &Value, into: &mut Vec<String>) {
    let mut note = |text: &str| {
        if let Some(rest) = text.strip_prefix('/') {
            let end = rest.find(['.', '[']).unwrap_or(rest.len());
            into.push(format!("/{}", &rest[..end]));
        }
    };
    match value {
        Value::String(text) => note(text),
        Value::Array(all) => all.iter().for_each(|one| topics(one, into)),
        Value::Object(fields) => {
            fields.keys().for_each(|key| note(key));
            fields.values().for_each(|one| topics(one, into));
        }
        _ => {}
    }
}

#[test]
fn the_layout_shows_topics_that_exist() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/foxglove-layout.json");
    let text = std::fs::read_to_string(path).expect("the layout");
    let layout: Value = serde_json::from_str(&text).expect("JSON");
    let panels = layout["configById"].as_object().expect("panels");
    let mut named = Vec::new();
    topics(&layout["configById"], &mut named);
    let board = Board::default();
    let known: Vec<_> = board.channels().iter().map(|one| one.topic()).collect();
    for topic in &named {
        assert!(known.contains(topic), "{topic}: {known:?}");
    }
    for topic in [
        "/ros/scene",
        "/ros/scan",
        "/ros/plan",
        "/ros/picture",
        "/step",
    ] {
        assert!(named.iter().any(|one| one == topic), "{topic}: {named:?}");
    }
    // Each panel of the mosaic has a configuration.
    let mosaic = layout["layout"].to_string();
    assert!(panels.keys().all(|panel| mosaic.contains(panel.as_str())));
}

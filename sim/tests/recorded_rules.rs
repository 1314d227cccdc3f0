//! Route, road edges, sidewalks and arrival, fed with recorded poses: every
//! tick of every recorded drive must be judged as it was.

mod recorded;

use recorded::Rollout;
use sim::contact::{Placed, Shape};
use sim::navigation::Navigator;
use sim::rules::{Edges, has_arrived};
use sim::{World, WorldConfig};
use vehicle::{Footprint, Point, Vector};

const TOLERANCE_M: f64 = 1e-3;

#[derive(Debug, Default)]
struct Differences {
    ticks: usize,
    edges: Vec<String>,
    completion: Vec<String>,
    checkpoint: Vec<String>,
    on_lane: Vec<String>,
    sidewalk: Vec<String>,
    arrived: Vec<String>,
    out_of_road: Vec<String>,
}

#[test]
fn recorded_drives_are_judged_as_they_were() {
    let Some(folder) = recorded::folder() else {
        return;
    };
    let mut world = World::new(WorldConfig::default()).expect("the default world");
    let mut found = Differences::default();
    for kind in ["idm", "wave"] {
        for seed in recorded::FIRST_SEED..recorded::FIRST_SEED + recorded::SEEDS {
            let rollout = Rollout::read(&folder, kind, seed);
            world.reset(seed).expect("a recorded seed has a map");
            judge(&world, kind, &rollout, &mut found);
        }
    }
    println!("{} ticks", found.ticks);
    assert!(found.ticks > 30_000, "every drive was read");
    for (name, list) in [
        ("edges", &found.edges),
        ("completion", &found.completion),
        ("checkpoint", &found.checkpoint),
        ("on lane", &found.on_lane),
        ("sidewalk", &found.sidewalk),
        ("arrived", &found.arrived),
        ("out of road", &found.out_of_road),
    ] {
        assert!(list.is_empty(), "{name}: {} differ: {list:?}", list.len());
    }
}

fn judge(world: &World, kind: &str, rollout: &Rollout, found: &mut Differences) {
    let network = &world.map().network;
    let mut navigator: Navigator = world.navigator().clone();
    let model = world.ego_car().model;
    for (tick, row) in rollout.ego.iter().enumerate() {
        let [
            x,
            y,
            heading_rad,
            _,
            _,
            _,
            left_m,
            right_m,
            completion,
            checkpoint,
            on_lane,
        ] = *row;
        let position = Point::new(x, y);
        let forward = Vector::new(heading_rad.cos(), heading_rad.sin());
        if tick > 0 {
            navigator.update(network, position, forward);
        }
        found.ticks += 1;
        let here = format!("{kind} {} tick {tick}", rollout.seed);
        let edges = Edges::of(network, &navigator, position);
        if (edges.left_m - left_m)
            .abs()
            .max((edges.right_m - right_m).abs())
            > TOLERANCE_M
        {
            let ours = (edges.left_m, edges.right_m);
            found
                .edges
                .push(format!("{here}: {ours:?} for {:?}", (left_m, right_m)));
        }
        let off_m = (navigator.completion() - completion).abs() * navigator.length_m();
        if off_m > TOLERANCE_M {
            found.completion.push(format!("{here}: {off_m} m"));
        }
        if navigator.roads_done() != checkpoint as usize {
            found.checkpoint.push(here.clone());
        }
        if navigator.is_on_lane() != (on_lane != 0.0) {
            found.on_lane.push(here.clone());
        }
        let Some(flags) = tick.checked_sub(1).map(|before| rollout.flags[before]) else {
            continue;
        };
        let car = Placed {
            shape: Shape::Box(Footprint {
                length_m: model.length_m,
                width_m: model.width_m,
            }),
            center_world: position,
            forward_world: forward,
        };
        let on_sidewalk = world.sidewalks().touch(&car);
        if on_sidewalk != flags[2] {
            found.sidewalk.push(format!("{here}: {on_sidewalk}"));
        }
        if has_arrived(network, &navigator, position) != flags[4] {
            found.arrived.push(here.clone());
        }
        let out = !navigator.is_on_lane() || on_sidewalk || edges.is_outside();
        if out != flags[3] {
            found.out_of_road.push(format!("{here}: {out}"));
        }
    }
}

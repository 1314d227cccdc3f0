//! Compares route, road edges, sidewalks and arrival: our rules evaluate every tick of
//! every recorded drive at the recorded pose.

use sim::World;
use sim::contact::{Placed, Shape};
use sim::navigation::Navigator;
use sim::rules::{Edges, has_arrived};
use vehicle::{Footprint, Point, Vector};

use super::record::{Judged, Rollout};
use super::{Row, Tally, Unit};

/// Limit of distance errors, m.
const BAR_M: f64 = 1e-3;

/// Compares all drives of a kind.
pub(super) fn rows(
    kind: &str,
    rollouts: &[Rollout],
    world: &mut World,
) -> anyhow::Result<Vec<Row>> {
    let (mut ways, mut verdicts) = (Tally::default(), Tally::default());
    for rollout in rollouts {
        world.reset(rollout.seed)?;
        judge(world, rollout, &mut ways, &mut verdicts);
        ways.end_of(rollout.seed);
        verdicts.end_of(rollout.seed);
    }
    let what = |what: &str| format!("{kind} drives: {what}");
    Ok(vec![
        Row::largest(&what("edges, way done"), ways, Unit::M, BAR_M),
        Row::largest(
            &what("road, lane, sidewalk, end"),
            verdicts,
            Unit::Count,
            0.0,
        ),
    ])
}

fn judge(world: &World, rollout: &Rollout, ways: &mut Tally, verdicts: &mut Tally) {
    let network = &world.map().network;
    let mut navigator: Navigator = world.navigator().clone();
    let model = world.ego_car().model;
    for (tick, ego) in rollout.ego.iter().enumerate() {
        let [x, y] = ego.position;
        let position = Point::new(x, y);
        let forward = Vector::new(ego.heading_rad.cos(), ego.heading_rad.sin());
        if tick > 0 {
            navigator.update(network, position, forward);
        }
        let edges = Edges::of(network, &navigator, position);
        let [left_m, right_m] = ego.edges_m;
        let way_m = (navigator.completion() - ego.completion).abs() * navigator.length_m();
        let error_m = (edges.left_m - left_m)
            .abs()
            .max((edges.right_m - right_m).abs())
            .max(way_m);
        ways.count(Some(error_m), BAR_M);
        let mut same =
            navigator.roads_done() == ego.roads_done && navigator.is_on_lane() == ego.on_lane;
        if let Some(before) = tick.checked_sub(1) {
            let car = Placed {
                shape: Shape::Box(Footprint {
                    length_m: model.length_m,
                    width_m: model.width_m,
                }),
                center_world: position,
                forward_world: forward,
            };
            let sidewalk = world.sidewalks().touch(&car);
            let recorded = rollout.judged[before];
            let ours = Judged {
                sidewalk,
                out_of_road: !navigator.is_on_lane() || sidewalk || edges.is_outside(),
                arrived: has_arrived(network, &navigator, position),
                // A pose alone does not determine the contacts.
                ..recorded
            };
            same &= ours == recorded;
        }
        verdicts.count(same.then_some(0.0), 0.0);
    }
}

//! Recorded actions driven again in this world, everything else left to it.

mod recorded;

use recorded::Rollout;
use shm_config::message::Observation;
use sim::{World, WorldConfig};
use vehicle::Action;

/// After how many ticks to look, and how far from the record the median drive
/// may be by then, m.
const BARS: [(usize, f64); 3] = [(10, 0.1), (30, 0.5), (50, 1.5)];

#[test]
fn recorded_actions_lead_where_they_led() {
    let Some(folder) = recorded::folder() else {
        return;
    };
    let mut world = World::new(WorldConfig::default()).expect("the default world");
    let mut observation = Observation::default();
    let mut features = [0.0_f32; 259];
    for kind in ["wave", "idm"] {
        let mut away_m: [Vec<f64>; 3] = Default::default();
        let mut feature_error: [Vec<f64>; 3] = Default::default();
        for seed in recorded::FIRST_SEED..recorded::FIRST_SEED + recorded::SEEDS {
            let rollout = Rollout::read(&folder, kind, seed);
            world.reset(seed).expect("a recorded seed has a map");
            for tick in 0..rollout.act.len().min(50) {
                let [steer, pedal] = rollout.act[tick];
                world.step(Action { steer, pedal });
                let Some(slot) = BARS.iter().position(|&(ticks, _)| ticks == tick + 1) else {
                    continue;
                };
                let [x, y, ..] = rollout.ego[tick + 1];
                let ego = world.ego_position();
                away_m[slot].push((ego.x - x).hypot(ego.y - y));
                world.observe(&mut observation);
                observation
                    .features(&mut features)
                    .expect("259 features fit");
                let errors = features.iter().zip(&rollout.obs[tick + 1]);
                let worst = errors
                    .map(|(a, b)| f64::from((a - b).abs()))
                    .fold(0.0, f64::max);
                feature_error[slot].push(worst);
            }
        }
        for (((ticks, bar_m), away), errors) in BARS.iter().zip(&mut away_m).zip(&mut feature_error)
        {
            let (away_m, error) = (median(away), median(errors));
            println!(
                "{kind} after {ticks} ticks: {} drives, median {away_m:.4} m off (bar {bar_m}), \
                 worst feature off by {error:.4} in the median",
                away.len()
            );
            assert!(away.len() > 40, "{kind}: nearly all drives last so long");
            assert!(away_m < *bar_m, "{kind} after {ticks} ticks: {away_m} m");
        }
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

//! A plan over the iterations of RRT*.

use planner::Planner;
use shm_config::config::Config;
use shm_config::config::planner::Method;
use shm_config::message::Plan;
use stack::driver::DriverKind;
use stack::scene;

use super::sweep::{Bench, Cost};

/// Iterations; 200 is the paper's number.
pub const VALUES: [u64; 8] = [25, 50, 100, 200, 400, 800, 1600, 3200];
/// Every so many of the checked-in scenes is planned for.
const STRIDE: usize = 20;

/// Measures a plan, mean over scenes.
///
/// # Errors
/// If the scenes cannot be read.
pub fn measure(value: u64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    let mut config = DriverKind::of_method(Method::RrtStar).configure(&Config::default());
    config.planner.iterations = u32::try_from(value)?;
    let mut planner = Planner::new(&config)?;
    let mut plan = Box::<Plan>::default();
    let scenes: Vec<_> = scene::checked_in()?.into_iter().step_by(STRIDE).collect();
    let turns = bench.turns(|| {
        let mut core_s = 0.0;
        for scene in &scenes {
            scene.prepare(&mut planner, &mut plan);
            core_s += bench.core_s(|| planner.plan(&scene.observation, &mut plan));
        }
        Ok(core_s * 1e6 / scenes.len() as f64)
    })?;
    Ok(turns.map(|turns| Cost {
        work: value as f64,
        turns,
        late: None,
    }))
}

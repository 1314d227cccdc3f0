//! The sections of the configuration that decide how a set drives and what it learns. The
//! others say where it runs, and what watches it.

/// By name, as in the configuration's file.
pub const DECISIVE: [&str; 15] = [
    "limits",
    "deadlines",
    "vehicle",
    "scanner",
    "world",
    "planner",
    "informed",
    "kinodynamic",
    "mpc",
    "controller",
    "safety",
    "faulty_judge",
    "gate",
    "policy",
    "learner",
];

/// Keys of these sections that say only how long this machine waits for a process: a slower
/// machine may wait longer.
pub const WAITS: [&str; 2] = ["limits.lockstep_wait_s", "limits.learner_wait_s"];

/// Keys of the section `run` that decide which episodes a training drives. `run.shuffle` is
/// apart: a training that continues shifts it.
pub const EPISODES: [&str; 3] = ["seed", "seeds", "episodes"];

#[cfg(test)]
mod tests {
    use shm_config::config::Config;
    use toml::Table;

    use super::{DECISIVE, EPISODES, WAITS};

    #[test]
    fn the_decisive_sections_and_keys_exist() {
        let all = Table::try_from(Config::default()).expect("a table");
        for section in DECISIVE {
            assert!(all.contains_key(section), "{section}");
        }
        for key in EPISODES.map(|key| format!("run.{key}")) {
            assert!(has(&all, &key), "{key}");
        }
        for key in WAITS {
            assert!(has(&all, key), "{key}");
            let section = key.split('.').next().expect("a section");
            assert!(DECISIVE.contains(&section), "{key}");
        }
    }

    fn has(all: &Table, key: &str) -> bool {
        let (section, key) = key.split_once('.').expect("a section and a key");
        all[section].get(key).is_some()
    }
}

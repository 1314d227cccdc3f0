//! The sections of the configuration that decide how a set drives and what it learns. The
//! others say where it runs, and what watches it.

/// By name, as in the configuration's file.
pub const DECISIVE: [&str; 13] = [
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

#[cfg(test)]
mod tests {
    use shm_config::config::Config;
    use toml::Table;

    use super::DECISIVE;

    #[test]
    fn the_decisive_sections_exist() {
        let all = Table::try_from(Config::default()).expect("a table");
        for section in DECISIVE {
            assert!(all.contains_key(section), "{section}");
        }
    }
}

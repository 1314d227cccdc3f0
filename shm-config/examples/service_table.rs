//! Writes the service table's page and picture into `docs/`.

use std::path::Path;

use shm_config::services;

fn main() -> std::io::Result<()> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    std::fs::write(docs.join("services.md"), services::markdown())?;
    std::fs::write(docs.join("data-flow.svg"), services::picture())
}

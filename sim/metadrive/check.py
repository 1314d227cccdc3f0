"""Makes an installed MetaDrive run without its model files, and checks that it does.

Without a screen the simulator looks at two of its asset files only; a stub of
them keeps it from fetching the whole archive at its first reset.
"""

import pathlib
import sys
from importlib.util import find_spec

# The experiment's world, as `shm-config/src/config/world.rs` defaults to it.
EXPERIMENT = {
    "sequence": "",
    "blocks": 3,
    "lanes": 3,
    "lane_width_m": 3.5,
    "traffic_density": 0.06,
    "accident_probability": 0.8,
    "horizon_ticks": 1500,
}
SCANNER = {"beams": 240, "range_m": 50.0}
# A picture that is only asked for by name.
TEXTURE = "textures/grass1/GroundGrassGreen002_COL_1K.jpg"


def stub_assets():
    """Writes the two files, unless the real assets are there; the folder."""
    spec = find_spec("metadrive")
    if spec is None or spec.origin is None:
        sys.exit("the package metadrive-simulator is not installed")
    from metadrive.version import VERSION

    assets = pathlib.Path(spec.origin).parent / "assets"
    texture, version = assets / TEXTURE, assets / "version.txt"
    texture.parent.mkdir(parents=True, exist_ok=True)
    if not texture.exists():
        texture.touch()
    if not version.exists() or version.read_text().strip() != VERSION:
        version.write_text(VERSION)
    return VERSION


def main():
    version = stub_assets()
    import iceoryx2  # noqa: F401 (it must load)
    import wire_layout as layout
    from environment import World
    from score import BRAKE

    world = World(EXPERIMENT, SCANNER)
    world.reset(0)
    world.step(BRAKE)
    observation = layout.Observation()
    world.observe(observation)
    world.close()
    print(f"MetaDrive {version} resets and steps; its lidar has {observation.beam_count} beams")


if __name__ == "__main__":
    main()

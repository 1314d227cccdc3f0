"""What `./vlaps setup f1tenth` checks: the road of a map, one step, one scan, and the library.
Compiles the gym's simulator, so that the world starts at once."""

import sys

from track import chosen_map, track

import numba
import numpy as np
from car import ROOT, Car, Scanner, settings_of
from episodes import process
from scene import SUB_STEP_S, Scene, parameters, scan_simulator, simulator

setting = settings_of(ROOT / "vehicles" / "car-1-10.toml")
car, scanner, path = Car.of(setting), Scanner.of(setting), chosen_map()
route = track(path)
made = simulator(str(path), parameters(car), SUB_STEP_S)
scene = Scene(made, scan_simulator(str(path), scanner), route, car, scanner, 0)
scene.advance(0.0, 1.0, 0.1)
ranges_m = scene.ranges_m()
if not (scene.speed_mps > 0 and np.all(ranges_m <= scanner.range_m) and np.any(ranges_m < scanner.range_m)):
    sys.exit(f"a step of 0.1 s gives {scene.speed_mps} m/s and ranges from {ranges_m.min()} m on")
# Looked up in the library, which is loaded for it.
process.Observation
print(
    f"{path.name}: a road of {route.length_m:.0f} m; numba {numba.__version__} on Python "
    f"{sys.version.split()[0]}: the gym drives and scans"
)

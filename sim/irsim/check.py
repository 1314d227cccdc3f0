"""What `./vlaps setup ir-sim` checks: one scene, one step, and the library."""

import sys

import numpy as np
from course import draw

from car import DEFAULT_FILE, Car, Scanner, settings_of
from scene import SUB_STEP_S, Scene
from episodes import process

# After `scene`, which loads it without its messages.
import irsim

setting = settings_of(DEFAULT_FILE)
car, scanner = Car.of(setting), Scanner.of(setting)
scene = Scene(draw(0, car), car, scanner, 0, SUB_STEP_S)
scene.advance(0.0, 1.0, 0.1)
ranges_m = scene.ranges_m()
if not (scene.speed_mps > 0 and np.all(ranges_m <= scanner.range_m) and np.any(ranges_m < scanner.range_m)):
    sys.exit(f"a step of 0.1 s gives {scene.speed_mps} m/s and ranges from {ranges_m.min()} m on")
# Looked up in the library, which is loaded for it.
process.Observation
print(f"ir-sim {irsim.__version__} on Python {sys.version.split()[0]}: it drives and scans")

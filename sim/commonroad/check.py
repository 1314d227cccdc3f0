"""What `./vlaps setup commonroad` checks: the scenarios, one step, one scan, and the library."""

import sys
from importlib.metadata import version

from files import problems

import numpy as np
from car import DEFAULT_FILE, Car, Scanner, settings_of
from episodes import process
from scene import SUB_STEP_S, Scene, drivable

setting = settings_of(DEFAULT_FILE)
car, scanner = Car.of(setting), Scanner.of(setting)
found = drivable(problems(), car, scanner)
scene = Scene(found[0], car, scanner, 0, SUB_STEP_S)
scene.advance(0.0, 1.0, 0.1)
ranges_m = scene.ranges_m()
if not (scene.speed_mps > found[0].speed_mps and np.all(ranges_m <= scanner.range_m)):
    sys.exit(f"a step of 0.1 s gives {scene.speed_mps} m/s and ranges up to {ranges_m.max()} m")
# Looked up in the library, which is loaded for it.
process.Observation
names = "commonroad-io", "commonroad-drivability-checker"
print(
    f"{len(found)} scenarios; " + ", ".join(f"{name} {version(name)}" for name in names)
    + f" on Python {sys.version.split()[0]}: they drive and scan"
)

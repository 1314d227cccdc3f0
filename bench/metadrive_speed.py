"""Drives the real MetaDrive as fast as possible on one core and prints its speed.

Called by `./vlaps bench sim` with the folder of the world's Python files as
the first argument and the task, as JSON, as the second. Prints one JSON object.
"""

import json
import math
import os
import sys
import time

# One core, as in the row of the built-in world.
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", SDL_VIDEODRIVER="dummy")

sys.path.insert(0, sys.argv[1])
import environment  # noqa: E402  (found through the argument)

# Ranges by which the simulator scales the features that are used below.
SPEED_MAX_KMH = 81.0
OFFSET_RANGE_M = 4.5


def keep_lane(features):
    """Keeps the lane at 8 m/s, using only the observation's features."""
    heading_rad = math.asin(min(max(1.0 - 2.0 * features[2], -1.0), 1.0))
    speed_mps = (features[3] * SPEED_MAX_KMH - 1.0) / 3.6
    offset_m = (0.5 - features[8]) * OFFSET_RANGE_M
    steer = -(0.8 * heading_rad + 0.12 * offset_m)
    pedal = 0.3 * (8.0 - speed_mps)
    return [min(max(steer, -1.0), 1.0), min(max(pedal, -1.0), 1.0)]


def main():
    task = json.loads(sys.argv[2])
    world = environment.World(task["world"], task["scanner"])
    # The first reset creates the engine and is not measured.
    world.reset(task["first_seed"])
    steps, resets_s = 0, []
    begun, core_begun = time.monotonic(), time.process_time()
    while time.monotonic() - begun < task["seconds"]:
        before = time.monotonic()
        world.reset(task["first_seed"] + len(resets_s) % 1000)
        resets_s.append(time.monotonic() - before)
        outcome = environment.layout.Outcome.DRIVING
        while outcome == environment.layout.Outcome.DRIVING:
            outcome = world.step(keep_lane(world.features)).outcome
            steps += 1
    seconds = time.monotonic() - begun
    core_s = time.process_time() - core_begun
    world.close()
    print(
        json.dumps(
            {
                "steps": steps,
                "episodes": len(resets_s),
                "seconds": seconds,
                "core_s": core_s,
                "reset_mean_us": sum(resets_s) / len(resets_s) * 1e6,
                "reset_worst_us": max(resets_s) * 1e6,
            }
        )
    )


main()

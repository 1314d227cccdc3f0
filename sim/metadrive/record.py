"""Drives an episode and prints, tick by tick, what a message would carry beside the
simulator's own observation. For the test that compares the two.

    python sim/metadrive/record.py --seed 1000 --ticks 200 --after 1003
"""

import argparse
import json
import random

import wire_layout as layout
from environment import World
from check import EXPERIMENT, SCANNER


def drive(observation, wobble):
    """A lane-keeping driver that holds 6 m/s, disturbed so that much is seen."""
    road = observation.road
    steer = -0.9 * road.heading_rad - 0.08 * road.offset_m + wobble.uniform(-0.15, 0.15)
    pedal = 0.3 * (6.0 - observation.ego.speed_mps) + wobble.uniform(-0.2, 0.2)
    return max(-1.0, min(1.0, steer)), max(-1.0, min(1.0, pedal))


def line(world, observation):
    def values(message):
        return [getattr(message, name) for name, _ in message._fields_]

    return json.dumps(
        {
            "ego": values(observation.ego),
            "road": values(observation.road),
            "checkpoints": [values(checkpoint) for checkpoint in observation.checkpoints],
            "lidar_max_m": observation.lidar_max_m,
            "ranges_m": observation.ranges_m[: observation.beam_count],
            "features": [float(value) for value in world.features],
            "lanes": world.vehicle.navigation.get_current_lane_num(),
        }
    )


def episode(world, seed, ticks, say):
    """Drives an episode, or its first ticks, and prints each tick."""
    world.reset(seed)
    wobble = random.Random(seed)
    observation = layout.Observation()
    outcome = layout.Outcome.DRIVING
    for _ in range(ticks):
        world.observe(observation)
        say(line(world, observation))
        if outcome != layout.Outcome.DRIVING:
            break
        outcome = world.step(drive(observation, wobble)).outcome


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--ticks", type=int, required=True)
    parser.add_argument("--after", type=int, help="seed of an episode to drive before")
    arguments = parser.parse_args()
    world = World(EXPERIMENT, SCANNER)
    if arguments.after is not None:
        episode(world, arguments.after, arguments.ticks, lambda line: None)
    episode(world, arguments.seed, arguments.ticks, print)
    world.close()


if __name__ == "__main__":
    main()

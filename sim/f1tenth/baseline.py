"""The gym's own example driver, pure pursuit along way points, from the same begins.

    target/f1tenth/bin/python sim/f1tenth/baseline.py --episodes 10

On the map of the gym's example it follows the example's race line at the speeds of its file;
on another map, named by VLAPS_F1TENTH_MAP, the middle line at the speed of --speed. It is
given the car's true pose a hundred times a second.
"""

import argparse
from pathlib import Path

from gym_code import CHECKOUT, example_driver
from track import EXAMPLE_MAP, chosen_map, track

import numpy as np
import yaml
from car import Car, settings_of
from route import Route
from scene import GYM_CAR, LAPS, SUB_STEP_S, Lap, begin, parameters, simulator

#: The car of the gym's environment, where no vehicle file is named.
OWN_CAR = GYM_CAR | {
    "lf": 0.15875,
    "lr": 0.17145,
    "s_min": -0.4189,
    "s_max": 0.4189,
    "a_max": 9.51,
    "v_max": 20.0,
    "width": 0.31,
    "length": 0.58,
}
#: The look-ahead of the gym's example, m, and its factor on the speeds of the way points.
LOOK_AHEAD_M, GAIN = 0.82461887897713965, 1.375
#: The longest drive, s: two laps of the longest map at walking speed.
HORIZON_S = 600.0


def driver_of(path: Path, route: Route, speed_mps: float):
    """The example's driver with its own way points, or with the middle line."""
    module = example_driver()
    described = yaml.safe_load((CHECKOUT / "examples" / "config_example_map.yaml").read_text())
    described["wpt_path"] = str(CHECKOUT / "examples" / "example_waypoints.csv")
    driver = module.PurePursuitPlanner(argparse.Namespace(**described), OWN_CAR["lf"] + OWN_CAR["lr"])
    if path != EXAMPLE_MAP:
        driver.waypoints = np.zeros((len(route.places), 6))
        driver.waypoints[:, [described["wpt_xind"], described["wpt_yind"]]] = route.places
        driver.waypoints[:, described["wpt_vind"]] = speed_mps
    return driver


def drive(driver, made, route: Route, seed: int, gain: float) -> tuple[str, Lap]:
    """Drives one episode: how it ended, and its laps."""
    begin(made, route, seed)
    state = made.agents[0].state
    lap = Lap(route, *state[:2])
    while lap.elapsed_s < HORIZON_S:
        speed_mps, steer_rad = driver.plan(state[0], state[1], state[4], LOOK_AHEAD_M, gain)
        made.step(np.array([[steer_rad, speed_mps]]))
        state = made.agents[0].state
        lap.go(*state[:2], SUB_STEP_S)
        if made.collisions[0]:
            return "wall", lap
        if len(lap.laps_s) >= LAPS:
            return "arrived", lap
    return "max_step", lap


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--vehicle", type=Path, help="vehicle file of the car; default: the gym's own car")
    parser.add_argument("--seed", type=int, default=1000, help="seed of the first episode")
    parser.add_argument("--episodes", type=int, default=10, help="number of episodes")
    parser.add_argument("--speed", type=float, default=5.0, help="speed on the middle line, m/s")
    parser.add_argument("--gain", type=float, default=GAIN, help="factor on the example's speeds")
    arguments = parser.parse_args()
    path = chosen_map()
    route = track(path)
    values = parameters(Car.of(settings_of(arguments.vehicle))) if arguments.vehicle else OWN_CAR
    made = simulator(str(path), values, SUB_STEP_S)
    driver = driver_of(path, route, arguments.speed)
    gain = arguments.gain if path == EXAMPLE_MAP else 1.0
    ends, laps_s = dict.fromkeys(("arrived", "wall", "max_step"), 0), []
    print("seed   outcome    laps, s")
    for seed in range(arguments.seed, arguments.seed + arguments.episodes):
        ended, lap = drive(driver, made, route, seed, gain)
        ends[ended] += 1
        laps_s += lap.laps_s
        print(f"{seed:<6} {ended:<10} " + " ".join(f"{lap_s:.2f}" for lap_s in lap.laps_s), flush=True)
    mean = f"mean lap {np.mean(laps_s):.2f} s" if laps_s else "no lap"
    print(f"{path.stem}, {arguments.episodes} episodes: " + ", ".join(f"{word} {count}" for word, count in ends.items()) + f"; {mean}")


if __name__ == "__main__":
    main()

"""A simple driver in the same scenarios: along the middle line, behind what is ahead on it.

    target/commonroad/bin/python sim/commonroad/baseline.py --vehicle vehicles/metadrive.toml

commonroad-io has no driver, and its scenarios leave out the vehicle that was recorded in the
car's place. This one is given the truth: the line, and place and speed of each obstacle. It
steers by pure pursuit and chooses its speed by the Intelligent Driver Model; with
`--speed-by keep` it holds the speed that it begins with and looks at nothing.
"""

import argparse
import math
from pathlib import Path

from files import problems

import numpy as np
import shapely
from car import Car, Scanner, settings_of
from problem import Problem
from route import from_pose
from scene import SUB_STEP_S, Scene, drivable

#: Pure pursuit looks this far ahead, m, and this many seconds of its way.
LOOK_MIN_M, LOOK_S = 4.0, 0.6
#: IDM: time gap, s, gap at a stand, m, and comfortable brake, m/s2.
GAP_S, GAP_M, BRAKE_MPS2 = 1.0, 2.0, 3.0
#: The speed that is wanted is that of the begin, but at least this, m/s.
SPEED_MIN_MPS = 6.0
#: What is nearer to the line than half the car and this is ahead, m.
ASIDE_M = 0.2
#: What is farther away is not looked at, m.
FAR_M = 100.0
#: Time between two choices, s, as in a run.
TICK_S = 0.1


def pursued(scene: Scene) -> float:
    """The steering of pure pursuit."""
    look_m = max(LOOK_MIN_M, LOOK_S * scene.speed_mps) + scene.car.wheelbase_m / 2
    target = scene.problem.route.at(scene.along_m + look_m)
    rear = (*map(float, scene.state[:2]), float(scene.state[4]))
    ahead_m, left_m = from_pose(rear, *target[:2])
    angle_rad = math.atan2(2 * scene.car.wheelbase_m * left_m, ahead_m**2 + left_m**2)
    return max(-1.0, min(1.0, angle_rad / scene.car.max_steer_rad))


def ahead(scene: Scene) -> tuple[float, float]:
    """Gap to the next obstacle on the line, m, and its speed along it, m/s."""
    problem, best = scene.problem, (math.inf, 0.0)
    later = {number: shape.centroid for number, _, shape in problem.numbered(scene.step + 1)}
    for number, _, shape in problem.numbered(scene.step):
        if shape.distance(shapely.Point(scene.pose[:2])) > FAR_M:
            continue
        corners = [problem.route.locate(*corner, scene.along_m) for corner in shape.exterior.coords[:-1]]
        near_m = min(along_m for along_m, _ in corners)
        sides_m = [left_m for _, left_m in corners]
        half_m = scene.car.width_m / 2 + ASIDE_M
        gap_m = near_m - scene.along_m - scene.car.length_m / 2
        if near_m > scene.along_m and min(sides_m) < half_m and max(sides_m) > -half_m and gap_m < best[0]:
            # One that leaves the recording counts as standing.
            there = later.get(number, shape.centroid)
            speed_mps = math.dist(there.coords[0], shape.centroid.coords[0]) / problem.step_s
            best = (gap_m, speed_mps)
    return best


def followed(scene: Scene) -> float:
    """The pedal of the Intelligent Driver Model."""
    car, speed_mps = scene.car, scene.speed_mps
    wanted_mps = max(scene.problem.speed_mps, SPEED_MIN_MPS)
    gap_m, other_mps = ahead(scene)
    wished_m = GAP_M + max(0.0, GAP_S * speed_mps + speed_mps * (speed_mps - other_mps) / (2 * math.sqrt(car.max_accel_mps2 * BRAKE_MPS2)))
    accel_mps2 = car.max_accel_mps2 * (1 - (speed_mps / wanted_mps) ** 4 - (wished_m / max(gap_m, 0.1)) ** 2)
    return max(-1.0, min(1.0, accel_mps2 / (car.max_accel_mps2 if accel_mps2 > 0 else car.max_brake_mps2)))


def drive(problem: Problem, car: Car, scanner: Scanner, follows: bool) -> tuple[str, Scene]:
    """Drives one scenario: how it ended, and the scene at its end."""
    scene = Scene(problem, car, scanner, 0, SUB_STEP_S)
    while not (scene.touched or scene.arrives or scene.is_over):
        scene.advance(pursued(scene), followed(scene) if follows else 0.0, TICK_S)
    return scene.touched or ("arrived" if scene.arrives else "max_step"), scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--vehicle", type=Path, required=True, help="vehicle file of the car")
    parser.add_argument("--speed-by", choices=["idm", "keep"], default="idm")
    arguments = parser.parse_args()
    setting = settings_of(arguments.vehicle)
    car, scanner = Car.of(setting), Scanner.of(setting)
    arrived, whole, shares = 0, 0, []
    found = drivable(problems(), car, scanner)
    print("seed   step  completion  goal   ended, scenario")
    for seed, problem in enumerate(found):
        ended, scene = drive(problem, car, scanner, arguments.speed_by == "idm")
        is_whole = scene.arrives and scene.is_whole
        arrived, whole = arrived + scene.arrives, whole + is_whole
        shares.append(max(0.0, min(scene.completion, 1.0)))
        print(f"{seed:<6} {scene.step:<5} {100 * shares[-1]:8.1f} %  {'whole' if is_whole else '-':<6} {ended}, {problem.name}", flush=True)
    print(f"{len(found)} scenarios, {arguments.speed_by}: arrived {arrived}, whole goal {whole}, completion {np.mean(shares):.3f}")


if __name__ == "__main__":
    main()

"""ir-sim's own driver on the same courses: its behaviour `dash`, from way point to way point.

    target/ir-sim/bin/python sim/irsim/baseline.py --vehicle vehicles/car-1-10.toml --episodes 10

The way points are on the middle line of the road; with `--way a-star` they are those of
ir-sim's A* search, which is given the map with all walls and obstacles.
"""

import argparse
import contextlib
import io
import math
from pathlib import Path

import numpy as np
from course import Course, draw

from car import Car, settings_of
from scene import SUB_STEP_S, environment, world_of

# After `scene`, which loads ir-sim without its messages.
from irsim.lib.path_planners.a_star import AStarPlanner
from shapely import LineString

#: The horizon of the default configuration, s: 1,500 ticks at 10 Hz.
HORIZON_S = 150.0
#: Cells of the map of A* across half of the road. What is left of the narrowest gap is a
#: sixth of the road, and has to hold whole cells.
CELLS = 8


def middle_line(course: Course) -> list[list[float]]:
    """Way points on the middle line, a quarter of the road's width apart, to the goal."""
    gap_m = course.half_width_m / 2
    count = math.ceil((course.goal_m - course.start_m) / gap_m)
    along_m = [course.start_m + k * gap_m for k in range(1, count)]
    return [list(course.at(part_m)) for part_m in [*along_m, course.goal_m]]


def search_map(course: Course, car: Car) -> dict:
    """The course for a search for a point: all that stands there is larger by as much as
    the middle of the rear axle has to keep away, and the road is closed at both ends."""
    world = world_of(course, car, SUB_STEP_S, {"goal": list(course.at(course.goal_m))})
    # Half of the width, and what a front corner swings out by in a bend.
    margin_m = 0.75 * car.width_m
    half_m = course.half_width_m
    ends = [[course.at(part_m, side * half_m)[:2] for side in (-1, 1)] for part_m in (0.0, course.begins_m[-1])]
    for obstacle in world["obstacle"]:
        shape = obstacle["shape"]
        if shape["name"] == "circle":
            shape["radius"] += margin_m
        elif shape["name"] == "rectangle":
            shape["length"] += 2 * margin_m
            shape["width"] += 2 * margin_m
    walls = [LineString(wall).buffer(margin_m) for wall in [*course.walls(), *ends]]
    shapes = [{"name": "polygon", "vertices": [list(place) for place in wall.exterior.coords]} for wall in walls]
    kept = [obstacle for obstacle in world["obstacle"] if obstacle["shape"]["name"] != "linestring"]
    world["obstacle"] = kept + [{"shape": shape, "state": [0.0, 0.0, 0.0]} for shape in shapes]
    return world


def searched(course: Course, car: Car) -> list[list[float]]:
    """Way points of ir-sim's A*. Empty when it finds no way."""
    scene = environment(search_map(course, car), 0)
    grid = scene.get_map(resolution=course.half_width_m / CELLS)
    planner = AStarPlanner(grid)
    # It says how it went on standard output.
    with contextlib.redirect_stdout(io.StringIO()):
        path = planner.planning(scene.robot.state, scene.robot.goal, show_animation=False)
    # From the goal back to the start.
    places = np.asarray(path, dtype=float)[:, ::-1].T
    return [[float(x_m), float(y_m), 0.0] for x_m, y_m in places[1:]]


def drive(course: Course, car: Car, way: list[list[float]], arguments: argparse.Namespace) -> tuple:
    """Drives one course: how it ended, its time, s, and the share that was driven."""
    reach_m = course.half_width_m if arguments.way == "middle" else car.length_m
    robot = {
        "behavior": {"name": "dash"},
        # One list of goals for each robot.
        "goal": [way],
        "goal_threshold": reach_m,
        "vel_max": [arguments.speed, car.max_steer_rad],
    }
    scene = environment(world_of(course, car, SUB_STEP_S, robot), 0)
    car_m, piece, share = car.wheelbase_m / 2, 0, 0.0
    for step in range(round(HORIZON_S / SUB_STEP_S)):
        scene.step()
        x_m, y_m, heading_rad = scene.robot.state[:3, 0]
        middle = (x_m + car_m * math.cos(heading_rad), y_m + car_m * math.sin(heading_rad))
        piece, along_m, _ = course.locate(*middle, piece)
        share = (along_m - course.start_m) / (course.goal_m - course.start_m)
        if scene.robot.collision_flag:
            touched = scene.robot.collision_obj[0].shape
            return ("wall" if touched == "linestring" else "obstacle"), step * SUB_STEP_S, share
        # The goal counts as reached at the same distance for every choice of way points.
        near = math.dist((x_m, y_m), course.at(course.goal_m)[:2]) < course.half_width_m
        if scene.robot.arrive_flag or near:
            return "arrived", step * SUB_STEP_S, share
    return "max_step", HORIZON_S, share


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--vehicle", type=Path, required=True, help="vehicle file of the car")
    parser.add_argument("--seed", type=int, default=1000, help="seed of the first course")
    parser.add_argument("--episodes", type=int, default=10, help="number of courses")
    parser.add_argument("--speed", type=float, help="speed, m/s; default: the car's top speed")
    parser.add_argument("--way", choices=["middle", "a-star"], default="middle")
    arguments = parser.parse_args()
    car = Car.of(settings_of(arguments.vehicle))
    arguments.speed = arguments.speed or car.max_speed_mps
    counts = dict.fromkeys(("arrived", "wall", "obstacle", "max_step", "no way"), 0)
    print("seed   outcome     completion   time, s")
    for seed in range(arguments.seed, arguments.seed + arguments.episodes):
        course = draw(seed, car)
        way = middle_line(course) if arguments.way == "middle" else searched(course, car)
        driven = drive(course, car, way, arguments) if way else ("no way", 0.0, 0.0)
        ended, time_s, share = driven
        counts[ended] += 1
        print(f"{seed:<6} {ended:<11} {100 * min(share, 1.0):8.1f} %   {time_s:7.1f}", flush=True)
    print(
        f"{arguments.episodes} courses, dash at {arguments.speed:.1f} m/s, {arguments.way} way points: "
        + ", ".join(f"{word} {count}" for word, count in counts.items())
    )


if __name__ == "__main__":
    main()

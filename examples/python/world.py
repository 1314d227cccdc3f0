#!/usr/bin/env python3
"""A world: a kinematic bicycle in a straight corridor of 150 m with a box on the left.

    ./vlaps up --world examples/python/world.py --episodes 1
"""

import math

from vlaps import process

LENGTH_M, HALF_WIDTH_M, GOAL_M = 150.0, 5.0, 140.0
BOX_M, BOX_RADIUS_M = (70.0, 3.2), 0.8


class Car:
    def __init__(self, run):
        keys = "max_brake_mps2 max_accel_mps2 max_speed_mps max_steer_deg wheelbase_m"
        self.vehicle = {key: run.setting(f"vehicle.{key}") for key in keys.split()}
        self.x_m, self.y_m, self.heading_rad = 5.0, 0.0, 0.0
        self.speed_mps = self.yaw_radps = self.steer = self.pedal = 0.0

    def move(self, tick):
        car, dt = self.vehicle, tick.step_s
        self.steer, self.pedal = (max(-1.0, min(1.0, part)) for part in (tick.steer, tick.pedal))
        most = car["max_brake_mps2" if self.pedal < 0 else "max_accel_mps2"]
        speed_mps = self.speed_mps + self.pedal * most * dt
        self.speed_mps = max(0.0, min(car["max_speed_mps"], speed_mps))
        wheel_rad = math.radians(self.steer * car["max_steer_deg"])
        self.yaw_radps = self.speed_mps * math.tan(wheel_rad) / car["wheelbase_m"]
        self.heading_rad += self.yaw_radps * dt
        self.x_m += self.speed_mps * math.cos(self.heading_rad) * dt
        self.y_m += self.speed_mps * math.sin(self.heading_rad) * dt

    def range(self, place_m, angle_rad, most_m):
        """The range from a place along a ray to the corridor's walls and to the box, m."""
        dx, dy = math.cos(angle_rad), math.sin(angle_rad)
        wall_m = (math.copysign(HALF_WIDTH_M, dy) - place_m[1]) / dy if dy else most_m
        found_m = min(wall_m, most_m)
        bx, by = BOX_M[0] - place_m[0], BOX_M[1] - place_m[1]
        along_m = bx * dx + by * dy
        if along_m > 0 and (left := BOX_RADIUS_M**2 + along_m**2 - bx * bx - by * by) > 0:
            found_m = min(found_m, along_m - math.sqrt(left))
        return max(found_m, 0.0)

    def observe(self, seen, beams_rad):
        moves = (self.speed_mps, self.yaw_radps, self.steer, self.pedal)
        seen.ego = process.Ego(self.x_m, self.y_m, self.heading_rad, *moves)
        left_m, right_m = HALF_WIDTH_M - self.y_m, HALF_WIDTH_M + self.y_m
        seen.road = process.Road(left_m, right_m, self.heading_rad, self.y_m)
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        for k, ahead_m in enumerate((min(self.x_m + 50, LENGTH_M), LENGTH_M)):
            dx, dy = ahead_m - self.x_m, -self.y_m
            seen.checkpoints[k] = process.Checkpoint(cos * dx + sin * dy, cos * dy - sin * dx)
        x_m, y_m = seen.scanner_x_body_m, seen.scanner_y_body_m
        place_m = self.x_m + cos * x_m - sin * y_m, self.y_m + sin * x_m + cos * y_m
        for k, beam_rad in enumerate(beams_rad):
            seen.ranges_m[k] = self.range(place_m, self.heading_rad + beam_rad, seen.lidar_max_m)


def main():
    run = process.Member("world")
    car, seen, progress = Car(run), process.Observation(), process.Progress()
    beams_rad = run.beams(seen)
    while tick := run.await_tick():
        if tick.begins:
            car, progress = Car(run), process.Progress(route_m=GOAL_M - 5)
        else:
            car.move(tick)
        progress.object_contacts += math.dist((car.x_m, car.y_m), BOX_M) < BOX_RADIUS_M + 1
        progress.completion = min((car.x_m - 5) / (GOAL_M - 5), 1.0)
        progress.speed_mps = car.speed_mps
        if car.x_m >= GOAL_M or abs(car.y_m) > HALF_WIDTH_M:
            ends = process.Outcome
            progress.outcome = ends.ARRIVED if car.x_m >= GOAL_M else ends.OUT_OF_ROAD
        car.observe(seen, beams_rad)
        run.finish_tick(seen, progress)


process.run(main)

"""The world process on the F1TENTH gym: `./vlaps up --world f1tenth`.

The gym moves the car, scans, and says when it touches a wall. The road is found in the image
of a map, the car comes from the run's settings, the begin from the episode's seed.
"""

from typing import Any

# Loading the gym takes seconds, in which a process that has joined would count as silent.
from track import chosen_map, track

import numpy as np
from car import Car, Scanner
from episodes import drive, period_s, process, show_road, show_scan, sub_step_s
from scene import SUB_STEP_S, Scene, parameters, scan_simulator, simulator

#: The road is at least so many times as wide as the car.
WIDTHS_MIN = 3.0


class Episode(Scene):
    """A scene that is driven in a run."""

    # The gym knows no end of time.
    is_over = False

    def advance(self, steer: float, pedal: float, step_s: float) -> None:
        before = len(self.lap.laps_s)
        super().advance(steer, pedal, step_s)
        for number, lap_s in enumerate(self.lap.laps_s[before:], before + 1):
            print(f"lap {number}: {lap_s:.2f} s", flush=True)

    def observe(self, seen: Any) -> None:
        """What the car perceives, into an observation."""
        pose, turned = self.pose, self.agent.state[2] / self.car.max_steer_rad
        moves = (self.speed_mps, self.yaw_radps, float(np.clip(turned, -1.0, 1.0)), self.pedal)
        seen.ego = process.Ego(*pose, *moves)
        show_road(seen, self.route, pose, self.lap.along_m, self.lap.left_m)
        show_scan(seen, self.scanner, self.ranges_m())


def main() -> None:
    path = chosen_map()
    route = track(path)
    run = process.Member("world")
    car, scanner = Car.of(run.setting), Scanner.of(run.setting)
    width_m = float(np.min(route.left_m + route.right_m))
    if width_m < WIDTHS_MIN * car.width_m:
        raise ImportError(
            f"{path}: its road is {width_m:.1f} m wide, too narrow for a car of {car.width_m} m; "
            "use --vehicle vehicles/car-1-10.toml"
        )
    # The gym's first step compiles its simulator, which takes seconds.
    made = simulator(str(path), parameters(car), sub_step_s(period_s(run), SUB_STEP_S))
    scans = scan_simulator(str(path), scanner)
    drive(run, lambda seed: Episode(made, scans, route, car, scanner, seed))


if __name__ == "__main__":
    process.run(main)

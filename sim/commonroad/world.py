"""The world process on CommonRoad: `./vlaps up --world commonroad`.

The scenario is that of the episode's seed, the car comes from the run's settings. CommonRoad's
vehicle model moves the car, its drivability checker says what the car touches.
"""

from typing import Any

# Reading the scenarios takes seconds, in which a process that has joined would count as silent.
from files import problems

from car import Car, Scanner
from episodes import drive, period_s, process, show_road, show_scan, sub_step_s
from problem import Problem, Unusable
from scene import SUB_STEP_S, Scene, drivable


class Episode(Scene):
    """A scene that is driven in a run."""

    def advance(self, steer: float, pedal: float, step_s: float) -> None:
        super().advance(steer, pedal, step_s)
        if self.arrives:
            whole = "with its time and speed" if self.is_whole else "without its time or speed"
            print(f"{self.problem.name}: arrives at step {self.step}, {self.speed_mps:.1f} m/s: the goal {whole}", flush=True)

    def observe(self, seen: Any) -> None:
        """What the car perceives, into an observation."""
        moves = (self.speed_mps, self.yaw_radps, self.steer, self.pedal)
        seen.ego = process.Ego(*self.pose, *moves)
        show_road(seen, self.problem.route, self.pose, self.along_m, self.left_m)
        show_scan(seen, self.scanner, self.ranges_m())


def main() -> None:
    read = problems()
    run = process.Member("world")
    car, scanner = Car.of(run.setting), Scanner.of(run.setting)
    try:
        found: list[Problem] = drivable(read, car, scanner)
    except Unusable as error:
        raise ImportError(error) from None
    step_s = sub_step_s(period_s(run), SUB_STEP_S)

    def begin(seed: int) -> Episode:
        problem = found[seed % len(found)]
        print(f"seed {seed}: {problem.name}", flush=True)
        return Episode(problem, car, scanner, seed, step_s)

    drive(run, begin)


if __name__ == "__main__":
    process.run(main)

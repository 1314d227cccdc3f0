"""What ir-sim makes of a car and its scanner. Skipped without ir-sim."""

import importlib.util
import math
import unittest
from dataclasses import replace

from course import draw

from car import ROOT, Car, Scanner, settings_of

try:
    from scene import SUB_STEP_S, Scene
except ImportError as error:
    if importlib.util.find_spec("irsim") is not None:
        raise
    raise unittest.SkipTest(f"{error}; run ./vlaps setup ir-sim") from None


def scene(name="car-1-10.toml", seed=3, **changes):
    setting = settings_of(ROOT / "vehicles" / name)
    scanner = replace(Scanner.of(setting), drop_probability=0.0, **changes)
    car = Car.of(setting)
    return Scene(draw(seed, car), car, scanner, seed, SUB_STEP_S)


class Scenes(unittest.TestCase):
    def test_each_beam_shows_the_wall_in_its_direction(self):
        # As `Fan::angle_rad` in vehicle/src/scanner.rs, in the straight at the begin.
        for changes in [
            {},
            {"beams": 240, "field_of_view_deg": 360.0},
            {"beams": 91, "field_of_view_deg": 180.0, "heading_deg": 40.0, "y_m": 0.1},
        ]:
            here = scene(**changes)
            scanner, half_m = here.scanner, here.course.half_width_m
            beams, seen = int(scanner.beams), 0
            for k, range_m in enumerate(here.ranges_m()):
                in_fan = k / beams if scanner.field_of_view_deg >= 360 else k / (beams - 1) - 0.5
                angle_rad = in_fan * scanner.field_of_view_rad + math.radians(scanner.heading_deg)
                # Beams across see the walls of the straight.
                if abs(math.sin(angle_rad)) > 0.8:
                    wall_m = math.copysign(half_m, math.sin(angle_rad)) - scanner.y_m
                    # A beam to the rear may leave the road behind its begin.
                    if here.pose[0] + scanner.x_m + wall_m / math.tan(angle_rad) > 0:
                        self.assertAlmostEqual(range_m, wall_m / math.sin(angle_rad), places=6)
                        seen += 1
            self.assertGreater(seen, 20, changes)

    def test_the_car_moves_as_its_file_says(self):
        here = scene()
        car = here.car
        start_m = here.pose[0]
        for _ in range(10):
            here.advance(0.0, 1.0, 0.1)
        # The delay of 20 ms is one step.
        self.assertAlmostEqual(here.speed_mps, car.max_accel_mps2 * 0.98, places=6)
        self.assertGreater(here.pose[0], start_m + 1.0)
        self.assertFalse(here.touches or here.arrives)
        for _ in range(20):
            here.advance(0.0, -1.0, 0.1)
        self.assertEqual(here.speed_mps, 0.0)

    def test_full_steering_turns_on_the_turning_radius(self):
        here = scene("metadrive.toml")
        for _ in range(5):
            here.advance(0.0, 1.0, 0.1)
        here.advance(1.0, 0.0, 0.1)
        here.advance(1.0, 0.0, 0.1)
        self.assertAlmostEqual(here.yaw_radps, here.speed_mps / here.car.turning_radius_m, places=6)

    def test_a_wall_that_is_touched_holds_the_car(self):
        here = scene()
        for _ in range(40):
            here.advance(1.0, 1.0, 0.1)
        self.assertTrue(here.touches)
        self.assertFalse(here.arrives)
        self.assertLess(here.completion, 0.5)

    def test_the_goal_is_reached_on_the_middle_line(self):
        here = scene()
        here.robot.set_state([*here.course.at(here.course.goal_m), 0.0])
        here.advance(0.0, 0.0, 0.1)
        self.assertTrue(here.arrives)

    def test_a_dropped_return_shows_the_full_range(self):
        here = scene()
        here.scanner = replace(here.scanner, drop_probability=0.5)
        full = sum(range_m == here.scanner.range_m for range_m in here.ranges_m())
        self.assertTrue(400 < full < 700, full)


if __name__ == "__main__":
    unittest.main()

"""What the F1TENTH gym makes of a car, its scanner and a road. Skipped without the gym."""

import math
import unittest
from dataclasses import replace

try:
    from track import EXAMPLE_MAP, Walls, track
except ImportError as error:
    raise unittest.SkipTest(f"{error}; run ./vlaps setup f1tenth --checkout DIR") from None

import numpy as np
from car import ROOT, Car, Scanner, settings_of
from scene import LAPS, SUB_STEP_S, Scene, parameters, scan_simulator, simulator

ROUTE = track(EXAMPLE_MAP)
SETTING = settings_of(ROOT / "vehicles" / "car-1-10.toml")
CAR = Car.of(SETTING)


def scene(seed=3, **changes):
    scanner = replace(Scanner.of(SETTING), drop_probability=0.0, **changes)
    made = simulator(str(EXAMPLE_MAP), parameters(CAR), SUB_STEP_S)
    return Scene(made, scan_simulator(str(EXAMPLE_MAP), scanner), ROUTE, CAR, scanner, seed)


class Tracks(unittest.TestCase):
    def test_the_road_leads_round_between_the_walls(self):
        walls = Walls(EXAMPLE_MAP)
        self.assertTrue(150 < ROUTE.length_m < 180, ROUTE.length_m)
        self.assertGreater(walls.clearance_m(ROUTE.places).min(), 1.0)
        self.assertLess(np.abs(ROUTE.left_m - ROUTE.right_m).max(), 0.6)
        turned_rad = ROUTE.headings_rad[-1] - ROUTE.headings_rad[0]
        self.assertAlmostEqual(turned_rad, math.tau, places=6)

    def test_a_map_that_is_not_there_is_named(self):
        with self.assertRaisesRegex(ImportError, "nowhere.yaml: no such file"):
            Walls(EXAMPLE_MAP.with_name("nowhere.yaml"))


class Scenes(unittest.TestCase):
    def test_the_same_seed_begins_alike_and_another_elsewhere(self):
        first, again, other = scene(3), scene(3), scene(4)
        self.assertEqual(first.pose, again.pose)
        np.testing.assert_array_equal(first.ranges_m(), again.ranges_m())
        self.assertGreater(math.dist(first.pose[:2], other.pose[:2]), 1.0)

    def test_each_beam_shows_the_wall_in_its_direction(self):
        for changes in [
            {},
            {"beams": 240, "field_of_view_deg": 360.0},
            {"beams": 91, "field_of_view_deg": 180.0, "heading_deg": 40.0, "y_m": 0.1},
        ]:
            here = scene(**changes)
            scanner, (x_m, y_m, heading_rad) = here.scanner, here.pose
            beams, cos, sin = int(scanner.beams), math.cos(heading_rad), math.sin(heading_rad)
            mount = np.array([x_m + cos * scanner.x_m - sin * scanner.y_m, y_m + sin * scanner.x_m + cos * scanner.y_m])
            walls, ranges_m = Walls(EXAMPLE_MAP), here.ranges_m()
            for k in range(0, beams, 7):
                # As `Fan::angle_rad` in vehicle/src/scanner.rs.
                in_fan = k / beams if scanner.field_of_view_deg >= 360 else k / (beams - 1) - 0.5
                angle_rad = heading_rad + in_fan * scanner.field_of_view_rad + math.radians(scanner.heading_deg)
                if ranges_m[k] > 5.0:
                    # The gym has 2,000 directions: far away they are decimetres apart.
                    continue
                end = mount + ranges_m[k] * np.array([math.cos(angle_rad), math.sin(angle_rad)])
                self.assertLess(walls.clearance_m(end[None])[0], 0.15, (changes, k))

    def test_the_pedal_accelerates_as_the_file_says_and_the_brake_ends_at_a_stand(self):
        here = scene()
        here.advance(0.0, 1.0, 0.5)
        self.assertAlmostEqual(here.speed_mps, 0.5 * CAR.max_accel_mps2, delta=0.1)
        here.advance(0.0, -1.0, 0.2)
        self.assertAlmostEqual(here.speed_mps, 0.5 * CAR.max_accel_mps2 - 0.2 * CAR.max_brake_mps2, delta=0.15)
        here.advance(0.0, -1.0, 1.0)
        self.assertAlmostEqual(here.speed_mps, 0.0, delta=0.01)
        self.assertEqual(here.touched, "")

    def test_a_wall_that_is_touched_ends_the_drive(self):
        here = scene()
        for _ in range(60):
            here.advance(1.0, 1.0, 0.1)
        self.assertEqual(here.touched, "a wall")
        self.assertFalse(here.arrives)

    def test_laps_are_counted_along_the_road(self):
        here = scene()
        first_m = here.lap.along_m
        for lap in range(1, LAPS + 1):
            for part_m in np.arange(5.0, ROUTE.length_m + 5.0, 5.0):
                here.lap.go(*ROUTE.at(first_m + part_m)[:2], 1.0)
            self.assertEqual(len(here.lap.laps_s), lap)
        self.assertTrue(here.arrives)
        self.assertGreaterEqual(here.completion, 1.0)


if __name__ == "__main__":
    unittest.main()

"""What CommonRoad makes of a car, and what the world makes of its files. Skipped without it."""

import importlib.util
import math
import tempfile
import unittest
from dataclasses import replace
from pathlib import Path

try:
    from files import _folder, read, scenario_files
except ImportError as error:
    if importlib.util.find_spec("commonroad") is not None:
        raise
    raise unittest.SkipTest(f"{error}; run ./vlaps setup commonroad --checkout DIR") from None

import numpy as np
from problem import Unusable
from scene import SUB_STEP_S, Scene, ranges_m

from car import ROOT, Car, Scanner, settings_of

#: One lane of 100 m to the east with a parked car at 60 m. Tests say where the goal is.
LANE = """<?xml version="1.0"?>
<commonRoad commonRoadVersion="2020a" benchmarkID="ZAM_Test-1_1_T-1" date="2026-01-01" author="" affiliation="" source="" timeStepSize="0.1">
<location><geoNameId>0</geoNameId><gpsLatitude>0</gpsLatitude><gpsLongitude>0</gpsLongitude></location>
<scenarioTags/>
<lanelet id="1">
<leftBound><point><x>0</x><y>2</y></point><point><x>100</x><y>2</y></point></leftBound>
<rightBound><point><x>0</x><y>-2</y></point><point><x>100</x><y>-2</y></point></rightBound>
</lanelet>
<staticObstacle id="2"><type>parkedVehicle</type><shape><rectangle><length>4</length><width>2</width></rectangle></shape>
<initialState><position><point><x>60</x><y>0</y></point></position><orientation><exact>0</exact></orientation><time><exact>0</exact></time></initialState>
</staticObstacle>
<planningProblem id="3">
<initialState><position><point><x>20</x><y>0</y></point></position><velocity><exact>5</exact></velocity><orientation><exact>0</exact></orientation><yawRate><exact>0</exact></yawRate><slipAngle><exact>0</exact></slipAngle><time><exact>0</exact></time></initialState>
<goalState><position><rectangle><length>4</length><width>4</width><orientation>0</orientation><center><x>GOAL_X</x><y>GOAL_Y</y></center></rectangle></position><time><intervalStart>0</intervalStart><intervalEnd>50</intervalEnd></time></goalState>
</planningProblem>
</commonRoad>
"""


def problem(goal_x_m=40.0, goal_y_m=0.0, text=LANE):
    """The first planning problem of a file with this text."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ZAM_Test-1_1_T-1.xml"
        path.write_text(text.replace("GOAL_X", str(goal_x_m)).replace("GOAL_Y", str(goal_y_m)))
        return read(path)[0]


def scene(**changes):
    setting = settings_of(ROOT / "vehicles" / "metadrive.toml")
    scanner = replace(Scanner.of(setting), **changes)
    return Scene(problem(), Car.of(setting), scanner, 0, SUB_STEP_S)


class Files(unittest.TestCase):
    def test_what_cannot_be_driven_says_why(self):
        begin, end = LANE.index("<planningProblem"), LANE.index("</planningProblem>") + len("</planningProblem>")
        lane, lane_end = LANE.index("<lanelet "), LANE.index("</lanelet>") + len("</lanelet>")
        for text, goal, why in [
            (LANE[:begin] + LANE[end:], (40, 0), "no planning problem"),
            (LANE[:200], (40, 0), "not a CommonRoad scenario"),
            ("", (40, 0), "not a CommonRoad scenario"),
            (LANE[:lane] + LANE[lane_end:], (40, 0), "no lanelet"),
            (LANE.replace("<velocity><exact>5</exact>", "<velocity><intervalStart>4</intervalStart><intervalEnd>5</intervalEnd>"), (40, 0), "not exact"),
            (LANE.replace("<position><point><x>20<", "<position><point><x>-20<"), (40, 0), "does not begin on a lanelet"),
            (LANE, (40, 30), "no way"),
            (LANE, (5, 0), "does not lead through the goal"),
        ]:
            with self.assertRaises(Unusable) as told:
                problem(*goal, text)
            self.assertIn(why, str(told.exception))
            self.assertNotIn("\n", str(told.exception))

    def test_the_road_for_conform_is_free_and_begins_at_a_stand(self):
        (free,) = read(ROOT / "sim" / "commonroad" / "free_road.xml")
        self.assertEqual((free.speed_mps, free.obstacles(0)), (0.0, []))
        self.assertGreater(free.goal_m - free.start_m, 200.0)

    def test_a_folder_without_scenarios_is_refused(self):
        with tempfile.TemporaryDirectory() as folder:
            with self.assertRaisesRegex(ImportError, "no CommonRoad scenario"):
                scenario_files(Path(folder))

    def test_the_checkout_has_scenarios_whose_road_has_two_edges(self):
        found = 0
        for path in scenario_files(_folder()):
            try:
                problems = read(path)
            except Unusable:
                continue
            for given in problems:
                found += 1
                self.assertTrue(np.all(given.route.left_m + given.route.right_m > 2.0), given.name)
                self.assertGreater(given.goal_m, given.start_m, given.name)
                self.assertLess(abs(given.route.locate(*given.pose[:2])[1]), 2.0, given.name)
        self.assertGreater(found, 3)


class Scenes(unittest.TestCase):
    def test_the_road_is_that_of_the_lane(self):
        route = problem().route
        self.assertAlmostEqual(route.length_m, 100.0, places=6)
        np.testing.assert_allclose(route.left_m, 2.0, atol=1e-6)
        np.testing.assert_allclose(route.right_m, 2.0, atol=1e-6)

    def test_a_lane_beside_the_way_is_no_part_of_the_road(self):
        beside = LANE[LANE.index("<lanelet ") : LANE.index("</lanelet>")].replace("<y>2<", "<y>6<").replace("<y>-2<", "<y>2<")
        beside = beside.replace('id="1"', 'id="4"') + '<adjacentRight ref="1" drivingDir="same"/></lanelet>'
        two = LANE.replace("</lanelet>", '<adjacentLeft ref="4" drivingDir="same"/></lanelet>' + beside)
        np.testing.assert_allclose(problem(text=two).route.left_m, 2.0, atol=1e-6)
        # A goal on the other lane makes it a part.
        np.testing.assert_allclose(problem(goal_y_m=4.0, text=two).route.at(60.0)[1], 4.0, atol=1e-2)
        width_m = np.add(*problem(goal_y_m=4.0, text=two).route.edges(30.0))
        # Across the line, which is slanted there.
        self.assertAlmostEqual(width_m, 8.0, delta=0.5)

    def test_a_beam_meets_the_nearest_side_alone(self):
        square = np.array([[[5.0, -1.0], [5.0, 1.0]], [[7.0, -1.0], [7.0, 1.0]]])
        found_m = ranges_m(np.zeros(2), np.array([0.0, math.pi, math.pi / 2]), square, 50.0)
        np.testing.assert_allclose(found_m, [5.0, 50.0, 50.0])
        self.assertEqual(ranges_m(np.zeros(2), np.zeros(3), np.zeros((0, 2, 2)), 50.0).tolist(), [50.0] * 3)

    def test_the_scan_shows_the_parked_car(self):
        here = scene()
        found_m = here.ranges_m()
        self.assertAlmostEqual(found_m[0], 58.0 - 20.0, places=6)
        self.assertEqual(found_m[len(found_m) // 2], here.scanner.range_m)
        self.assertTrue(np.all(scene(drop_probability=1.0).ranges_m() == here.scanner.range_m))

    def test_the_car_moves_as_its_file_says(self):
        here = scene()
        here.advance(0.0, 1.0, 0.1)
        self.assertAlmostEqual(here.speed_mps, 5.0 + 0.1 * here.car.max_accel_mps2, places=6)
        here.advance(1.0, 0.0, 0.1)
        self.assertAlmostEqual(here.yaw_radps, here.speed_mps / here.car.turning_radius_m, places=6)
        for _ in range(10):
            here.advance(0.0, -1.0, 0.1)
        self.assertEqual(here.speed_mps, 0.0)

    def test_the_goal_is_reached_and_all_of_it_in_time(self):
        here = scene()
        for _ in range(40):
            here.advance(0.0, 0.0, 0.1)
        self.assertTrue(here.arrives and here.is_whole and not here.touched)
        self.assertEqual(here.completion, 1.0)
        here.elapsed_s = 6.0
        self.assertTrue(here.arrives and not here.is_whole)

    def test_the_checker_ends_an_episode_at_an_obstacle_and_at_the_edge(self):
        here = scene()
        here.problem.goal_m = 90.0
        here.problem.is_there = lambda pose: False
        while not here.touched and here.step < 80:
            here.advance(0.0, 0.5, 0.1)
        self.assertEqual(here.touched, "an obstacle (parkedVehicle) ahead")
        here = scene()
        while not here.touched and here.step < 80:
            here.advance(0.4, 0.0, 0.1)
        self.assertEqual(here.touched, "the edge of the road")


if __name__ == "__main__":
    unittest.main()

"""Where a car is on a road, and its checkpoints.

    target/f1tenth/bin/python -m unittest discover -s sim/foreign
"""

import math
import unittest

import numpy as np
from route import REACHES_M, Route


def ring(radius_m=30.0, rows=720):
    angles_rad = np.linspace(0.0, math.tau, rows, endpoint=False)
    places = radius_m * np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
    return Route(places, np.full(rows, 2.0), np.full(rows, 3.0), is_closed=True)


def straight():
    return Route(np.array([[0.0, 0.0], [100.0, 0.0]]), np.full(2, 2.0), np.full(2, 3.0), is_closed=False)


class Routes(unittest.TestCase):
    def test_a_straight_has_a_far_checkpoint_and_its_end_twice(self):
        route = straight()
        self.assertEqual(route.locate(10.0, 0.5), (10.0, 0.5))
        self.assertEqual(route.locate(10.0, -0.5), (10.0, -0.5))
        first, second = route.checkpoints((10.0, 0.5, 0.0), 10.0)
        self.assertAlmostEqual(first.x_m, REACHES_M[-1])
        self.assertEqual((first.y_m, first.side, second.side), (-0.5, 0, 0))
        first, second = route.checkpoints((99.0, 0.0, 0.0), 99.0)
        self.assertEqual((first.x_m, first.y_m), (1.0, 0.0))
        self.assertEqual(first, second)

    def test_the_second_checkpoint_at_the_end_is_straight_in_each_direction(self):
        for angle_rad in np.linspace(0.0, math.tau, 16, endpoint=False):
            end = 20.0 * np.array([math.cos(angle_rad), math.sin(angle_rad)])
            route = Route(np.array([[0.0, 0.0], end]), np.full(2, 2.0), np.full(2, 3.0), is_closed=False)
            first, second = route.checkpoints((0.0, 0.0, angle_rad), 0.0)
            self.assertEqual((first.side, second.side), (0, 0), angle_rad)

    def test_a_ring_bends_with_its_radius_all_the_way_round(self):
        for mirrored in (1, -1):
            route = ring()
            if mirrored < 0:
                route = Route(route.places[:-1] * [1, -1], np.full(720, 2.0), np.full(720, 3.0), is_closed=True)
            last_m = None
            for k in range(100):
                angle_rad = math.tau * k / 90
                x_m, y_m = 30.0 * math.cos(angle_rad), mirrored * 30.0 * math.sin(angle_rad)
                heading_rad = mirrored * (angle_rad + math.pi / 2)
                last_m, left_m = route.locate(x_m, y_m, last_m)
                self.assertAlmostEqual(left_m, 0.0, delta=1e-2)
                turned_rad = math.remainder(route.at(last_m)[2] - heading_rad, math.tau)
                self.assertAlmostEqual(turned_rad, 0.0, delta=1e-2)
                for found in route.checkpoints((x_m, y_m, heading_rad), last_m):
                    self.assertEqual(found.side, mirrored)
                    # Of the left edge, 2 m from the middle line.
                    self.assertAlmostEqual(found.radius_m, 30.0 - mirrored * 2.0, delta=0.5)

    def test_an_arc_to_a_checkpoint_stays_on_the_road(self):
        # A corner of 90 degrees with a radius of 3 m between two straights.
        turn_rad = np.linspace(0.0, math.pi / 2, 30)
        arc = np.stack([20 + 3 * np.sin(turn_rad), 3 - 3 * np.cos(turn_rad)], axis=1)
        places = np.vstack([[[0.0, 0.0], [10.0, 0.0]], arc, [[23.0, 13.0], [23.0, 40.0]]])
        route = Route(places, np.full(len(places), 1.5), np.full(len(places), 1.5), is_closed=False)
        before = route.reach_m(0.0)
        self.assertTrue(14.0 < before < 22.5, before)
        self.assertLess(route.reach_m(20.0), 6.5)
        self.assertGreater(route.reach_m(25.0), 20.0)

    def test_a_route_that_comes_near_to_itself_is_followed_on_its_own_branch(self):
        places = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 60.0], [30.0, 60.0], [30.0, -60.0]])
        route = Route(places, np.full(5, 2.0), np.full(5, 2.0), is_closed=False)
        self.assertAlmostEqual(route.locate(30.0, 0.0, 28.0)[0], 30.0)
        self.assertAlmostEqual(route.locate(30.0, 0.0, 205.0)[0], 210.0)


if __name__ == "__main__":
    unittest.main()

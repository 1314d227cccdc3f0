"""What a course promises to the car for which it is drawn. Standard library alone.

    python3 -m unittest discover -s sim/irsim
"""

import math
import unittest

from course import HEADING_MAX_RAD, draw

from car import ROOT, Car, settings_of

CARS = {path.name: Car.of(settings_of(path)) for path in sorted((ROOT / "vehicles").glob("*.toml"))}
SEEDS = range(200)


class Courses(unittest.TestCase):
    def each(self):
        for name, car in CARS.items():
            for seed in SEEDS:
                yield f"{name}, seed {seed}", car, draw(seed, car)

    def test_the_same_seed_gives_the_same_course_and_another_seed_another(self):
        car = CARS["car-1-10.toml"]
        self.assertEqual(draw(7, car), draw(7, car))
        self.assertNotEqual(draw(7, car), draw(8, car))

    def test_the_car_can_drive_each_bend_and_the_road_never_turns_back(self):
        for told, car, course in self.each():
            self.assertTrue(any(piece.curvature_per_m for piece in course.pieces))
            for piece in course.pieces:
                inner_m = 1 / abs(piece.curvature_per_m) if piece.curvature_per_m else math.inf
                self.assertGreater(inner_m, 2 * car.turning_radius_m, told)
                self.assertGreater(inner_m, course.half_width_m, told)
                self.assertLess(abs(piece.heading_rad + piece.turn_rad), HEADING_MAX_RAD + 1e-9, told)

    def test_the_car_fits_past_each_obstacle(self):
        for told, car, course in self.each():
            self.assertGreater(len(course.obstacles), 2, told)
            for obstacle in course.obstacles:
                places = [course.locate(obstacle.x_m, obstacle.y_m, k) for k in range(len(course.pieces))]
                left_m = min((left_m for _, _, left_m in places), key=abs)
                free_m = course.half_width_m + abs(left_m) - obstacle.half_m
                self.assertGreater(free_m, 2 * car.width_m, told)

    def test_a_place_is_found_where_it_was_put(self):
        for told, _, course in self.each():
            piece, last_m = 0, course.begins_m[-1]
            for k in range(1, 100):
                along_m, left_m = last_m * k / 100, course.half_width_m * math.sin(k)
                x_m, y_m, _ = course.at(along_m, left_m)
                piece, found_m, found_left_m = course.locate(x_m, y_m, piece)
                self.assertAlmostEqual(found_m, along_m, places=6, msg=told)
                self.assertAlmostEqual(found_left_m, left_m, places=6, msg=told)


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/env python3
"""A planner: along the middle of the free road to the next checkpoint, shorter where the
scan shows something near the path.

    ./vlaps up --planner examples/python/planner.py --episodes 1
"""

import math

from vlaps import process

STEP_M, REACH_M, CLEAR_M, SPEED_MPS = 2.0, 30.0, 1.4, 5.0
# To the goal, else past what stands there: the straightest first.
ASIDE_M = (0.0, -1.5, 1.5, -3.0, 3.0)


def returns(seen):
    """The points of the scan in the body frame, m: beams that hit something nearby."""
    ranges_m = seen.ranges_m[: seen.beam_count]
    field_rad, is_circle = seen.field_of_view_rad, seen.field_of_view_rad >= math.tau
    gap_rad = field_rad / max(seen.beam_count - (not is_circle), 1)
    first_rad = seen.scanner_heading_rad - (0 if is_circle else field_rad / 2)
    reach_m = min(seen.lidar_max_m, REACH_M + CLEAR_M)
    hits = [(m, first_rad + k * gap_rad) for k, m in enumerate(ranges_m) if m < reach_m]
    x_m, y_m = seen.scanner_x_body_m, seen.scanner_y_body_m
    return [(x_m + m * math.cos(angle), y_m + m * math.sin(angle)) for m, angle in hits]


def path(seen, points, aside_m):
    """Points of a cubic from the car's pose to `aside_m` left of the goal, up to the first
    that is near a return; whether it reaches the goal; and the goal."""
    goal = seen.checkpoints[0]
    far_m = math.hypot(goal.x_body_m, goal.y_body_m)
    scale = min(REACH_M / max(far_m, 1e-6), 1.0)
    goal_m = (goal.x_body_m * scale, goal.y_body_m * scale + aside_m)
    count = max(1, min(15, int(far_m * scale / STEP_M)))
    found = []
    for k in range(count + 1):
        t = k / count
        x_m, y_m = goal_m[0] * t, goal_m[1] * t * t * (3 - 2 * t)
        # The first points lie within the car's own length.
        if k * STEP_M > 3 and any(math.hypot(x - x_m, y - y_m) < CLEAR_M for x, y in points):
            break
        found.append((x_m, y_m))
    return found, len(found) > count, goal_m


def plan_for(seen):
    plan, points, best = process.Plan(), returns(seen), []
    for aside_m in ASIDE_M:
        found, reached, goal_m = path(seen, points, aside_m)
        if len(found) > len(best) or reached:
            outcomes = process.PlanOutcome
            best, plan.outcome = found, outcomes.REACHED if reached else outcomes.PARTIAL
            plan.goal_x_body_m, plan.goal_y_body_m = goal_m
        if reached:
            break
    if len(best) < 5:
        best, plan.outcome = [], process.PlanOutcome.BLOCKED
    plan.waypoint_count = len(best)
    plan.cost_m = sum(math.dist(a, b) for a, b in zip(best, best[1:]))
    for waypoint, (x_m, y_m) in zip(plan.waypoints, best):
        waypoint.x_body_m, waypoint.y_body_m, waypoint.speed_mps = x_m, y_m, SPEED_MPS
    return plan


def main():
    run = process.Member("planner")
    while seen := run.await_observation():
        run.answer(plan_for(seen))


process.run(main)

// A planner: along the middle of the free road to the next checkpoint, slower where the
// scan shows something near the path.
//
//     make -C examples/cpp planner
//     ./vlaps up --planner target/examples/planner --episodes 1
#include <algorithm>
#include <cmath>

#include "vlaps.hpp"

constexpr double STEP_M = 2, REACH_M = 30, CLEAR_M = 1.4, SPEED_MPS = 5;

// Angle of beam k in the body frame, rad.
double beam_rad(const vlaps_observation &seen, uint32_t k) {
    const double field_rad = seen.field_of_view_rad, gaps = std::max(seen.beam_count - 1.0, 1.0);
    if (field_rad >= 2 * M_PI) return seen.scanner_heading_rad + 2 * M_PI * k / seen.beam_count;
    return seen.scanner_heading_rad + field_rad * (k / gaps - 0.5);
}

// Distance of a point of the body frame from the nearest return of the scan, m. Beams that
// hit nothing have the largest range.
double clearance(const vlaps_observation &seen, double x_m, double y_m) {
    double least_m = REACH_M;
    for (uint32_t k = 0; k < seen.beam_count; k++) {
        if (seen.ranges_m[k] >= seen.lidar_max_m) continue;
        const double hit_x_m = seen.scanner_x_body_m + seen.ranges_m[k] * std::cos(beam_rad(seen, k));
        const double hit_y_m = seen.scanner_y_body_m + seen.ranges_m[k] * std::sin(beam_rad(seen, k));
        least_m = std::min(least_m, std::hypot(hit_x_m - x_m, hit_y_m - y_m));
    }
    return least_m;
}

// A cubic from the car's pose to a point at the goal's distance, `aside_m` left of the goal.
void path(const vlaps_observation &seen, double aside_m, vlaps_plan &plan) {
    const vlaps_checkpoint &goal = seen.checkpoints[0];
    const double far_m = std::hypot(goal.x_body_m, goal.y_body_m), scale = std::min(REACH_M / far_m, 1.0);
    plan.goal_x_body_m = goal.x_body_m * scale, plan.goal_y_body_m = goal.y_body_m * scale + aside_m;
    const int count = std::clamp(static_cast<int>(far_m * scale / STEP_M), 1, 15);
    plan.waypoint_count = 0, plan.cost_m = 0;
    for (int k = 0; k <= count; k++) {
        const double t = static_cast<double>(k) / count;
        const double x_m = plan.goal_x_body_m * t, y_m = plan.goal_y_body_m * t * t * (3 - 2 * t);
        // The car is at the first points already: the first 3 m are not judged.
        if (k * STEP_M > 3 && clearance(seen, x_m, y_m) < CLEAR_M) break;
        plan.waypoints[plan.waypoint_count++] = {x_m, y_m, SPEED_MPS};
        plan.cost_m = k * far_m * scale / count;
    }
    plan.outcome = plan.waypoint_count > static_cast<uint32_t>(count) ? VLAPS_PLAN_OUTCOME_REACHED
                   : plan.waypoint_count > 4                          ? VLAPS_PLAN_OUTCOME_PARTIAL
                                                                      : VLAPS_PLAN_OUTCOME_BLOCKED;
    if (plan.outcome == VLAPS_PLAN_OUTCOME_BLOCKED) plan.waypoint_count = 0;
}

int main(int argc, char **argv) {
    return vlaps::run("planner", [&] {
        vlaps::member run("planner", argc, argv);
        vlaps_observation seen{};
        vlaps_plan best{}, plan{};
        while (run.await_observation(seen)) {
            best.outcome = VLAPS_PLAN_OUTCOME_BLOCKED, best.waypoint_count = 0;
            // To the goal, else past what stands there: the longest path, the straightest first.
            for (const double aside_m : {0.0, -1.5, 1.5, -3.0, 3.0}) {
                path(seen, aside_m, plan);
                if (plan.waypoint_count > best.waypoint_count) best = plan;
                if (best.outcome == VLAPS_PLAN_OUTCOME_REACHED) break;
            }
            run.answer(best);
        }
    });
}

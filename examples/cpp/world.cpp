// A world: a kinematic bicycle in a straight corridor of 150 m with a box on the left.
//
//     make -C examples/cpp world
//     ./vlaps up --world target/examples/world --episodes 1
#include <algorithm>
#include <cmath>

#include "vlaps.hpp"

constexpr double LENGTH_M = 150, HALF_WIDTH_M = 5, GOAL_M = 140;
constexpr double BOX_X_M = 70, BOX_Y_M = 3.2, BOX_RADIUS_M = 0.8;

struct Car {
    double x_m = 5, y_m = 0, heading_rad = 0, speed_mps = 0, yaw_radps = 0, steer = 0, pedal = 0;

    void move(const vlaps_tick &tick, const vlaps::member &run) {
        steer = std::clamp(tick.steer, -1.0, 1.0), pedal = std::clamp(tick.pedal, -1.0, 1.0);
        const double most = run.setting(pedal < 0 ? "vehicle.max_brake_mps2" : "vehicle.max_accel_mps2");
        speed_mps = std::clamp(speed_mps + pedal * most * tick.step_s, 0.0,
                               run.setting("vehicle.max_speed_mps"));
        const double wheel_rad = steer * run.setting("vehicle.max_steer_deg") * M_PI / 180;
        yaw_radps = speed_mps * std::tan(wheel_rad) / run.setting("vehicle.wheelbase_m");
        heading_rad += yaw_radps * tick.step_s;
        x_m += speed_mps * std::cos(heading_rad) * tick.step_s;
        y_m += speed_mps * std::sin(heading_rad) * tick.step_s;
    }
    bool touches_box() const { return std::hypot(x_m - BOX_X_M, y_m - BOX_Y_M) < BOX_RADIUS_M + 1; }
};

// The range from a place along a ray to the corridor's walls and to the box, m.
double range(double x_m, double y_m, double angle_rad, double most_m) {
    const double dx = std::cos(angle_rad), dy = std::sin(angle_rad);
    double found_m = most_m;
    if (std::abs(dy) > 1e-9) found_m = std::min(found_m, (std::copysign(HALF_WIDTH_M, dy) - y_m) / dy);
    const double bx = BOX_X_M - x_m, by = BOX_Y_M - y_m, along_m = bx * dx + by * dy;
    const double off2 = bx * bx + by * by - along_m * along_m, left = BOX_RADIUS_M * BOX_RADIUS_M - off2;
    if (along_m > 0 && left > 0) found_m = std::min(found_m, along_m - std::sqrt(left));
    return std::max(found_m, 0.0);
}

void observe(const Car &car, vlaps_observation &seen, const vlaps::member &run) {
    seen.ego = {car.x_m, car.y_m, car.heading_rad, car.speed_mps, car.yaw_radps, car.steer, car.pedal};
    seen.road = {HALF_WIDTH_M - car.y_m, HALF_WIDTH_M + car.y_m, car.heading_rad, car.y_m, 0};
    const double c = std::cos(car.heading_rad), s = std::sin(car.heading_rad);
    const double ahead_m[] = {std::min(car.x_m + 50, LENGTH_M), LENGTH_M};
    for (int k = 0; k < 2; k++) {
        const double dx = ahead_m[k] - car.x_m;
        seen.checkpoints[k] = {c * dx - s * car.y_m, -s * dx - c * car.y_m, 0, 0, VLAPS_BEND_STRAIGHT, 0};
    }
    float *place = seen.ranges_m;
    for (const double direction_rad : run.beams(seen)) {
        const double x_m = seen.scanner_x_body_m, y_m = seen.scanner_y_body_m;
        *place++ = range(car.x_m + c * x_m - s * y_m, car.y_m + s * x_m + c * y_m,
                         car.heading_rad + direction_rad, seen.lidar_max_m);
    }
}

int main(int argc, char **argv) {
    return vlaps::run("world", [&] {
        vlaps::member run("world", argc, argv);
        Car car;
        vlaps_tick tick{};
        vlaps_observation seen{};
        vlaps_progress progress{};
        while (run.await_tick(tick)) {
            if (tick.begins) car = Car{}, progress = vlaps_progress{};
            else car.move(tick, run);
            progress.object_contacts += car.touches_box();
            progress.route_m = GOAL_M - 5;
            progress.completion = std::min((car.x_m - 5) / progress.route_m, 1.0);
            progress.speed_mps = car.speed_mps;
            progress.outcome = car.x_m >= GOAL_M                   ? VLAPS_OUTCOME_ARRIVED
                               : std::abs(car.y_m) > HALF_WIDTH_M  ? VLAPS_OUTCOME_OUT_OF_ROAD
                                                                   : VLAPS_OUTCOME_DRIVING;
            observe(car, seen, run);
            run.finish_tick(seen, progress);
        }
    });
}

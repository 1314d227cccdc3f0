/* libvlaps: a process of a VLAPS run in C.
 *
 * Generated from the messages of the crate shm-config; do not edit. Renew it with
 *     cargo run -p capi --example header > capi/include/vlaps.h
 *
 * docs/foreign.md explains the calls, docs/services.md the services. Units end a name
 * and frames begin it: speed_mps, x_body_m. Angles are counter-clockwise, y is left.
 *
 * Every call returns 0 or more (enum vlaps_answer) when it was carried out, and a
 * negative number (enum vlaps_kind) when it failed; vlaps_last_error says why. All calls
 * of a process come from the thread that joined.
 */
#ifndef VLAPS_H
#define VLAPS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define VLAPS_ASSERT(holds, text) static_assert(holds, text)
extern "C" {
#else
#define VLAPS_ASSERT(holds, text) _Static_assert(holds, text)
#endif

/* The hash of all layouts, codes and constants below. A library with another one refuses to join. */
#define VLAPS_LAYOUT UINT64_C(0xab9fbf9745e490cf)

#define VLAPS_BEAMS_MAX 2048
#define VLAPS_WAYPOINTS_MAX 64
#define VLAPS_PLANNED_MAX 32
#define VLAPS_FEATURES 259

enum vlaps_process {
    VLAPS_PROCESS_SUPERVISOR = 0,
    VLAPS_PROCESS_WORLD = 1,
    VLAPS_PROCESS_PLANNER = 2,
    VLAPS_PROCESS_CONTROLLER = 3,
    VLAPS_PROCESS_GATE = 4,
    VLAPS_PROCESS_LEARNER = 5,
    VLAPS_PROCESS_RECORDER = 6,
};

enum vlaps_health_state {
    VLAPS_HEALTH_STATE_STARTING = 0,
    VLAPS_HEALTH_STATE_READY = 1,
    VLAPS_HEALTH_STATE_RUNNING = 2,
    VLAPS_HEALTH_STATE_STOPPING = 3,
    VLAPS_HEALTH_STATE_FINISHED = 4,
};

enum vlaps_grant {
    VLAPS_GRANT_NOT_ASKED = 0,
    VLAPS_GRANT_GRANTED = 1,
    VLAPS_GRANT_REFUSED = 2,
};

enum vlaps_part {
    VLAPS_PART_WAIT = 0,
    VLAPS_PART_ADMIT = 1,
    VLAPS_PART_GRID = 2,
    VLAPS_PART_SEARCH = 3,
    VLAPS_PART_DECIDE = 4,
    VLAPS_PART_SEND = 5,
    VLAPS_PART_MOVE = 6,
    VLAPS_PART_OBSERVE = 7,
};

enum vlaps_scheduling {
    VLAPS_SCHEDULING_ORDINARY = 0,
    VLAPS_SCHEDULING_FIFO = 1,
};

enum vlaps_outcome {
    VLAPS_OUTCOME_DRIVING = 0,
    VLAPS_OUTCOME_ARRIVED = 1,
    VLAPS_OUTCOME_OUT_OF_ROAD = 2,
    VLAPS_OUTCOME_MAX_STEP = 3,
    VLAPS_OUTCOME_STOPPED = 4,
};

enum vlaps_driver {
    VLAPS_DRIVER_EXPERT = 0,
    VLAPS_DRIVER_POLICY = 1,
    VLAPS_DRIVER_BRAKE = 2,
};

enum vlaps_reason {
    VLAPS_REASON_CONFIGURED = 0,
    VLAPS_REASON_ADVISED = 1,
    VLAPS_REASON_UNADVISED = 2,
    VLAPS_REASON_EXPIRED = 3,
    VLAPS_REASON_UNLOADED = 4,
    VLAPS_REASON_FAULTY = 5,
    VLAPS_REASON_VETOED = 6,
    VLAPS_REASON_UNSAFE = 7,
    VLAPS_REASON_BLOCKED = 8,
    VLAPS_REASON_UNPLANNED = 9,
    VLAPS_REASON_BLIND = 10,
    VLAPS_REASON_STOPPING = 11,
    VLAPS_REASON_TAKEOVER = 12,
    VLAPS_REASON_SHADOW = 13,
    VLAPS_REASON_LATE = 14,
    VLAPS_REASON_CONTESTED = 15,
};

enum vlaps_refusal_kind {
    VLAPS_REFUSAL_KIND_CONTENT = 0,
    VLAPS_REFUSAL_KIND_STALE = 1,
    VLAPS_REFUSAL_KIND_FUTURE = 2,
    VLAPS_REFUSAL_KIND_EPISODE = 3,
    VLAPS_REFUSAL_KIND_GRID = 4,
    VLAPS_REFUSAL_KIND_FOREIGN = 5,
};

enum vlaps_bend {
    VLAPS_BEND_STRAIGHT = 0,
    VLAPS_BEND_LEFT = 1,
    VLAPS_BEND_RIGHT = 2,
};

enum vlaps_view {
    VLAPS_VIEW_EGO = 0,
    VLAPS_VIEW_TOP_DOWN = 1,
};

enum vlaps_pixel_format {
    VLAPS_PIXEL_FORMAT_RGB8 = 0,
};

enum vlaps_plan_outcome {
    VLAPS_PLAN_OUTCOME_REACHED = 0,
    VLAPS_PLAN_OUTCOME_PARTIAL = 1,
    VLAPS_PLAN_OUTCOME_BLOCKED = 2,
};

enum vlaps_lateness {
    VLAPS_LATENESS_ON_TIME = 0,
    VLAPS_LATENESS_COUNTED = 1,
    VLAPS_LATENESS_HELD_BACK = 2,
    VLAPS_LATENESS_BRAKED = 3,
};

enum vlaps_preference {
    VLAPS_PREFERENCE_ABSTAIN = 0,
    VLAPS_PREFERENCE_EXPERT = 1,
    VLAPS_PREFERENCE_POLICY = 2,
};

enum vlaps_judge {
    VLAPS_JUDGE_NONE = 0,
    VLAPS_JUDGE_RULES = 1,
    VLAPS_JUDGE_VLM = 2,
    VLAPS_JUDGE_HUMAN = 3,
    VLAPS_JUDGE_RECORDED = 5,
    VLAPS_JUDGE_DISTILLED = 6,
};

enum vlaps_verdict {
    VLAPS_VERDICT_ABSENT = 0,
    VLAPS_VERDICT_CLEAR = 1,
    VLAPS_VERDICT_LEAVES = 2,
    VLAPS_VERDICT_HITS = 3,
};

enum vlaps_policy_state {
    VLAPS_POLICY_STATE_EMPTY = 0,
    VLAPS_POLICY_STATE_SHADOW = 1,
    VLAPS_POLICY_STATE_READY = 2,
    VLAPS_POLICY_STATE_REFUSED = 3,
    VLAPS_POLICY_STATE_ROLLED_BACK = 4,
};

enum vlaps_admission {
    VLAPS_ADMISSION_ABSENT = 0,
    VLAPS_ADMISSION_ADMITTED = 1,
    VLAPS_ADMISSION_REFUSED = 2,
};

enum vlaps_intent {
    VLAPS_INTENT_DRIVE = 0,
    VLAPS_INTENT_STOP = 1,
    VLAPS_INTENT_CONTESTED = 2,
};

enum vlaps_stage {
    VLAPS_STAGE_UNLOADED = 0,
    VLAPS_STAGE_SHADOW = 1,
    VLAPS_STAGE_ACTIVE = 2,
};

enum vlaps_fault_kind {
    VLAPS_FAULT_KIND_HANG = 0,
    VLAPS_FAULT_KIND_SLOW = 1,
    VLAPS_FAULT_KIND_PANIC = 2,
    VLAPS_FAULT_KIND_ALLOCATION = 3,
    VLAPS_FAULT_KIND_SPIN = 4,
};

enum vlaps_answer {
    VLAPS_OK = 0,
    VLAPS_NONE = 1,
    VLAPS_ENDED = 2,
};

enum vlaps_kind {
    VLAPS_REFUSED = -1,
    VLAPS_INVALID = -2,
    VLAPS_OTHER_LAYOUT = -3,
    VLAPS_FAILED = -4,
    VLAPS_PANICKED = -5,
};

enum vlaps_use {
    VLAPS_NEWEST = 0,
    VLAPS_EVERY = 1,
    VLAPS_WRITE = 2,
};

typedef struct vlaps_header {
    /* The tick of the run this belongs to; the grid index in real time. */
    uint64_t tick;
    /* When it was taken, on the run's clock, ns. */
    uint64_t taken_ns;
    /* Counts this producer's messages from 1; a gap is a loss. */
    uint64_t sequence;
    /* The episode of the run, from 0. */
    uint32_t episode;
    /* Process id of the producer; a change means it was restarted. */
    uint32_t producer;
} vlaps_header;
VLAPS_ASSERT(sizeof(vlaps_header) == 32, "vlaps_header");
VLAPS_ASSERT(offsetof(vlaps_header, tick) == 0, "vlaps_header.tick");
VLAPS_ASSERT(offsetof(vlaps_header, taken_ns) == 8, "vlaps_header.taken_ns");
VLAPS_ASSERT(offsetof(vlaps_header, sequence) == 16, "vlaps_header.sequence");
VLAPS_ASSERT(offsetof(vlaps_header, episode) == 24, "vlaps_header.episode");
VLAPS_ASSERT(offsetof(vlaps_header, producer) == 28, "vlaps_header.producer");

typedef struct vlaps_ego {
    /* Position in the world (odometry) frame, m. */
    double x_world_m;
    /* Position in the world (odometry) frame, m. */
    double y_world_m;
    /* Heading in the world frame, rad, counter-clockwise. */
    double heading_world_rad;
    /* Speed along the heading, m/s. */
    double speed_mps;
    /* Turning rate, rad/s, counter-clockwise; over the last period. */
    double yaw_rate_radps;
    /* The steering last applied, normalised. */
    double steer;
    /* The pedal last applied, normalised. */
    double pedal;
} vlaps_ego;
VLAPS_ASSERT(sizeof(vlaps_ego) == 56, "vlaps_ego");
VLAPS_ASSERT(offsetof(vlaps_ego, x_world_m) == 0, "vlaps_ego.x_world_m");
VLAPS_ASSERT(offsetof(vlaps_ego, y_world_m) == 8, "vlaps_ego.y_world_m");
VLAPS_ASSERT(offsetof(vlaps_ego, heading_world_rad) == 16, "vlaps_ego.heading_world_rad");
VLAPS_ASSERT(offsetof(vlaps_ego, speed_mps) == 24, "vlaps_ego.speed_mps");
VLAPS_ASSERT(offsetof(vlaps_ego, yaw_rate_radps) == 32, "vlaps_ego.yaw_rate_radps");
VLAPS_ASSERT(offsetof(vlaps_ego, steer) == 40, "vlaps_ego.steer");
VLAPS_ASSERT(offsetof(vlaps_ego, pedal) == 48, "vlaps_ego.pedal");

typedef struct vlaps_road {
    /* Distance from the car's centre to the road's left edge, m; negative beyond it. */
    double left_m;
    /* Distance from the car's centre to the road's right edge, m; negative beyond it. */
    double right_m;
    /* Heading of the car in the road frame, rad: positive points left of the lane. */
    double heading_rad;
    /* Offset from the centre of the car's lane, m, positive **left**. */
    double offset_m;
    /* Width of a lane, m: a checkpoint's bend is that of the leftmost lane's centre
     * line, half of it from the left edge. 0 for a road without lanes, whose bend is
     * that of its left edge. */
    double lane_width_m;
} vlaps_road;
VLAPS_ASSERT(sizeof(vlaps_road) == 40, "vlaps_road");
VLAPS_ASSERT(offsetof(vlaps_road, left_m) == 0, "vlaps_road.left_m");
VLAPS_ASSERT(offsetof(vlaps_road, right_m) == 8, "vlaps_road.right_m");
VLAPS_ASSERT(offsetof(vlaps_road, heading_rad) == 16, "vlaps_road.heading_rad");
VLAPS_ASSERT(offsetof(vlaps_road, offset_m) == 24, "vlaps_road.offset_m");
VLAPS_ASSERT(offsetof(vlaps_road, lane_width_m) == 32, "vlaps_road.lane_width_m");

typedef struct vlaps_checkpoint {
    /* Position, m, forward of the car. */
    double x_body_m;
    /* Position, m, left of the car. */
    double y_body_m;
    /* Radius of the bend of the road's leftmost lane, m; 0 when straight. */
    double bend_radius_m;
    /* Angle of the bend, rad, never negative; 0 when straight. */
    double bend_angle_rad;
    /* A `Bend`. */
    uint32_t bend;
    /* Not used. */
    uint32_t reserved;
} vlaps_checkpoint;
VLAPS_ASSERT(sizeof(vlaps_checkpoint) == 40, "vlaps_checkpoint");
VLAPS_ASSERT(offsetof(vlaps_checkpoint, x_body_m) == 0, "vlaps_checkpoint.x_body_m");
VLAPS_ASSERT(offsetof(vlaps_checkpoint, y_body_m) == 8, "vlaps_checkpoint.y_body_m");
VLAPS_ASSERT(offsetof(vlaps_checkpoint, bend_radius_m) == 16, "vlaps_checkpoint.bend_radius_m");
VLAPS_ASSERT(offsetof(vlaps_checkpoint, bend_angle_rad) == 24, "vlaps_checkpoint.bend_angle_rad");
VLAPS_ASSERT(offsetof(vlaps_checkpoint, bend) == 32, "vlaps_checkpoint.bend");
VLAPS_ASSERT(offsetof(vlaps_checkpoint, reserved) == 36, "vlaps_checkpoint.reserved");

typedef struct vlaps_observation {
    /* Which tick, and when. */
    vlaps_header header;
    /* The instant of the run's grid at which this tick was due, ns on the
     * machine's clock. A world with a higher rate than the run publishes several
     * observations of a tick; this instant and the tick are the same in all of
     * them. */
    uint64_t scheduled_ns;
    /* When the world's tick began, ns on the machine's clock. */
    uint64_t released_ns;
    /* When the tick's first observation was published, which woke its readers,
     * ns on the machine's clock. The same in all observations of a tick. */
    uint64_t published_ns;
    /* The car. */
    vlaps_ego ego;
    /* Its road. */
    vlaps_road road;
    /* The next two checkpoints of the route; the last one repeats. */
    vlaps_checkpoint checkpoints[2];
    /* Range of a beam that hits nothing, m. */
    float lidar_max_m;
    /* How many beams are valid; evenly spaced, their angles are those of
     * `Observation::fan`. */
    uint32_t beam_count;
    /* Angle from the first beam to the last, rad; a full circle from 2π on, whose
     * first beam looks along the scanner's heading. Else it looks along the right
     * limit of the field of view. Counter-clockwise. */
    double field_of_view_rad;
    /* Heading of the scanner in the body frame, rad. */
    double scanner_heading_rad;
    /* Where the beams begin, m forward of the car's centre. */
    double scanner_x_body_m;
    /* Where the beams begin, m left of the car's centre. */
    double scanner_y_body_m;
    /* Range of beam k from where the beams begin, m, at most `lidar_max_m`. A beam
     * at `lidar_max_m` hit nothing, or its return was dropped. */
    float ranges_m[2048];
} vlaps_observation;
VLAPS_ASSERT(sizeof(vlaps_observation) == 8464, "vlaps_observation");
VLAPS_ASSERT(offsetof(vlaps_observation, header) == 0, "vlaps_observation.header");
VLAPS_ASSERT(offsetof(vlaps_observation, scheduled_ns) == 32, "vlaps_observation.scheduled_ns");
VLAPS_ASSERT(offsetof(vlaps_observation, released_ns) == 40, "vlaps_observation.released_ns");
VLAPS_ASSERT(offsetof(vlaps_observation, published_ns) == 48, "vlaps_observation.published_ns");
VLAPS_ASSERT(offsetof(vlaps_observation, ego) == 56, "vlaps_observation.ego");
VLAPS_ASSERT(offsetof(vlaps_observation, road) == 112, "vlaps_observation.road");
VLAPS_ASSERT(offsetof(vlaps_observation, checkpoints) == 152, "vlaps_observation.checkpoints");
VLAPS_ASSERT(offsetof(vlaps_observation, lidar_max_m) == 232, "vlaps_observation.lidar_max_m");
VLAPS_ASSERT(offsetof(vlaps_observation, beam_count) == 236, "vlaps_observation.beam_count");
VLAPS_ASSERT(offsetof(vlaps_observation, field_of_view_rad) == 240, "vlaps_observation.field_of_view_rad");
VLAPS_ASSERT(offsetof(vlaps_observation, scanner_heading_rad) == 248, "vlaps_observation.scanner_heading_rad");
VLAPS_ASSERT(offsetof(vlaps_observation, scanner_x_body_m) == 256, "vlaps_observation.scanner_x_body_m");
VLAPS_ASSERT(offsetof(vlaps_observation, scanner_y_body_m) == 264, "vlaps_observation.scanner_y_body_m");
VLAPS_ASSERT(offsetof(vlaps_observation, ranges_m) == 272, "vlaps_observation.ranges_m");

typedef struct vlaps_waypoint {
    /* m, forward, in the body frame at the plan's observation. */
    double x_body_m;
    /* m, left, in the body frame at the plan's observation. */
    double y_body_m;
    /* Desired speed at this point, m/s. */
    double speed_mps;
} vlaps_waypoint;
VLAPS_ASSERT(sizeof(vlaps_waypoint) == 24, "vlaps_waypoint");
VLAPS_ASSERT(offsetof(vlaps_waypoint, x_body_m) == 0, "vlaps_waypoint.x_body_m");
VLAPS_ASSERT(offsetof(vlaps_waypoint, y_body_m) == 8, "vlaps_waypoint.y_body_m");
VLAPS_ASSERT(offsetof(vlaps_waypoint, speed_mps) == 16, "vlaps_waypoint.speed_mps");

typedef struct vlaps_planned_action {
    /* Normalised, in [-1, 1], positive left. */
    double steer;
    /* Normalised, in [-1, 1], positive drives. */
    double pedal;
} vlaps_planned_action;
VLAPS_ASSERT(sizeof(vlaps_planned_action) == 16, "vlaps_planned_action");
VLAPS_ASSERT(offsetof(vlaps_planned_action, steer) == 0, "vlaps_planned_action.steer");
VLAPS_ASSERT(offsetof(vlaps_planned_action, pedal) == 8, "vlaps_planned_action.pedal");

typedef struct vlaps_plan {
    /* The observation's tick; taken when the observation was. */
    vlaps_header header;
    /* Pose of the body frame of the waypoints in the world frame: m. */
    double origin_x_world_m;
    /* m. */
    double origin_y_world_m;
    /* rad. */
    double origin_heading_world_rad;
    /* The goal searched for, m forward. */
    double goal_x_body_m;
    /* The goal searched for, m left. */
    double goal_y_body_m;
    /* Length of the path, m. */
    double cost_m;
    /* Time the planner took, ns on the machine's clock. */
    uint64_t planning_ns;
    /* A `PlanOutcome`. */
    uint32_t outcome;
    /* Iterations spent. */
    uint32_t iterations;
    /* Nodes of the tree. */
    uint32_t nodes;
    /* How many waypoints are valid. */
    uint32_t waypoint_count;
    /* The path from the body's origin outwards; the origin itself first. */
    vlaps_waypoint waypoints[64];
    /* How long each action holds, s. */
    double action_step_s;
    /* The number of valid actions; 0 for a plan that is only a path. */
    uint32_t action_count;
    /* A `Lateness`: of the plan. */
    uint32_t lateness;
    /* The actions from the plan's observation on, in order. */
    vlaps_planned_action actions[32];
} vlaps_plan;
VLAPS_ASSERT(sizeof(vlaps_plan) == 2168, "vlaps_plan");
VLAPS_ASSERT(offsetof(vlaps_plan, header) == 0, "vlaps_plan.header");
VLAPS_ASSERT(offsetof(vlaps_plan, origin_x_world_m) == 32, "vlaps_plan.origin_x_world_m");
VLAPS_ASSERT(offsetof(vlaps_plan, origin_y_world_m) == 40, "vlaps_plan.origin_y_world_m");
VLAPS_ASSERT(offsetof(vlaps_plan, origin_heading_world_rad) == 48, "vlaps_plan.origin_heading_world_rad");
VLAPS_ASSERT(offsetof(vlaps_plan, goal_x_body_m) == 56, "vlaps_plan.goal_x_body_m");
VLAPS_ASSERT(offsetof(vlaps_plan, goal_y_body_m) == 64, "vlaps_plan.goal_y_body_m");
VLAPS_ASSERT(offsetof(vlaps_plan, cost_m) == 72, "vlaps_plan.cost_m");
VLAPS_ASSERT(offsetof(vlaps_plan, planning_ns) == 80, "vlaps_plan.planning_ns");
VLAPS_ASSERT(offsetof(vlaps_plan, outcome) == 88, "vlaps_plan.outcome");
VLAPS_ASSERT(offsetof(vlaps_plan, iterations) == 92, "vlaps_plan.iterations");
VLAPS_ASSERT(offsetof(vlaps_plan, nodes) == 96, "vlaps_plan.nodes");
VLAPS_ASSERT(offsetof(vlaps_plan, waypoint_count) == 100, "vlaps_plan.waypoint_count");
VLAPS_ASSERT(offsetof(vlaps_plan, waypoints) == 104, "vlaps_plan.waypoints");
VLAPS_ASSERT(offsetof(vlaps_plan, action_step_s) == 1640, "vlaps_plan.action_step_s");
VLAPS_ASSERT(offsetof(vlaps_plan, action_count) == 1648, "vlaps_plan.action_count");
VLAPS_ASSERT(offsetof(vlaps_plan, lateness) == 1652, "vlaps_plan.lateness");
VLAPS_ASSERT(offsetof(vlaps_plan, actions) == 1656, "vlaps_plan.actions");

typedef struct vlaps_command {
    /* The observation's tick; taken when the command was given. */
    vlaps_header header;
    /* Steering, normalised, [-1, 1], positive left. */
    double steer;
    /* Pedal, normalised, [-1, 1], negative brakes. */
    double pedal;
    /* A `Driver`. */
    uint32_t driver;
    /* A `Reason`. */
    uint32_t reason;
} vlaps_command;
VLAPS_ASSERT(sizeof(vlaps_command) == 56, "vlaps_command");
VLAPS_ASSERT(offsetof(vlaps_command, header) == 0, "vlaps_command.header");
VLAPS_ASSERT(offsetof(vlaps_command, steer) == 32, "vlaps_command.steer");
VLAPS_ASSERT(offsetof(vlaps_command, pedal) == 40, "vlaps_command.pedal");
VLAPS_ASSERT(offsetof(vlaps_command, driver) == 48, "vlaps_command.driver");
VLAPS_ASSERT(offsetof(vlaps_command, reason) == 52, "vlaps_command.reason");

typedef struct vlaps_pd_state {
    /* Heading to the lookahead waypoint, rad. */
    double heading_rad;
    /* Desired speed minus the car's, m/s. */
    double speed_mps;
    /* The goal that is tracked, world frame, x, m. */
    double goal_x_world_m;
    /* The goal that is tracked, world frame, y, m. */
    double goal_y_world_m;
    /* When the observation of the errors was taken, ns. */
    uint64_t taken_ns;
    /* Its episode. */
    uint32_t episode;
    /* 1 when there are errors, else 0. */
    uint32_t present;
} vlaps_pd_state;
VLAPS_ASSERT(sizeof(vlaps_pd_state) == 48, "vlaps_pd_state");
VLAPS_ASSERT(offsetof(vlaps_pd_state, heading_rad) == 0, "vlaps_pd_state.heading_rad");
VLAPS_ASSERT(offsetof(vlaps_pd_state, speed_mps) == 8, "vlaps_pd_state.speed_mps");
VLAPS_ASSERT(offsetof(vlaps_pd_state, goal_x_world_m) == 16, "vlaps_pd_state.goal_x_world_m");
VLAPS_ASSERT(offsetof(vlaps_pd_state, goal_y_world_m) == 24, "vlaps_pd_state.goal_y_world_m");
VLAPS_ASSERT(offsetof(vlaps_pd_state, taken_ns) == 32, "vlaps_pd_state.taken_ns");
VLAPS_ASSERT(offsetof(vlaps_pd_state, episode) == 40, "vlaps_pd_state.episode");
VLAPS_ASSERT(offsetof(vlaps_pd_state, present) == 44, "vlaps_pd_state.present");

typedef struct vlaps_transfer_state {
    /* Steering, normalised. */
    double steer;
    /* Pedal, normalised. */
    double pedal;
    /* A `Driver`. */
    uint32_t driver;
    /* The episode of that command. */
    uint32_t episode;
    /* 1 when there is a command, else 0. */
    uint32_t present;
    /* 1 while the command moves towards the new driver's, else 0. */
    uint32_t is_easing;
} vlaps_transfer_state;
VLAPS_ASSERT(sizeof(vlaps_transfer_state) == 32, "vlaps_transfer_state");
VLAPS_ASSERT(offsetof(vlaps_transfer_state, steer) == 0, "vlaps_transfer_state.steer");
VLAPS_ASSERT(offsetof(vlaps_transfer_state, pedal) == 8, "vlaps_transfer_state.pedal");
VLAPS_ASSERT(offsetof(vlaps_transfer_state, driver) == 16, "vlaps_transfer_state.driver");
VLAPS_ASSERT(offsetof(vlaps_transfer_state, episode) == 20, "vlaps_transfer_state.episode");
VLAPS_ASSERT(offsetof(vlaps_transfer_state, present) == 24, "vlaps_transfer_state.present");
VLAPS_ASSERT(offsetof(vlaps_transfer_state, is_easing) == 28, "vlaps_transfer_state.is_easing");

typedef struct vlaps_before {
    /* The state of the PD controller. */
    vlaps_pd_state pd;
    /* The state of the hand-over. */
    vlaps_transfer_state transfer;
    /* Messages refused since the controller started. */
    uint64_t refused;
    /* 1 when an observation was admitted since then, else 0. */
    uint32_t has_observation;
    /* 1 when a plan was admitted since then, else 0. */
    uint32_t has_plan;
    /* 1 when advice was admitted since then, else 0. */
    uint32_t has_advice;
    /* Not used. */
    uint32_t reserved;
} vlaps_before;
VLAPS_ASSERT(sizeof(vlaps_before) == 104, "vlaps_before");
VLAPS_ASSERT(offsetof(vlaps_before, pd) == 0, "vlaps_before.pd");
VLAPS_ASSERT(offsetof(vlaps_before, transfer) == 48, "vlaps_before.transfer");
VLAPS_ASSERT(offsetof(vlaps_before, refused) == 80, "vlaps_before.refused");
VLAPS_ASSERT(offsetof(vlaps_before, has_observation) == 88, "vlaps_before.has_observation");
VLAPS_ASSERT(offsetof(vlaps_before, has_plan) == 92, "vlaps_before.has_plan");
VLAPS_ASSERT(offsetof(vlaps_before, has_advice) == 96, "vlaps_before.has_advice");
VLAPS_ASSERT(offsetof(vlaps_before, reserved) == 100, "vlaps_before.reserved");

typedef struct vlaps_entry {
    /* The clock at which the port admitted the message, ns on the run's clock; 0
     * when none arrived. */
    uint64_t port_ns;
    /* An `Admission`: the tick's own check, at the instant in the step's header. */
    uint32_t admission;
    /* Not used. */
    uint32_t reserved;
} vlaps_entry;
VLAPS_ASSERT(sizeof(vlaps_entry) == 16, "vlaps_entry");
VLAPS_ASSERT(offsetof(vlaps_entry, port_ns) == 0, "vlaps_entry.port_ns");
VLAPS_ASSERT(offsetof(vlaps_entry, admission) == 8, "vlaps_entry.admission");
VLAPS_ASSERT(offsetof(vlaps_entry, reserved) == 12, "vlaps_entry.reserved");

typedef struct vlaps_advice {
    /* The tick of the last step that the gate has read. */
    vlaps_header header;
    /* The tick the judge was asked about. */
    uint64_t question_tick;
    /* When the observation of the question was taken, ns. */
    uint64_t question_taken_ns;
    /* When the answer arrived, ns on the run's clock. */
    uint64_t answered_ns;
    /* The first instant at which the advice no longer holds, ns. */
    uint64_t holds_until_ns;
    /* When the gate considered the step, ns on the run's clock: its answers and their
     * hysteresis depend on it, so that advice can be recomputed. */
    uint64_t considered_ns;
    /* Questions answered so far, failures and abstentions included. */
    uint64_t answers;
    /* A `Preference`: the driver to choose, after dwell time and confirmations. */
    uint32_t preference;
    /* A `Judge`. */
    uint32_t judge;
    /* The steps that the newest answer labels begin here: when the observation of
     * its question was taken, ns. */
    uint64_t label_from_ns;
    /* They end before this instant, ns. */
    uint64_t label_until_ns;
    /* A `Preference`: the newest answer. */
    uint32_t label;
    /* Not used. */
    uint32_t reserved;
} vlaps_advice;
VLAPS_ASSERT(sizeof(vlaps_advice) == 112, "vlaps_advice");
VLAPS_ASSERT(offsetof(vlaps_advice, header) == 0, "vlaps_advice.header");
VLAPS_ASSERT(offsetof(vlaps_advice, question_tick) == 32, "vlaps_advice.question_tick");
VLAPS_ASSERT(offsetof(vlaps_advice, question_taken_ns) == 40, "vlaps_advice.question_taken_ns");
VLAPS_ASSERT(offsetof(vlaps_advice, answered_ns) == 48, "vlaps_advice.answered_ns");
VLAPS_ASSERT(offsetof(vlaps_advice, holds_until_ns) == 56, "vlaps_advice.holds_until_ns");
VLAPS_ASSERT(offsetof(vlaps_advice, considered_ns) == 64, "vlaps_advice.considered_ns");
VLAPS_ASSERT(offsetof(vlaps_advice, answers) == 72, "vlaps_advice.answers");
VLAPS_ASSERT(offsetof(vlaps_advice, preference) == 80, "vlaps_advice.preference");
VLAPS_ASSERT(offsetof(vlaps_advice, judge) == 84, "vlaps_advice.judge");
VLAPS_ASSERT(offsetof(vlaps_advice, label_from_ns) == 88, "vlaps_advice.label_from_ns");
VLAPS_ASSERT(offsetof(vlaps_advice, label_until_ns) == 96, "vlaps_advice.label_until_ns");
VLAPS_ASSERT(offsetof(vlaps_advice, label) == 104, "vlaps_advice.label");
VLAPS_ASSERT(offsetof(vlaps_advice, reserved) == 108, "vlaps_advice.reserved");

typedef struct vlaps_takeover {
    /* The newest tick that the supervisor has read; taken when the keys were read. */
    vlaps_header header;
    /* Steering, normalised, [-1, 1], positive left. */
    double steer;
    /* Pedal, normalised, [-1, 1], negative brakes. */
    double pedal;
    /* 1 while the person has taken over, else 0. */
    uint32_t active;
    /* Not used. */
    uint32_t reserved;
} vlaps_takeover;
VLAPS_ASSERT(sizeof(vlaps_takeover) == 56, "vlaps_takeover");
VLAPS_ASSERT(offsetof(vlaps_takeover, header) == 0, "vlaps_takeover.header");
VLAPS_ASSERT(offsetof(vlaps_takeover, steer) == 32, "vlaps_takeover.steer");
VLAPS_ASSERT(offsetof(vlaps_takeover, pedal) == 40, "vlaps_takeover.pedal");
VLAPS_ASSERT(offsetof(vlaps_takeover, active) == 48, "vlaps_takeover.active");
VLAPS_ASSERT(offsetof(vlaps_takeover, reserved) == 52, "vlaps_takeover.reserved");

typedef struct vlaps_proposal {
    /* Steering, normalised. */
    double steer;
    /* Pedal, normalised. */
    double pedal;
    /* 1 when there is a proposal, else 0. */
    uint32_t present;
    /* Not used. */
    uint32_t reserved;
} vlaps_proposal;
VLAPS_ASSERT(sizeof(vlaps_proposal) == 24, "vlaps_proposal");
VLAPS_ASSERT(offsetof(vlaps_proposal, steer) == 0, "vlaps_proposal.steer");
VLAPS_ASSERT(offsetof(vlaps_proposal, pedal) == 8, "vlaps_proposal.pedal");
VLAPS_ASSERT(offsetof(vlaps_proposal, present) == 16, "vlaps_proposal.present");
VLAPS_ASSERT(offsetof(vlaps_proposal, reserved) == 20, "vlaps_proposal.reserved");

typedef struct vlaps_assessment {
    /* Least distance between footprint and any lidar return, m; negative
     * inside; `CLEARANCE_MAX_M` when none is near. */
    double clearance_m;
    /* Time to the first contact or to leaving the road, s; the horizon
     * when there is none. */
    double safe_s;
    /* Least distance between the car's centre line corners and the road's
     * edge, m; negative beyond it. */
    double edge_m;
    /* Progress towards the next checkpoint, m. */
    double progress_m;
    /* A `Verdict`. */
    uint32_t verdict;
    /* 1 when the safety check vetoes this proposal, else 0. */
    uint32_t veto;
} vlaps_assessment;
VLAPS_ASSERT(sizeof(vlaps_assessment) == 40, "vlaps_assessment");
VLAPS_ASSERT(offsetof(vlaps_assessment, clearance_m) == 0, "vlaps_assessment.clearance_m");
VLAPS_ASSERT(offsetof(vlaps_assessment, safe_s) == 8, "vlaps_assessment.safe_s");
VLAPS_ASSERT(offsetof(vlaps_assessment, edge_m) == 16, "vlaps_assessment.edge_m");
VLAPS_ASSERT(offsetof(vlaps_assessment, progress_m) == 24, "vlaps_assessment.progress_m");
VLAPS_ASSERT(offsetof(vlaps_assessment, verdict) == 32, "vlaps_assessment.verdict");
VLAPS_ASSERT(offsetof(vlaps_assessment, veto) == 36, "vlaps_assessment.veto");

typedef struct vlaps_shadow_proposal {
    /* Their proposal. */
    vlaps_proposal proposal;
    /* Its verdict. */
    vlaps_assessment assessment;
    /* Their version; 0 when none were asked. */
    uint64_t weights_version;
    /* First 8 bytes of their SHA-256; 0 for none. */
    uint64_t weights_hash;
} vlaps_shadow_proposal;
VLAPS_ASSERT(sizeof(vlaps_shadow_proposal) == 80, "vlaps_shadow_proposal");
VLAPS_ASSERT(offsetof(vlaps_shadow_proposal, proposal) == 0, "vlaps_shadow_proposal.proposal");
VLAPS_ASSERT(offsetof(vlaps_shadow_proposal, assessment) == 24, "vlaps_shadow_proposal.assessment");
VLAPS_ASSERT(offsetof(vlaps_shadow_proposal, weights_version) == 64, "vlaps_shadow_proposal.weights_version");
VLAPS_ASSERT(offsetof(vlaps_shadow_proposal, weights_hash) == 72, "vlaps_shadow_proposal.weights_hash");

typedef struct vlaps_timings {
    /* The instant of the grid at which this tick was due. */
    uint64_t scheduled_ns;
    /* When the world's tick began; 0 when there was no observation. */
    uint64_t released_ns;
    /* When the controller began the tick. */
    uint64_t started_ns;
    /* When the plan had arrived, or the wait for it ended. */
    uint64_t planned_ns;
    /* When proposals and verdicts were complete. */
    uint64_t decided_ns;
    /* When the command was sent. */
    uint64_t commanded_ns;
} vlaps_timings;
VLAPS_ASSERT(sizeof(vlaps_timings) == 48, "vlaps_timings");
VLAPS_ASSERT(offsetof(vlaps_timings, scheduled_ns) == 0, "vlaps_timings.scheduled_ns");
VLAPS_ASSERT(offsetof(vlaps_timings, released_ns) == 8, "vlaps_timings.released_ns");
VLAPS_ASSERT(offsetof(vlaps_timings, started_ns) == 16, "vlaps_timings.started_ns");
VLAPS_ASSERT(offsetof(vlaps_timings, planned_ns) == 24, "vlaps_timings.planned_ns");
VLAPS_ASSERT(offsetof(vlaps_timings, decided_ns) == 32, "vlaps_timings.decided_ns");
VLAPS_ASSERT(offsetof(vlaps_timings, commanded_ns) == 40, "vlaps_timings.commanded_ns");

typedef struct vlaps_step {
    /* The controller's tick; taken when it admitted its inputs. */
    vlaps_header header;
    /* The state with which it began. */
    vlaps_before before;
    /* The check of the observation. */
    vlaps_entry observation_entry;
    /* The check of the plan. */
    vlaps_entry plan_entry;
    /* The check of the advice. */
    vlaps_entry advice_entry;
    /* The check of the takeover. */
    vlaps_entry takeover_entry;
    /* The plan; the last admitted one when none arrived. */
    vlaps_plan plan;
    /* The advice in force. */
    vlaps_advice advice;
    /* The newest takeover message. */
    vlaps_takeover takeover;
    /* The expert's proposal, or the person's action after a takeover. */
    vlaps_proposal expert;
    /* The proposal of the active policy. */
    vlaps_proposal policy;
    /* The safety check of the expert's proposal. */
    vlaps_assessment expert_assessment;
    /* The safety check of the policy's proposal. */
    vlaps_assessment policy_assessment;
    /* The proposal of the policy in shadow mode. */
    vlaps_shadow_proposal shadow;
    /* The command, its driver and its reason. */
    vlaps_command command;
    /* The instants of the tick. */
    vlaps_timings timings;
    /* Age of the observation, ns; `u64::MAX` when there is none. */
    uint64_t observation_age_ns;
    /* Age of the plan, ns; `u64::MAX` when there is none. */
    uint64_t plan_age_ns;
    /* Age of the advice's question, ns; `u64::MAX` when there is none. */
    uint64_t advice_age_ns;
    /* Version of the weights that proposed; 0 for none. */
    uint64_t weights_version;
    /* First 8 bytes of their SHA-256; 0 for none. */
    uint64_t weights_hash;
    /* Ticks of the grid the controller skipped since it started. */
    uint64_t skipped;
    /* Messages the controller refused since it started. */
    uint64_t refused;
    /* Messages that the ports refused since the tick before. */
    uint64_t refused_at_ports;
    /* An `Intent`: what the process asked of the tick. */
    uint32_t intent;
    /* A `Stage`: of the policy. */
    uint32_t stage;
    /* 1 when a person's action replaces the expert's, else 0. */
    uint32_t takeover_used;
    /* A `Lateness`: of the command. */
    uint32_t lateness;
    /* How the bodies of the observation move, as a policy takes it: for each of 60 sectors
     * the velocity of the nearest return, forward and to the left, where 0 is -20 m/s, 0.5
     * is rest and 1 is 20 m/s. All at rest unless a policy is loaded that takes it. */
    float motion[120];
    /* The observation; the last admitted one when none arrived. It ends the step, so that
     * beams which the scanner does not have are not sent. */
    vlaps_observation observation;
} vlaps_step;
VLAPS_ASSERT(sizeof(vlaps_step) == 11872, "vlaps_step");
VLAPS_ASSERT(offsetof(vlaps_step, header) == 0, "vlaps_step.header");
VLAPS_ASSERT(offsetof(vlaps_step, before) == 32, "vlaps_step.before");
VLAPS_ASSERT(offsetof(vlaps_step, observation_entry) == 136, "vlaps_step.observation_entry");
VLAPS_ASSERT(offsetof(vlaps_step, plan_entry) == 152, "vlaps_step.plan_entry");
VLAPS_ASSERT(offsetof(vlaps_step, advice_entry) == 168, "vlaps_step.advice_entry");
VLAPS_ASSERT(offsetof(vlaps_step, takeover_entry) == 184, "vlaps_step.takeover_entry");
VLAPS_ASSERT(offsetof(vlaps_step, plan) == 200, "vlaps_step.plan");
VLAPS_ASSERT(offsetof(vlaps_step, advice) == 2368, "vlaps_step.advice");
VLAPS_ASSERT(offsetof(vlaps_step, takeover) == 2480, "vlaps_step.takeover");
VLAPS_ASSERT(offsetof(vlaps_step, expert) == 2536, "vlaps_step.expert");
VLAPS_ASSERT(offsetof(vlaps_step, policy) == 2560, "vlaps_step.policy");
VLAPS_ASSERT(offsetof(vlaps_step, expert_assessment) == 2584, "vlaps_step.expert_assessment");
VLAPS_ASSERT(offsetof(vlaps_step, policy_assessment) == 2624, "vlaps_step.policy_assessment");
VLAPS_ASSERT(offsetof(vlaps_step, shadow) == 2664, "vlaps_step.shadow");
VLAPS_ASSERT(offsetof(vlaps_step, command) == 2744, "vlaps_step.command");
VLAPS_ASSERT(offsetof(vlaps_step, timings) == 2800, "vlaps_step.timings");
VLAPS_ASSERT(offsetof(vlaps_step, observation_age_ns) == 2848, "vlaps_step.observation_age_ns");
VLAPS_ASSERT(offsetof(vlaps_step, plan_age_ns) == 2856, "vlaps_step.plan_age_ns");
VLAPS_ASSERT(offsetof(vlaps_step, advice_age_ns) == 2864, "vlaps_step.advice_age_ns");
VLAPS_ASSERT(offsetof(vlaps_step, weights_version) == 2872, "vlaps_step.weights_version");
VLAPS_ASSERT(offsetof(vlaps_step, weights_hash) == 2880, "vlaps_step.weights_hash");
VLAPS_ASSERT(offsetof(vlaps_step, skipped) == 2888, "vlaps_step.skipped");
VLAPS_ASSERT(offsetof(vlaps_step, refused) == 2896, "vlaps_step.refused");
VLAPS_ASSERT(offsetof(vlaps_step, refused_at_ports) == 2904, "vlaps_step.refused_at_ports");
VLAPS_ASSERT(offsetof(vlaps_step, intent) == 2912, "vlaps_step.intent");
VLAPS_ASSERT(offsetof(vlaps_step, stage) == 2916, "vlaps_step.stage");
VLAPS_ASSERT(offsetof(vlaps_step, takeover_used) == 2920, "vlaps_step.takeover_used");
VLAPS_ASSERT(offsetof(vlaps_step, lateness) == 2924, "vlaps_step.lateness");
VLAPS_ASSERT(offsetof(vlaps_step, motion) == 2928, "vlaps_step.motion");
VLAPS_ASSERT(offsetof(vlaps_step, observation) == 3408, "vlaps_step.observation");

typedef struct vlaps_frame_request {
    /* Tick, episode and instant of the observation to be shown. Where a tick has
     * several instants, 0 ns requests the first. */
    vlaps_header header;
    /* The proposals of the question, the expert's first, for `Foresight`; if one
     * is absent, only the picture is requested. */
    vlaps_proposal proposals[2];
    /* A `View`. */
    uint32_t view;
    /* Pixels across. */
    uint32_t width;
    /* Pixels down. */
    uint32_t height;
    /* Not used. */
    uint32_t reserved;
} vlaps_frame_request;
VLAPS_ASSERT(sizeof(vlaps_frame_request) == 96, "vlaps_frame_request");
VLAPS_ASSERT(offsetof(vlaps_frame_request, header) == 0, "vlaps_frame_request.header");
VLAPS_ASSERT(offsetof(vlaps_frame_request, proposals) == 32, "vlaps_frame_request.proposals");
VLAPS_ASSERT(offsetof(vlaps_frame_request, view) == 80, "vlaps_frame_request.view");
VLAPS_ASSERT(offsetof(vlaps_frame_request, width) == 84, "vlaps_frame_request.width");
VLAPS_ASSERT(offsetof(vlaps_frame_request, height) == 88, "vlaps_frame_request.height");
VLAPS_ASSERT(offsetof(vlaps_frame_request, reserved) == 92, "vlaps_frame_request.reserved");

typedef struct vlaps_camera {
    /* Row-major 3 x 4 matrix from homogeneous body coordinates (m; x forward,
     * y left, z up from the ground) to homogeneous pixels (u right, v down).
     * Its last row gives the distance along the optical axis, m; for
     * orthographic views 1. */
    double pixel_from_body[12];
    /* Position of the camera in the body frame, m. */
    double position_body_m[3];
    /* Points nearer than this are not seen, m; for orthographic views 0. */
    double near_m;
    /* A `View`. */
    uint32_t view;
    /* 1 for an orthographic projection, 0 for a pinhole. */
    uint32_t orthographic;
} vlaps_camera;
VLAPS_ASSERT(sizeof(vlaps_camera) == 136, "vlaps_camera");
VLAPS_ASSERT(offsetof(vlaps_camera, pixel_from_body) == 0, "vlaps_camera.pixel_from_body");
VLAPS_ASSERT(offsetof(vlaps_camera, position_body_m) == 96, "vlaps_camera.position_body_m");
VLAPS_ASSERT(offsetof(vlaps_camera, near_m) == 120, "vlaps_camera.near_m");
VLAPS_ASSERT(offsetof(vlaps_camera, view) == 128, "vlaps_camera.view");
VLAPS_ASSERT(offsetof(vlaps_camera, orthographic) == 132, "vlaps_camera.orthographic");

typedef struct vlaps_frame {
    /* The observation's tick. */
    vlaps_header header;
    /* The camera. */
    vlaps_camera camera;
    /* Pixels across. */
    uint32_t width;
    /* Pixels down. */
    uint32_t height;
    /* A `PixelFormat`. */
    uint32_t format;
    /* Not used. */
    uint32_t reserved;
    /* Rows from the top, no padding between them. */
    uint8_t pixels[2073600];
    /* Not used; keeps the size a multiple of eight. */
    uint64_t end;
} vlaps_frame;
VLAPS_ASSERT(sizeof(vlaps_frame) == 2073792, "vlaps_frame");
VLAPS_ASSERT(offsetof(vlaps_frame, header) == 0, "vlaps_frame.header");
VLAPS_ASSERT(offsetof(vlaps_frame, camera) == 32, "vlaps_frame.camera");
VLAPS_ASSERT(offsetof(vlaps_frame, width) == 168, "vlaps_frame.width");
VLAPS_ASSERT(offsetof(vlaps_frame, height) == 172, "vlaps_frame.height");
VLAPS_ASSERT(offsetof(vlaps_frame, format) == 176, "vlaps_frame.format");
VLAPS_ASSERT(offsetof(vlaps_frame, reserved) == 180, "vlaps_frame.reserved");
VLAPS_ASSERT(offsetof(vlaps_frame, pixels) == 184, "vlaps_frame.pixels");
VLAPS_ASSERT(offsetof(vlaps_frame, end) == 2073784, "vlaps_frame.end");

typedef struct vlaps_outlook {
    /* Time until the end of the first tick in which a vehicle or an object is
     * touched, s; the horizon when none is. */
    double contact_s;
    /* Time until the car is out of the road, s; the horizon when it stays.
     * That ends the episode: nothing is touched afterwards. */
    double out_s;
    /* Share of the route gained, [-1, 1]. */
    double completion;
} vlaps_outlook;
VLAPS_ASSERT(sizeof(vlaps_outlook) == 24, "vlaps_outlook");
VLAPS_ASSERT(offsetof(vlaps_outlook, contact_s) == 0, "vlaps_outlook.contact_s");
VLAPS_ASSERT(offsetof(vlaps_outlook, out_s) == 8, "vlaps_outlook.out_s");
VLAPS_ASSERT(offsetof(vlaps_outlook, completion) == 16, "vlaps_outlook.completion");

typedef struct vlaps_foresight {
    /* Tick and episode of the question. */
    vlaps_header header;
    /* How long each proposal is held, s. */
    double horizon_s;
    /* The results, the expert's first. */
    vlaps_outlook outlooks[2];
} vlaps_foresight;
VLAPS_ASSERT(sizeof(vlaps_foresight) == 88, "vlaps_foresight");
VLAPS_ASSERT(offsetof(vlaps_foresight, header) == 0, "vlaps_foresight.header");
VLAPS_ASSERT(offsetof(vlaps_foresight, horizon_s) == 32, "vlaps_foresight.horizon_s");
VLAPS_ASSERT(offsetof(vlaps_foresight, outlooks) == 40, "vlaps_foresight.outlooks");

typedef struct vlaps_weights {
    /* When it was offered. */
    vlaps_header header;
    /* The version; it grows with every offer of a run. */
    uint64_t version;
    /* How many bytes are valid. */
    uint64_t byte_count;
    /* SHA-256 of the valid bytes. */
    uint8_t sha256[32];
    /* The file. */
    uint8_t bytes[8388608];
    /* Not used; keeps the size a multiple of eight. */
    uint64_t end;
} vlaps_weights;
VLAPS_ASSERT(sizeof(vlaps_weights) == 8388696, "vlaps_weights");
VLAPS_ASSERT(offsetof(vlaps_weights, header) == 0, "vlaps_weights.header");
VLAPS_ASSERT(offsetof(vlaps_weights, version) == 32, "vlaps_weights.version");
VLAPS_ASSERT(offsetof(vlaps_weights, byte_count) == 40, "vlaps_weights.byte_count");
VLAPS_ASSERT(offsetof(vlaps_weights, sha256) == 48, "vlaps_weights.sha256");
VLAPS_ASSERT(offsetof(vlaps_weights, bytes) == 80, "vlaps_weights.bytes");
VLAPS_ASSERT(offsetof(vlaps_weights, end) == 8388688, "vlaps_weights.end");

typedef struct vlaps_learning {
    /* Its tick is that of the last step considered. */
    vlaps_header header;
    /* Steps driven as the learner counts them: read and missed. */
    uint64_t steps;
    /* Version of the weights last published; 0 for none. */
    uint64_t version;
    /* Steps from one update to the next: `learner.block_steps`. */
    uint64_t block_steps;
} vlaps_learning;
VLAPS_ASSERT(sizeof(vlaps_learning) == 56, "vlaps_learning");
VLAPS_ASSERT(offsetof(vlaps_learning, header) == 0, "vlaps_learning.header");
VLAPS_ASSERT(offsetof(vlaps_learning, steps) == 32, "vlaps_learning.steps");
VLAPS_ASSERT(offsetof(vlaps_learning, version) == 40, "vlaps_learning.version");
VLAPS_ASSERT(offsetof(vlaps_learning, block_steps) == 48, "vlaps_learning.block_steps");

typedef struct vlaps_policy_status {
    /* Its tick is that at which `state` began. */
    vlaps_header header;
    /* Version in use, which may drive; 0 for none. */
    uint64_t version;
    /* First 8 bytes of its SHA-256; 0 for none. */
    uint64_t hash;
    /* Version last offered; 0 for none. */
    uint64_t offered_version;
    /* First 8 bytes of its SHA-256; 0 for none. */
    uint64_t offered_hash;
    /* The tick at which the weights last adopted began to propose, in shadow mode
     * first. */
    uint64_t adopted_tick;
    /* 1 when the version in use could not be written to the run's folder, so that
     * a restart does not begin with it; else 0. */
    uint64_t unkept;
    /* A `PolicyState`: that of the weights last offered. */
    uint32_t state;
    /* Valid bytes of `refusal`. */
    uint32_t refusal_bytes;
    /* Why they were refused or rolled back, UTF-8; empty else. */
    uint8_t refusal[248];
} vlaps_policy_status;
VLAPS_ASSERT(sizeof(vlaps_policy_status) == 336, "vlaps_policy_status");
VLAPS_ASSERT(offsetof(vlaps_policy_status, header) == 0, "vlaps_policy_status.header");
VLAPS_ASSERT(offsetof(vlaps_policy_status, version) == 32, "vlaps_policy_status.version");
VLAPS_ASSERT(offsetof(vlaps_policy_status, hash) == 40, "vlaps_policy_status.hash");
VLAPS_ASSERT(offsetof(vlaps_policy_status, offered_version) == 48, "vlaps_policy_status.offered_version");
VLAPS_ASSERT(offsetof(vlaps_policy_status, offered_hash) == 56, "vlaps_policy_status.offered_hash");
VLAPS_ASSERT(offsetof(vlaps_policy_status, adopted_tick) == 64, "vlaps_policy_status.adopted_tick");
VLAPS_ASSERT(offsetof(vlaps_policy_status, unkept) == 72, "vlaps_policy_status.unkept");
VLAPS_ASSERT(offsetof(vlaps_policy_status, state) == 80, "vlaps_policy_status.state");
VLAPS_ASSERT(offsetof(vlaps_policy_status, refusal_bytes) == 84, "vlaps_policy_status.refusal_bytes");
VLAPS_ASSERT(offsetof(vlaps_policy_status, refusal) == 88, "vlaps_policy_status.refusal");

typedef struct vlaps_progress {
    /* The world's tick. */
    vlaps_header header;
    /* Seed of the episode. */
    uint64_t seed;
    /* Share of the route driven, [0, 1]. */
    double completion;
    /* Length of the route, m. */
    double route_m;
    /* Speed, m/s. */
    double speed_mps;
    /* Ticks of this episode so far. */
    uint64_t episode_ticks;
    /* Ticks of this episode in contact with a vehicle. */
    uint64_t vehicle_contacts;
    /* Ticks of this episode in contact with an object. */
    uint64_t object_contacts;
    /* Ticks of this run on which the world braked without a recent command. */
    uint64_t braked;
    /* Maximum age of an applied command, ns. */
    uint64_t command_age_max_ns;
    /* Ticks of the grid the world skipped. */
    uint64_t skipped;
    /* An `Outcome`. */
    uint32_t outcome;
    /* Not used. */
    uint32_t reserved;
} vlaps_progress;
VLAPS_ASSERT(sizeof(vlaps_progress) == 120, "vlaps_progress");
VLAPS_ASSERT(offsetof(vlaps_progress, header) == 0, "vlaps_progress.header");
VLAPS_ASSERT(offsetof(vlaps_progress, seed) == 32, "vlaps_progress.seed");
VLAPS_ASSERT(offsetof(vlaps_progress, completion) == 40, "vlaps_progress.completion");
VLAPS_ASSERT(offsetof(vlaps_progress, route_m) == 48, "vlaps_progress.route_m");
VLAPS_ASSERT(offsetof(vlaps_progress, speed_mps) == 56, "vlaps_progress.speed_mps");
VLAPS_ASSERT(offsetof(vlaps_progress, episode_ticks) == 64, "vlaps_progress.episode_ticks");
VLAPS_ASSERT(offsetof(vlaps_progress, vehicle_contacts) == 72, "vlaps_progress.vehicle_contacts");
VLAPS_ASSERT(offsetof(vlaps_progress, object_contacts) == 80, "vlaps_progress.object_contacts");
VLAPS_ASSERT(offsetof(vlaps_progress, braked) == 88, "vlaps_progress.braked");
VLAPS_ASSERT(offsetof(vlaps_progress, command_age_max_ns) == 96, "vlaps_progress.command_age_max_ns");
VLAPS_ASSERT(offsetof(vlaps_progress, skipped) == 104, "vlaps_progress.skipped");
VLAPS_ASSERT(offsetof(vlaps_progress, outcome) == 112, "vlaps_progress.outcome");
VLAPS_ASSERT(offsetof(vlaps_progress, reserved) == 116, "vlaps_progress.reserved");

typedef struct vlaps_episode {
    /* The world's last tick of the episode. */
    vlaps_header header;
    /* Seed of the episode. */
    uint64_t seed;
    /* Ticks driven. */
    uint64_t ticks;
    /* Share of the route driven, [0, 1]. */
    double completion;
    /* Length driven, m. */
    double driven_m;
    /* Ticks in contact with a vehicle. */
    uint64_t vehicle_contacts;
    /* Ticks in contact with an object. */
    uint64_t object_contacts;
    /* Ticks on which the world braked without a recent command. */
    uint64_t braked;
    /* An `Outcome`. */
    uint32_t outcome;
    /* 1 when the last tick was in contact: the paper's crash. */
    uint32_t crash_last_step;
    /* SHA-256 over the bits of all applied commands. */
    uint8_t command_digest[32];
    /* Ticks of the grid skipped in this episode. */
    uint64_t skipped;
} vlaps_episode;
VLAPS_ASSERT(sizeof(vlaps_episode) == 136, "vlaps_episode");
VLAPS_ASSERT(offsetof(vlaps_episode, header) == 0, "vlaps_episode.header");
VLAPS_ASSERT(offsetof(vlaps_episode, seed) == 32, "vlaps_episode.seed");
VLAPS_ASSERT(offsetof(vlaps_episode, ticks) == 40, "vlaps_episode.ticks");
VLAPS_ASSERT(offsetof(vlaps_episode, completion) == 48, "vlaps_episode.completion");
VLAPS_ASSERT(offsetof(vlaps_episode, driven_m) == 56, "vlaps_episode.driven_m");
VLAPS_ASSERT(offsetof(vlaps_episode, vehicle_contacts) == 64, "vlaps_episode.vehicle_contacts");
VLAPS_ASSERT(offsetof(vlaps_episode, object_contacts) == 72, "vlaps_episode.object_contacts");
VLAPS_ASSERT(offsetof(vlaps_episode, braked) == 80, "vlaps_episode.braked");
VLAPS_ASSERT(offsetof(vlaps_episode, outcome) == 88, "vlaps_episode.outcome");
VLAPS_ASSERT(offsetof(vlaps_episode, crash_last_step) == 92, "vlaps_episode.crash_last_step");
VLAPS_ASSERT(offsetof(vlaps_episode, command_digest) == 96, "vlaps_episode.command_digest");
VLAPS_ASSERT(offsetof(vlaps_episode, skipped) == 128, "vlaps_episode.skipped");

typedef struct vlaps_health {
    /* The last tick, and when the message was made. */
    vlaps_header header;
    /* Ticks done since the process started. */
    uint64_t ticks;
    /* Ticks of the grid skipped. */
    uint64_t skipped;
    /* Ticks completed after their deadline. */
    uint64_t late;
    /* Messages refused by a check, by `RefusalKind`(super::RefusalKind). */
    uint64_t refused[6];
    /* Messages lost on queues it reads. */
    uint64_t lost;
    /* When its first tick was due, ns on the run's clock. */
    uint64_t first_scheduled_ns;
    /* When its next tick is due, ns on the run's clock. */
    uint64_t next_scheduled_ns;
    /* Page faults of the tick's thread that needed no disk, since it was ready. */
    uint64_t minor_faults;
    /* Page faults of the tick's thread that waited for the disk. */
    uint64_t major_faults;
    /* Times that the kernel took the processor away from the tick's thread. */
    uint64_t involuntary_switches;
    /* Ticks in which a part took longer than its budget, by `Part`. */
    uint64_t overruns[8];
    /* A `HealthState`. */
    uint32_t state;
    /* A `Grant`: real-time scheduling. */
    uint32_t priority;
    /* A `Grant`: its own core. */
    uint32_t core;
    /* A `Grant`: memory locked. */
    uint32_t memory;
    /* The priority asked for; 0 for none. */
    uint32_t priority_asked;
    /* The priority in force; 0 for none. */
    uint32_t priority_got;
    /* A `Scheduling`: the one asked for. */
    uint32_t scheduling_asked;
    /* A `Scheduling`: the one in force. */
    uint32_t scheduling_got;
    /* The last process that sent messages of a service without being started for
     * it; 0 for none. */
    uint32_t foreign_pid;
    /* The `Process` in whose place it sent. */
    uint32_t foreign_as;
} vlaps_health;
VLAPS_ASSERT(sizeof(vlaps_health) == 256, "vlaps_health");
VLAPS_ASSERT(offsetof(vlaps_health, header) == 0, "vlaps_health.header");
VLAPS_ASSERT(offsetof(vlaps_health, ticks) == 32, "vlaps_health.ticks");
VLAPS_ASSERT(offsetof(vlaps_health, skipped) == 40, "vlaps_health.skipped");
VLAPS_ASSERT(offsetof(vlaps_health, late) == 48, "vlaps_health.late");
VLAPS_ASSERT(offsetof(vlaps_health, refused) == 56, "vlaps_health.refused");
VLAPS_ASSERT(offsetof(vlaps_health, lost) == 104, "vlaps_health.lost");
VLAPS_ASSERT(offsetof(vlaps_health, first_scheduled_ns) == 112, "vlaps_health.first_scheduled_ns");
VLAPS_ASSERT(offsetof(vlaps_health, next_scheduled_ns) == 120, "vlaps_health.next_scheduled_ns");
VLAPS_ASSERT(offsetof(vlaps_health, minor_faults) == 128, "vlaps_health.minor_faults");
VLAPS_ASSERT(offsetof(vlaps_health, major_faults) == 136, "vlaps_health.major_faults");
VLAPS_ASSERT(offsetof(vlaps_health, involuntary_switches) == 144, "vlaps_health.involuntary_switches");
VLAPS_ASSERT(offsetof(vlaps_health, overruns) == 152, "vlaps_health.overruns");
VLAPS_ASSERT(offsetof(vlaps_health, state) == 216, "vlaps_health.state");
VLAPS_ASSERT(offsetof(vlaps_health, priority) == 220, "vlaps_health.priority");
VLAPS_ASSERT(offsetof(vlaps_health, core) == 224, "vlaps_health.core");
VLAPS_ASSERT(offsetof(vlaps_health, memory) == 228, "vlaps_health.memory");
VLAPS_ASSERT(offsetof(vlaps_health, priority_asked) == 232, "vlaps_health.priority_asked");
VLAPS_ASSERT(offsetof(vlaps_health, priority_got) == 236, "vlaps_health.priority_got");
VLAPS_ASSERT(offsetof(vlaps_health, scheduling_asked) == 240, "vlaps_health.scheduling_asked");
VLAPS_ASSERT(offsetof(vlaps_health, scheduling_got) == 244, "vlaps_health.scheduling_got");
VLAPS_ASSERT(offsetof(vlaps_health, foreign_pid) == 248, "vlaps_health.foreign_pid");
VLAPS_ASSERT(offsetof(vlaps_health, foreign_as) == 252, "vlaps_health.foreign_as");

typedef struct vlaps_histogram {
    /* The largest duration seen, ns, exact. */
    uint64_t max_ns;
    /* Durations counted. */
    uint64_t count;
    /* Durations by bucket. */
    uint32_t buckets[2816];
} vlaps_histogram;
VLAPS_ASSERT(sizeof(vlaps_histogram) == 11280, "vlaps_histogram");
VLAPS_ASSERT(offsetof(vlaps_histogram, max_ns) == 0, "vlaps_histogram.max_ns");
VLAPS_ASSERT(offsetof(vlaps_histogram, count) == 8, "vlaps_histogram.count");
VLAPS_ASSERT(offsetof(vlaps_histogram, buckets) == 16, "vlaps_histogram.buckets");

typedef struct vlaps_late_tick {
    /* The number of the tick in the run. */
    uint64_t tick;
    /* From its deadline to its completion, ns; of a tick that ends skipped ones,
     * from the deadline of the first of them. */
    uint64_t late_ns;
    /* How long its longest part took, ns. */
    uint64_t part_ns;
    /* Ticks that were skipped just before it. */
    uint64_t skipped;
    /* A `Part`: the one that took longest. */
    uint32_t part;
    /* Not used; 0. */
    uint32_t reserved;
} vlaps_late_tick;
VLAPS_ASSERT(sizeof(vlaps_late_tick) == 40, "vlaps_late_tick");
VLAPS_ASSERT(offsetof(vlaps_late_tick, tick) == 0, "vlaps_late_tick.tick");
VLAPS_ASSERT(offsetof(vlaps_late_tick, late_ns) == 8, "vlaps_late_tick.late_ns");
VLAPS_ASSERT(offsetof(vlaps_late_tick, part_ns) == 16, "vlaps_late_tick.part_ns");
VLAPS_ASSERT(offsetof(vlaps_late_tick, skipped) == 24, "vlaps_late_tick.skipped");
VLAPS_ASSERT(offsetof(vlaps_late_tick, part) == 32, "vlaps_late_tick.part");
VLAPS_ASSERT(offsetof(vlaps_late_tick, reserved) == 36, "vlaps_late_tick.reserved");

typedef struct vlaps_timing {
    /* When. */
    vlaps_header header;
    /* From the scheduled instant to the begin of the tick; of a skipped one, to
     * the begin of the tick after it. */
    vlaps_histogram release_lateness;
    /* From the event that released the tick to its begin: the timer's instant
     * (world), the publishing of the observation, or the end of the wait for one
     * (planner, controller). A skipped tick, whose release the process did not
     * see, counts from its scheduled instant, so that no duration is too short.
     * Empty in a process that does not know what releases it, and in a world in
     * lockstep. */
    vlaps_histogram wake_up;
    /* From begin to end of the tick. */
    vlaps_histogram execution;
    /* From the world's release of an observation to the command that answers
     * it, by its tick (controller), else empty. */
    vlaps_histogram response;
    /* Age of the observation when it was used (planner, controller), from the
     * instant it was taken. */
    vlaps_histogram observation_age;
    /* Age of the plan's observation when it was used (controller). */
    vlaps_histogram plan_age;
    /* Age of the observation that the advice answers (controller). */
    vlaps_histogram advice_age;
    /* How many of the late ticks are valid. */
    uint64_t late_count;
    /* The ticks that were latest, in no order. */
    vlaps_late_tick late[20];
} vlaps_timing;
VLAPS_ASSERT(sizeof(vlaps_timing) == 79800, "vlaps_timing");
VLAPS_ASSERT(offsetof(vlaps_timing, header) == 0, "vlaps_timing.header");
VLAPS_ASSERT(offsetof(vlaps_timing, release_lateness) == 32, "vlaps_timing.release_lateness");
VLAPS_ASSERT(offsetof(vlaps_timing, wake_up) == 11312, "vlaps_timing.wake_up");
VLAPS_ASSERT(offsetof(vlaps_timing, execution) == 22592, "vlaps_timing.execution");
VLAPS_ASSERT(offsetof(vlaps_timing, response) == 33872, "vlaps_timing.response");
VLAPS_ASSERT(offsetof(vlaps_timing, observation_age) == 45152, "vlaps_timing.observation_age");
VLAPS_ASSERT(offsetof(vlaps_timing, plan_age) == 56432, "vlaps_timing.plan_age");
VLAPS_ASSERT(offsetof(vlaps_timing, advice_age) == 67712, "vlaps_timing.advice_age");
VLAPS_ASSERT(offsetof(vlaps_timing, late_count) == 78992, "vlaps_timing.late_count");
VLAPS_ASSERT(offsetof(vlaps_timing, late) == 79000, "vlaps_timing.late");

typedef struct vlaps_roster {
    /* When it was last changed. */
    vlaps_header header;
    /* The process ids, by the code of the `Process`; 0 where there is none. */
    uint32_t pids[8];
} vlaps_roster;
VLAPS_ASSERT(sizeof(vlaps_roster) == 64, "vlaps_roster");
VLAPS_ASSERT(offsetof(vlaps_roster, header) == 0, "vlaps_roster.header");
VLAPS_ASSERT(offsetof(vlaps_roster, pids) == 32, "vlaps_roster.pids");

typedef struct vlaps_kept {
    /* The tick of the newest step that it has read; 0 before the first. */
    vlaps_header header;
    /* Steps that it has read. */
    uint64_t steps;
} vlaps_kept;
VLAPS_ASSERT(sizeof(vlaps_kept) == 40, "vlaps_kept");
VLAPS_ASSERT(offsetof(vlaps_kept, header) == 0, "vlaps_kept.header");
VLAPS_ASSERT(offsetof(vlaps_kept, steps) == 32, "vlaps_kept.steps");

typedef struct vlaps_fault {
    /* When it was ordered. */
    vlaps_header header;
    /* Duration, ns; for a slow loop only. */
    uint64_t duration_ns;
    /* The `Process` that shall fail. */
    uint32_t target;
    /* A `FaultKind`. */
    uint32_t kind;
} vlaps_fault;
VLAPS_ASSERT(sizeof(vlaps_fault) == 48, "vlaps_fault");
VLAPS_ASSERT(offsetof(vlaps_fault, header) == 0, "vlaps_fault.header");
VLAPS_ASSERT(offsetof(vlaps_fault, duration_ns) == 32, "vlaps_fault.duration_ns");
VLAPS_ASSERT(offsetof(vlaps_fault, target) == 40, "vlaps_fault.target");
VLAPS_ASSERT(offsetof(vlaps_fault, kind) == 44, "vlaps_fault.kind");

typedef struct vlaps_tick {
    /* The tick of the run. */
    uint64_t tick;
    /* Seed of the episode. */
    uint64_t seed;
    /* When the instant was due, ns on the machine's clock. */
    uint64_t scheduled_ns;
    /* When the world was woken for it, ns on the machine's clock. */
    uint64_t released_ns;
    /* The instant, ns on the run's clock. */
    uint64_t taken_ns;
    /* Instants missed just before this one. */
    uint64_t missed;
    /* Time to move by, s: since the last instant, missed ones included; 0 when an
     * episode begins. */
    double step_s;
    /* The steering to obey, normalised, positive left. */
    double steer;
    /* The pedal to obey, normalised, negative brakes. */
    double pedal;
    /* The episode of the run, from 0. */
    uint32_t episode;
    /* 1 when an episode begins: put the car at the start of the episode `seed`. */
    uint32_t begins;
    /* 1 when no command was young enough, so that the action is the brake. */
    uint32_t braked;
    /* Not used. */
    uint32_t reserved;
} vlaps_tick;
VLAPS_ASSERT(sizeof(vlaps_tick) == 88, "vlaps_tick");
VLAPS_ASSERT(offsetof(vlaps_tick, tick) == 0, "vlaps_tick.tick");
VLAPS_ASSERT(offsetof(vlaps_tick, seed) == 8, "vlaps_tick.seed");
VLAPS_ASSERT(offsetof(vlaps_tick, scheduled_ns) == 16, "vlaps_tick.scheduled_ns");
VLAPS_ASSERT(offsetof(vlaps_tick, released_ns) == 24, "vlaps_tick.released_ns");
VLAPS_ASSERT(offsetof(vlaps_tick, taken_ns) == 32, "vlaps_tick.taken_ns");
VLAPS_ASSERT(offsetof(vlaps_tick, missed) == 40, "vlaps_tick.missed");
VLAPS_ASSERT(offsetof(vlaps_tick, step_s) == 48, "vlaps_tick.step_s");
VLAPS_ASSERT(offsetof(vlaps_tick, steer) == 56, "vlaps_tick.steer");
VLAPS_ASSERT(offsetof(vlaps_tick, pedal) == 64, "vlaps_tick.pedal");
VLAPS_ASSERT(offsetof(vlaps_tick, episode) == 72, "vlaps_tick.episode");
VLAPS_ASSERT(offsetof(vlaps_tick, begins) == 76, "vlaps_tick.begins");
VLAPS_ASSERT(offsetof(vlaps_tick, braked) == 80, "vlaps_tick.braked");
VLAPS_ASSERT(offsetof(vlaps_tick, reserved) == 84, "vlaps_tick.reserved");

/* Why the last call of this thread failed: one line, valid until the next call. */
const char *vlaps_last_error(void);

/* The layout hash of the library. */
uint64_t vlaps_layout(void);

/* All messages, lists and services as JSON, for bindings of other languages. */
const char *vlaps_describe(void);

/* Joins the run as "world", "planner", "controller", "gate", "learner" or "recorder".
 * The arguments are those with which the supervisor started this program. Call it first
 * in main; from then on SIGTERM and SIGINT are a request to stop, and the process ends
 * with its supervisor. */
int vlaps_join_as(uint64_t layout, const char *process, int argc, const char *const *argv);

static inline int vlaps_join(const char *process, int argc, char **argv) {
    return vlaps_join_as(VLAPS_LAYOUT, process, argc, (const char *const *)argv);
}

/* Leaves the run. Without it the supervisor removes what the process held. */
int vlaps_leave(void);

/* Opens a port of a service: VLAPS_NEWEST, VLAPS_EVERY or VLAPS_WRITE. Returns its
 * number. The service's row has to name the process for this use. */
int vlaps_open(const char *service, uint32_t use);
int vlaps_close(int port);

/* Copies the newest message, or the next one of a queue, that passed its check.
 * VLAPS_OK when there was one, else VLAPS_NONE. */
int vlaps_newest(int port, void *message, size_t bytes);
int vlaps_next(int port, void *message, size_t bytes);

/* Checks a message and sends it. VLAPS_REFUSED when the check fails: vlaps_last_error
 * names the field, and nothing is sent. */
int vlaps_publish(int port, const void *message, size_t bytes);

/* The check alone. */
int vlaps_admit(const char *service, const void *message, size_t bytes);

/* Sleeps until a message wakes this process, at most limit_ns and 20 ms; publishes
 * health and timing, and connects to new peers. VLAPS_ENDED when the process has to
 * exit. Call it at least once in a second. */
int vlaps_wait(uint64_t limit_ns);

/* The process id of a process of the run; 0 while the roster names none. */
int64_t vlaps_pid_of(const char *process);

/* The machine's monotonic clock, ns; 0 before the process has joined. */
uint64_t vlaps_now_ns(void);

/* 1 in lockstep, where the run's clock is simulated, else 0. */
int vlaps_is_lockstep(void);

/* A number of the run's configuration, such as "scanner.range_m"; true is 1. */
int vlaps_setting(const char *key, double *number);

/* For a world: writes the section [scanner] of the run into an observation (lidar_max_m,
 * beam_count, field_of_view_rad and the place of the scanner), and where each beam looks
 * into an array with room for `count` directions, rad counter-clockwise from the heading
 * of the body; VLAPS_BEAMS_MAX is always enough. The beams begin at scanner_x_body_m,
 * scanner_y_body_m. */
int vlaps_beams(vlaps_observation *observation, double *directions_rad, size_t count);

/* The loop of a world: its grid, the age limit of commands, the brake, the episodes.
 * vlaps_await_tick waits for the next instant; VLAPS_ENDED: exit with 0. The answer to
 * each is vlaps_finish_tick; headers, instants and counts are filled in. An outcome of
 * the progress other than VLAPS_OUTCOME_DRIVING ends the episode. */
int vlaps_await_tick(vlaps_tick *tick);
int vlaps_finish_tick(const vlaps_observation *observation, const vlaps_progress *progress);

/* The loop of a planner: waits for the next observation of a planner's turn;
 * VLAPS_ENDED: exit with 0. The answer to each is vlaps_answer; header, origin and times
 * are filled in. */
int vlaps_await_observation(vlaps_observation *observation);
int vlaps_answer(const vlaps_plan *plan);

#ifdef __cplusplus
}
#endif

#endif

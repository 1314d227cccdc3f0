"""The wire of VLAPS: messages, services, limits.

Generated from the crate `shm-config`; do not edit. Renew it with
    cargo run -p shm-config --example python_wire > sim/metadrive/wire_layout.py
"""

import ctypes
from collections import namedtuple
USER_DIR = "/dev/shm/vlaps-{user}"
PREFIX = "vlaps-{user}-{run}."
ALIVE_FILE = "alive"
SHARED_MEMORY_DIR = "/dev/shm"
PUBLISHERS_MAX = 4
SUBSCRIBERS_MAX = 16
NODES_MAX = 32
LAYOUT_KEY = "layout"
FUTURE_TOLERANCE_NS = 1000000
HISTOGRAM_UNIT_SHIFT = 6
HISTOGRAM_HALF_SHIFT = 7
HISTOGRAM_BUCKETS = 2816
LATE_TICKS = 20
LEARNER_WAIT_S = 120
FRAME_BYTES_MAX = 2073600
FRAME_SIDE_MIN_PX = 64
FRAME_SIDE_MAX_PX = 2048
TOP_DOWN_ACROSS_M = 60.0
TOP_DOWN_AHEAD = 0.75
TOP_DOWN_HEIGHT_M = 50.0


class Palette:
    GROUND = (104, 122, 92)
    SIDEWALK = (152, 158, 166)
    ROAD = (60, 62, 68)
    LINE_SOLID = (222, 224, 226)
    LINE_BROKEN = (186, 190, 196)
    LINE_CENTRE = (226, 208, 112)
    EGO = (254, 254, 254)
    VEHICLE = (200, 148, 104)
    VEHICLE_GLASS = (112, 78, 54)
    OBJECT = (240, 178, 178)
    RIM = (26, 28, 32)
    SKY = (150, 182, 214)


class Process:
    SUPERVISOR = 0
    WORLD = 1
    PLANNER = 2
    CONTROLLER = 3
    GATE = 4
    LEARNER = 5
    WORDS = {0: "supervisor", 1: "world", 2: "planner", 3: "controller", 4: "gate", 5: "learner"}


class HealthState:
    STARTING = 0
    READY = 1
    RUNNING = 2
    STOPPING = 3
    FINISHED = 4
    WORDS = {0: "starting", 1: "ready", 2: "running", 3: "stopping", 4: "finished"}


class Grant:
    NOT_ASKED = 0
    GRANTED = 1
    REFUSED = 2
    WORDS = {0: "not asked", 1: "granted", 2: "refused"}


class Part:
    WAIT = 0
    ADMIT = 1
    GRID = 2
    SEARCH = 3
    DECIDE = 4
    SEND = 5
    MOVE = 6
    OBSERVE = 7
    WORDS = {0: "wait", 1: "admit", 2: "grid", 3: "search", 4: "decide", 5: "send", 6: "move", 7: "observe"}


class Scheduling:
    ORDINARY = 0
    FIFO = 1
    WORDS = {0: "ordinary", 1: "fifo"}


class Outcome:
    DRIVING = 0
    ARRIVED = 1
    OUT_OF_ROAD = 2
    MAX_STEP = 3
    STOPPED = 4
    WORDS = {0: "driving", 1: "arrived", 2: "out_of_road", 3: "max_step", 4: "stopped"}


class Driver:
    EXPERT = 0
    POLICY = 1
    BRAKE = 2
    WORDS = {0: "expert", 1: "policy", 2: "brake"}


class Reason:
    CONFIGURED = 0
    ADVISED = 1
    UNADVISED = 2
    EXPIRED = 3
    UNLOADED = 4
    FAULTY = 5
    VETOED = 6
    UNSAFE = 7
    BLOCKED = 8
    UNPLANNED = 9
    BLIND = 10
    STOPPING = 11
    TAKEOVER = 12
    SHADOW = 13
    LATE = 14
    CONTESTED = 15
    WORDS = {0: "configured", 1: "advised", 2: "unadvised", 3: "expired", 4: "unloaded", 5: "faulty", 6: "vetoed", 7: "unsafe", 8: "blocked", 9: "unplanned", 10: "blind", 11: "stopping", 12: "takeover", 13: "shadow", 14: "late", 15: "contested"}


class RefusalKind:
    CONTENT = 0
    STALE = 1
    FUTURE = 2
    EPISODE = 3
    GRID = 4
    FOREIGN = 5
    WORDS = {0: "content", 1: "stale", 2: "future", 3: "episode", 4: "grid", 5: "foreign"}


class Bend:
    STRAIGHT = 0
    LEFT = 1
    RIGHT = 2
    WORDS = {0: "straight", 1: "left", 2: "right"}


class View:
    EGO = 0
    TOP_DOWN = 1
    WORDS = {0: "ego", 1: "top_down"}


class PixelFormat:
    RGB8 = 0
    WORDS = {0: "rgb8"}


class Header(ctypes.Structure):
    LAYOUT = "364439007b1123b7"
    _fields_ = [
        ("tick", ctypes.c_uint64),
        ("taken_ns", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("episode", ctypes.c_uint32),
        ("producer", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "Header"


assert ctypes.sizeof(Header) == 32
assert Header.tick.offset == 0
assert Header.taken_ns.offset == 8
assert Header.sequence.offset == 16
assert Header.episode.offset == 24
assert Header.producer.offset == 28


class Ego(ctypes.Structure):
    LAYOUT = "ea559b89d1b510fc"
    _fields_ = [
        ("x_world_m", ctypes.c_double),
        ("y_world_m", ctypes.c_double),
        ("heading_world_rad", ctypes.c_double),
        ("speed_mps", ctypes.c_double),
        ("yaw_rate_radps", ctypes.c_double),
        ("steer", ctypes.c_double),
        ("pedal", ctypes.c_double),
    ]

    @staticmethod
    def type_name():
        return "Ego"


assert ctypes.sizeof(Ego) == 56
assert Ego.x_world_m.offset == 0
assert Ego.y_world_m.offset == 8
assert Ego.heading_world_rad.offset == 16
assert Ego.speed_mps.offset == 24
assert Ego.yaw_rate_radps.offset == 32
assert Ego.steer.offset == 40
assert Ego.pedal.offset == 48


class Road(ctypes.Structure):
    LAYOUT = "ec258c3c42b9cd1f"
    _fields_ = [
        ("left_m", ctypes.c_double),
        ("right_m", ctypes.c_double),
        ("heading_rad", ctypes.c_double),
        ("offset_m", ctypes.c_double),
    ]

    @staticmethod
    def type_name():
        return "Road"


assert ctypes.sizeof(Road) == 32
assert Road.left_m.offset == 0
assert Road.right_m.offset == 8
assert Road.heading_rad.offset == 16
assert Road.offset_m.offset == 24


class Checkpoint(ctypes.Structure):
    LAYOUT = "ba20014db975d1ca"
    _fields_ = [
        ("x_body_m", ctypes.c_double),
        ("y_body_m", ctypes.c_double),
        ("bend_radius_m", ctypes.c_double),
        ("bend_angle_rad", ctypes.c_double),
        ("bend", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "Checkpoint"


assert ctypes.sizeof(Checkpoint) == 40
assert Checkpoint.x_body_m.offset == 0
assert Checkpoint.y_body_m.offset == 8
assert Checkpoint.bend_radius_m.offset == 16
assert Checkpoint.bend_angle_rad.offset == 24
assert Checkpoint.bend.offset == 32
assert Checkpoint.reserved.offset == 36


class Observation(ctypes.Structure):
    LAYOUT = "2e0fc1570841e222"
    _fields_ = [
        ("header", Header),
        ("scheduled_ns", ctypes.c_uint64),
        ("released_ns", ctypes.c_uint64),
        ("published_ns", ctypes.c_uint64),
        ("ego", Ego),
        ("road", Road),
        ("checkpoints", Checkpoint * 2),
        ("lidar_max_m", ctypes.c_float),
        ("beam_count", ctypes.c_uint32),
        ("ranges_m", ctypes.c_float * 512),
    ]

    @staticmethod
    def type_name():
        return "Observation"


assert ctypes.sizeof(Observation) == 2280
assert Observation.header.offset == 0
assert Observation.scheduled_ns.offset == 32
assert Observation.released_ns.offset == 40
assert Observation.published_ns.offset == 48
assert Observation.ego.offset == 56
assert Observation.road.offset == 112
assert Observation.checkpoints.offset == 144
assert Observation.lidar_max_m.offset == 224
assert Observation.beam_count.offset == 228
assert Observation.ranges_m.offset == 232


class Command(ctypes.Structure):
    LAYOUT = "a5ef2e32c43c5dac"
    _fields_ = [
        ("header", Header),
        ("steer", ctypes.c_double),
        ("pedal", ctypes.c_double),
        ("driver", ctypes.c_uint32),
        ("reason", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "Command"


assert ctypes.sizeof(Command) == 56
assert Command.header.offset == 0
assert Command.steer.offset == 32
assert Command.pedal.offset == 40
assert Command.driver.offset == 48
assert Command.reason.offset == 52


class Progress(ctypes.Structure):
    LAYOUT = "ac29910c7e570174"
    _fields_ = [
        ("header", Header),
        ("seed", ctypes.c_uint64),
        ("completion", ctypes.c_double),
        ("route_m", ctypes.c_double),
        ("speed_mps", ctypes.c_double),
        ("episode_ticks", ctypes.c_uint64),
        ("vehicle_contacts", ctypes.c_uint64),
        ("object_contacts", ctypes.c_uint64),
        ("braked", ctypes.c_uint64),
        ("command_age_max_ns", ctypes.c_uint64),
        ("skipped", ctypes.c_uint64),
        ("outcome", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "Progress"


assert ctypes.sizeof(Progress) == 120
assert Progress.header.offset == 0
assert Progress.seed.offset == 32
assert Progress.completion.offset == 40
assert Progress.route_m.offset == 48
assert Progress.speed_mps.offset == 56
assert Progress.episode_ticks.offset == 64
assert Progress.vehicle_contacts.offset == 72
assert Progress.object_contacts.offset == 80
assert Progress.braked.offset == 88
assert Progress.command_age_max_ns.offset == 96
assert Progress.skipped.offset == 104
assert Progress.outcome.offset == 112
assert Progress.reserved.offset == 116


class Episode(ctypes.Structure):
    LAYOUT = "317dfc03d9b39474"
    _fields_ = [
        ("header", Header),
        ("seed", ctypes.c_uint64),
        ("ticks", ctypes.c_uint64),
        ("completion", ctypes.c_double),
        ("driven_m", ctypes.c_double),
        ("vehicle_contacts", ctypes.c_uint64),
        ("object_contacts", ctypes.c_uint64),
        ("braked", ctypes.c_uint64),
        ("outcome", ctypes.c_uint32),
        ("crash_last_step", ctypes.c_uint32),
        ("command_digest", ctypes.c_uint8 * 32),
        ("skipped", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name():
        return "Episode"


assert ctypes.sizeof(Episode) == 136
assert Episode.header.offset == 0
assert Episode.seed.offset == 32
assert Episode.ticks.offset == 40
assert Episode.completion.offset == 48
assert Episode.driven_m.offset == 56
assert Episode.vehicle_contacts.offset == 64
assert Episode.object_contacts.offset == 72
assert Episode.braked.offset == 80
assert Episode.outcome.offset == 88
assert Episode.crash_last_step.offset == 92
assert Episode.command_digest.offset == 96
assert Episode.skipped.offset == 128


class Health(ctypes.Structure):
    LAYOUT = "b883934d83a61ada"
    _fields_ = [
        ("header", Header),
        ("ticks", ctypes.c_uint64),
        ("skipped", ctypes.c_uint64),
        ("late", ctypes.c_uint64),
        ("refused", ctypes.c_uint64 * 6),
        ("lost", ctypes.c_uint64),
        ("first_scheduled_ns", ctypes.c_uint64),
        ("next_scheduled_ns", ctypes.c_uint64),
        ("minor_faults", ctypes.c_uint64),
        ("major_faults", ctypes.c_uint64),
        ("involuntary_switches", ctypes.c_uint64),
        ("overruns", ctypes.c_uint64 * 8),
        ("state", ctypes.c_uint32),
        ("priority", ctypes.c_uint32),
        ("core", ctypes.c_uint32),
        ("memory", ctypes.c_uint32),
        ("priority_asked", ctypes.c_uint32),
        ("priority_got", ctypes.c_uint32),
        ("scheduling_asked", ctypes.c_uint32),
        ("scheduling_got", ctypes.c_uint32),
        ("foreign_pid", ctypes.c_uint32),
        ("foreign_as", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "Health"


assert ctypes.sizeof(Health) == 256
assert Health.header.offset == 0
assert Health.ticks.offset == 32
assert Health.skipped.offset == 40
assert Health.late.offset == 48
assert Health.refused.offset == 56
assert Health.lost.offset == 104
assert Health.first_scheduled_ns.offset == 112
assert Health.next_scheduled_ns.offset == 120
assert Health.minor_faults.offset == 128
assert Health.major_faults.offset == 136
assert Health.involuntary_switches.offset == 144
assert Health.overruns.offset == 152
assert Health.state.offset == 216
assert Health.priority.offset == 220
assert Health.core.offset == 224
assert Health.memory.offset == 228
assert Health.priority_asked.offset == 232
assert Health.priority_got.offset == 236
assert Health.scheduling_asked.offset == 240
assert Health.scheduling_got.offset == 244
assert Health.foreign_pid.offset == 248
assert Health.foreign_as.offset == 252


class Histogram(ctypes.Structure):
    LAYOUT = "0fb2e4b3cb700579"
    _fields_ = [
        ("max_ns", ctypes.c_uint64),
        ("count", ctypes.c_uint64),
        ("buckets", ctypes.c_uint32 * 2816),
    ]

    @staticmethod
    def type_name():
        return "Histogram"


assert ctypes.sizeof(Histogram) == 11280
assert Histogram.max_ns.offset == 0
assert Histogram.count.offset == 8
assert Histogram.buckets.offset == 16


class LateTick(ctypes.Structure):
    LAYOUT = "6b3d8ba7ac752f4b"
    _fields_ = [
        ("tick", ctypes.c_uint64),
        ("late_ns", ctypes.c_uint64),
        ("part_ns", ctypes.c_uint64),
        ("skipped", ctypes.c_uint64),
        ("part", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "LateTick"


assert ctypes.sizeof(LateTick) == 40
assert LateTick.tick.offset == 0
assert LateTick.late_ns.offset == 8
assert LateTick.part_ns.offset == 16
assert LateTick.skipped.offset == 24
assert LateTick.part.offset == 32
assert LateTick.reserved.offset == 36


class Timing(ctypes.Structure):
    LAYOUT = "2e3496a50f6e7fec"
    _fields_ = [
        ("header", Header),
        ("release_lateness", Histogram),
        ("wake_up", Histogram),
        ("execution", Histogram),
        ("response", Histogram),
        ("observation_age", Histogram),
        ("plan_age", Histogram),
        ("advice_age", Histogram),
        ("late_count", ctypes.c_uint64),
        ("late", LateTick * 20),
    ]

    @staticmethod
    def type_name():
        return "Timing"


assert ctypes.sizeof(Timing) == 79800
assert Timing.header.offset == 0
assert Timing.release_lateness.offset == 32
assert Timing.wake_up.offset == 11312
assert Timing.execution.offset == 22592
assert Timing.response.offset == 33872
assert Timing.observation_age.offset == 45152
assert Timing.plan_age.offset == 56432
assert Timing.advice_age.offset == 67712
assert Timing.late_count.offset == 78992
assert Timing.late.offset == 79000


class Camera(ctypes.Structure):
    LAYOUT = "deb5f19c7c52d6bf"
    _fields_ = [
        ("pixel_from_body", ctypes.c_double * 12),
        ("position_body_m", ctypes.c_double * 3),
        ("near_m", ctypes.c_double),
        ("view", ctypes.c_uint32),
        ("orthographic", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "Camera"


assert ctypes.sizeof(Camera) == 136
assert Camera.pixel_from_body.offset == 0
assert Camera.position_body_m.offset == 96
assert Camera.near_m.offset == 120
assert Camera.view.offset == 128
assert Camera.orthographic.offset == 132


class Frame(ctypes.Structure):
    LAYOUT = "941cd01acca576d3"
    _fields_ = [
        ("header", Header),
        ("camera", Camera),
        ("width", ctypes.c_uint32),
        ("height", ctypes.c_uint32),
        ("format", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("pixels", ctypes.c_uint8 * 2073600),
        ("end", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name():
        return "Frame"


assert ctypes.sizeof(Frame) == 2073792
assert Frame.header.offset == 0
assert Frame.camera.offset == 32
assert Frame.width.offset == 168
assert Frame.height.offset == 172
assert Frame.format.offset == 176
assert Frame.reserved.offset == 180
assert Frame.pixels.offset == 184
assert Frame.end.offset == 2073784


class Proposal(ctypes.Structure):
    LAYOUT = "825aad0d9b57a5e7"
    _fields_ = [
        ("steer", ctypes.c_double),
        ("pedal", ctypes.c_double),
        ("present", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "Proposal"


assert ctypes.sizeof(Proposal) == 24
assert Proposal.steer.offset == 0
assert Proposal.pedal.offset == 8
assert Proposal.present.offset == 16
assert Proposal.reserved.offset == 20


class FrameRequest(ctypes.Structure):
    LAYOUT = "237d915d1c81e3f2"
    _fields_ = [
        ("header", Header),
        ("proposals", Proposal * 2),
        ("view", ctypes.c_uint32),
        ("width", ctypes.c_uint32),
        ("height", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        return "FrameRequest"


assert ctypes.sizeof(FrameRequest) == 96
assert FrameRequest.header.offset == 0
assert FrameRequest.proposals.offset == 32
assert FrameRequest.view.offset == 80
assert FrameRequest.width.offset == 84
assert FrameRequest.height.offset == 88
assert FrameRequest.reserved.offset == 92


class Roster(ctypes.Structure):
    LAYOUT = "a0ba52d9a8770748"
    _fields_ = [
        ("header", Header),
        ("pids", ctypes.c_uint32 * 6),
    ]

    @staticmethod
    def type_name():
        return "Roster"


assert ctypes.sizeof(Roster) == 56
assert Roster.header.offset == 0
assert Roster.pids.offset == 32


Service = namedtuple("Service", "name message from_ to depth history open")

OBSERVATION = Service("observation", Observation, "world", ("planner", "controller",), 1, 1, False)
COMMAND = Service("command", Command, "controller", ("world",), 1, 1, False)
FRAME_REQUEST = Service("frame_request", FrameRequest, "gate", (), 1, 1, True)
FRAME = Service("frame", Frame, "world", ("gate",), 1, 1, False)
ROSTER = Service("roster", Roster, "supervisor", (), 1, 1, False)
PROGRESS = Service("progress", Progress, "world", (), 1, 1, False)
EPISODE = Service("episode", Episode, "world", (), 256, 0, False)
HEALTH_WORLD = Service("health/world", Health, "world", (), 1, 1, False)
TIMING_WORLD = Service("timing/world", Timing, "world", (), 1, 1, False)

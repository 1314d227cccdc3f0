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
    RECORDER = 6
    WORDS = {0: "supervisor", 1: "world", 2: "planner", 3: "controller", 4: "gate", 5: "learner", 6: "recorder"}


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


class Struct(ctypes.Structure):
    @classmethod
    def type_name(cls):
        return cls.__name__


def check(message, size, offsets):
    found = tuple(getattr(message, name).offset for name, _ in message._fields_)
    assert (ctypes.sizeof(message), found) == (size, offsets), message


class Header(Struct):
    LAYOUT = "364439007b1123b7"
    _fields_ = [
        ("tick", ctypes.c_uint64),
        ("taken_ns", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("episode", ctypes.c_uint32),
        ("producer", ctypes.c_uint32),
    ]


check(Header, 32, (0, 8, 16, 24, 28,))


class Ego(Struct):
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


check(Ego, 56, (0, 8, 16, 24, 32, 40, 48,))


class Road(Struct):
    LAYOUT = "99dbc25832e1d4aa"
    _fields_ = [
        ("left_m", ctypes.c_double),
        ("right_m", ctypes.c_double),
        ("heading_rad", ctypes.c_double),
        ("offset_m", ctypes.c_double),
        ("lane_width_m", ctypes.c_double),
    ]


check(Road, 40, (0, 8, 16, 24, 32,))


class Checkpoint(Struct):
    LAYOUT = "ba20014db975d1ca"
    _fields_ = [
        ("x_body_m", ctypes.c_double),
        ("y_body_m", ctypes.c_double),
        ("bend_radius_m", ctypes.c_double),
        ("bend_angle_rad", ctypes.c_double),
        ("bend", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]


check(Checkpoint, 40, (0, 8, 16, 24, 32, 36,))


class Observation(Struct):
    LAYOUT = "20bc3c93c1b4e7c6"
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
        ("field_of_view_rad", ctypes.c_double),
        ("scanner_heading_rad", ctypes.c_double),
        ("scanner_x_body_m", ctypes.c_double),
        ("scanner_y_body_m", ctypes.c_double),
        ("ranges_m", ctypes.c_float * 2048),
    ]


check(Observation, 8464, (0, 32, 40, 48, 56, 112, 152, 232, 236, 240, 248, 256, 264, 272,))


class Command(Struct):
    LAYOUT = "a5ef2e32c43c5dac"
    _fields_ = [
        ("header", Header),
        ("steer", ctypes.c_double),
        ("pedal", ctypes.c_double),
        ("driver", ctypes.c_uint32),
        ("reason", ctypes.c_uint32),
    ]


check(Command, 56, (0, 32, 40, 48, 52,))


class Progress(Struct):
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


check(Progress, 120, (0, 32, 40, 48, 56, 64, 72, 80, 88, 96, 104, 112, 116,))


class Episode(Struct):
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


check(Episode, 136, (0, 32, 40, 48, 56, 64, 72, 80, 88, 92, 96, 128,))


class Health(Struct):
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


check(Health, 256, (0, 32, 40, 48, 56, 104, 112, 120, 128, 136, 144, 152, 216, 220, 224, 228, 232, 236, 240, 244, 248, 252,))


class Histogram(Struct):
    LAYOUT = "0fb2e4b3cb700579"
    _fields_ = [
        ("max_ns", ctypes.c_uint64),
        ("count", ctypes.c_uint64),
        ("buckets", ctypes.c_uint32 * 2816),
    ]


check(Histogram, 11280, (0, 8, 16,))


class LateTick(Struct):
    LAYOUT = "6b3d8ba7ac752f4b"
    _fields_ = [
        ("tick", ctypes.c_uint64),
        ("late_ns", ctypes.c_uint64),
        ("part_ns", ctypes.c_uint64),
        ("skipped", ctypes.c_uint64),
        ("part", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]


check(LateTick, 40, (0, 8, 16, 24, 32, 36,))


class Timing(Struct):
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


check(Timing, 79800, (0, 32, 11312, 22592, 33872, 45152, 56432, 67712, 78992, 79000,))


class Camera(Struct):
    LAYOUT = "deb5f19c7c52d6bf"
    _fields_ = [
        ("pixel_from_body", ctypes.c_double * 12),
        ("position_body_m", ctypes.c_double * 3),
        ("near_m", ctypes.c_double),
        ("view", ctypes.c_uint32),
        ("orthographic", ctypes.c_uint32),
    ]


check(Camera, 136, (0, 96, 120, 128, 132,))


class Frame(Struct):
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


check(Frame, 2073792, (0, 32, 168, 172, 176, 180, 184, 2073784,))


class Proposal(Struct):
    LAYOUT = "825aad0d9b57a5e7"
    _fields_ = [
        ("steer", ctypes.c_double),
        ("pedal", ctypes.c_double),
        ("present", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]


check(Proposal, 24, (0, 8, 16, 20,))


class FrameRequest(Struct):
    LAYOUT = "237d915d1c81e3f2"
    _fields_ = [
        ("header", Header),
        ("proposals", Proposal * 2),
        ("view", ctypes.c_uint32),
        ("width", ctypes.c_uint32),
        ("height", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]


check(FrameRequest, 96, (0, 32, 80, 84, 88, 92,))


class Roster(Struct):
    LAYOUT = "44af8c6b39aea53e"
    _fields_ = [
        ("header", Header),
        ("pids", ctypes.c_uint32 * 8),
    ]


check(Roster, 64, (0, 32,))


Service = namedtuple("Service", "name message from_ to depth most history open")

OBSERVATION = Service("observation", Observation, "world", ("planner", "controller",), 1, 64, 1, False)
COMMAND = Service("command", Command, "controller", ("world",), 1, 64, 1, False)
FRAME_REQUEST = Service("frame_request", FrameRequest, "gate", (), 1, 1, 1, True)
FRAME = Service("frame", Frame, "world", ("gate",), 1, 1, 1, False)
ROSTER = Service("roster", Roster, "supervisor", (), 1, 64, 1, False)
PROGRESS = Service("progress", Progress, "world", (), 1, 64, 1, False)
EPISODE = Service("episode", Episode, "world", (), 256, 256, 0, False)
HEALTH_WORLD = Service("health/world", Health, "world", (), 1, 64, 1, False)
TIMING_WORLD = Service("timing/world", Timing, "world", (), 1, 1, 1, False)

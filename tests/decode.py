"""Decodes each message of a recording with mcap-ros2-support, rosbags and Rerun, and compares
each field by field with the message's memory read as numpy reads it. Topics of standard
types are compared with each other, and with the step that they show.

    python tests/decode.py FILE.mcap
"""

import importlib.util
import math
import struct
import subprocess
import sys
import tempfile

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

# Numbers of a header, with which each of our messages begins.
HEADER = 5
# A message with more numbers is compared in its length alone.
NUMBERS_MAX = 100_000
SIZES = {"uint8": "B", "uint32": "I", "uint64": "Q", "float32": "f", "float64": "d"}


def definitions(schema):
    """The fields of each type: name -> [(type, count or None, field)]."""
    parts = schema.data.decode().split("=" * 80 + "\n")
    named = [(schema.name.replace("/msg/", "/"), parts[0])]
    named += [tuple(part.removeprefix("MSG: ").split("\n", 1)) for part in parts[1:]]
    types = {}
    for name, text in named:
        fields = []
        for line in text.split("\n"):
            if not line:
                continue
            kind, field = line.split(" ")
            count = int(kind.split("[")[1][:-1] or -1) if "[" in kind else None
            fields.append((kind.split("[")[0], count, field))
        types[name] = fields
    return types


def numbers(types, name, memory, at):
    """All numbers of a message in order of memory, from the struct alone."""
    found = []
    for kind, count, _ in types[name]:
        if kind in SIZES:
            form = "<" + SIZES[kind] * (count or 1)
            found += struct.unpack_from(form, memory, at)
            at += struct.calcsize(form)
        else:
            for _ in range(count or 1):
                inner, at = numbers(types, kind, memory, at)
                found += inner
    return found, at


def flattened(types, name, message):
    """All numbers of a decoded message in the same order."""
    found = []
    for kind, count, field in types[name]:
        value = message[field] if isinstance(message, dict) else getattr(message, field)
        values = [value] if count is None else list(value)
        if kind in SIZES:
            found += values
        else:
            for inner in values:
                found += flattened(types, kind, inner)
    return found


def same(left, right):
    return len(left) == len(right) and all(a == b or (a != a and b != b) for a, b in zip(left, right))


def leaves(types, name, message):
    """All numbers and texts of a decoded message of a standard type, with sequences' lengths."""
    found = []
    for kind, count, field in types[name]:
        value = getattr(message, field)
        values = [value] if count is None else list(value)
        found += [len(values)] if count == -1 else []
        for inner in values:
            found += leaves(types, kind, inner) if kind in types else [inner]
    return found


def near(left, right):
    return math.isclose(left, right, rel_tol=1e-12, abs_tol=1e-9)


def check_pose(at, rotation, x, y, heading):
    assert (at.x, at.y, at.z, rotation.x, rotation.y) == (x, y, 0, 0, 0)
    assert near(rotation.z, math.sin(heading / 2)) and near(rotation.w, math.cos(heading / 2))


def check_scene(markers, step):
    ego = step.observation.ego
    groups = {(marker.ns, marker.id): marker for marker in markers}
    assert len(groups) == len(markers) == 9
    assert all(marker.header.frame_id == "base_link" for marker in markers)
    assert f"{ego.speed_mps:.1f} m/s" in groups["driver", 0].text
    assert groups["car", 0].scale.x > groups["car", 0].scale.y > 1
    for name, proposal in [("expert", step.expert), ("policy", step.policy)]:
        points = groups[name, 0].points
        assert (len(points) > 2) == (proposal.present == 1), name
        assert not points or points[0].x == points[0].y == 0
        # Nothing to draw removes what was drawn.
        assert groups[name, 0].action == (0 if points else 2)
    # The road is on both sides of the car where it is beside it.
    left, right = groups["road", 0].points, groups["road", 1].points
    assert len(left) == len(right) > 2
    checkpoints = [(point.x, point.y) for point in groups["checkpoints", 0].points]
    expected = [(point.x_body_m, point.y_body_m) for point in step.observation.checkpoints]
    assert checkpoints == expected


def check_path(poses, step):
    plan = step.plan
    has_plan = step.plan_age_ns != 2**64 - 1
    assert len(poses) == (plan.waypoint_count if has_plan else 0)
    heading = plan.origin_heading_world_rad
    for pose, point in zip(poses, plan.waypoints):
        x = math.cos(heading) * point.x_body_m - math.sin(heading) * point.y_body_m
        y = math.sin(heading) * point.x_body_m + math.cos(heading) * point.y_body_m
        assert near(pose.pose.position.x, plan.origin_x_world_m + x)
        assert near(pose.pose.position.y, plan.origin_y_world_m + y)


def check_shown(topic, message, step):
    """Compares a message of a standard topic with the step that it shows."""
    observation, ego = step.observation, step.observation.ego
    world = (ego.x_world_m, ego.y_world_m, ego.heading_world_rad)
    if topic == "/tf":
        # A scanner that is not at the car's middle has a transform of its own.
        mount = (observation.scanner_x_body_m, observation.scanner_y_body_m)
        moved, *mounted = message.transforms
        assert len(mounted) == (mount != (0, 0))
        for one in mounted:
            assert (one.header.frame_id, one.child_frame_id) == ("base_link", "scanner")
            check_pose(one.transform.translation, one.transform.rotation, *mount, 0)
        assert (moved.header.frame_id, moved.child_frame_id) == ("map", "base_link")
        check_pose(moved.transform.translation, moved.transform.rotation, *world)
    elif topic == "/ros/pose":
        assert message.header.frame_id == "map"
        check_pose(message.pose.position, message.pose.orientation, *world)
    elif topic == "/ros/scan":
        count, most = observation.beam_count, observation.lidar_max_m
        gaps = count if observation.field_of_view_rad >= math.tau else count - 1
        assert message.range_max == most
        assert abs(message.angle_increment * gaps - observation.field_of_view_rad) < 1e-3
        ranges = observation.ranges_m[:count]
        assert list(message.ranges) == [r if r < most else math.inf for r in ranges]
    elif topic == "/ros/plan":
        check_path(message.poses, step)
    elif topic == "/ros/scene":
        check_scene(message.markers, step)
    elif topic == "/ros/tree":
        (tree,) = message.markers
        assert (tree.ns, tree.type, len(tree.points) % 2) == ("tree", 5, 0)
        assert all(math.isfinite(point.x) and abs(point.x) < 200 for point in tree.points)
    elif topic == "/diagnostics":
        drive = message.status[0]
        said = {value.key: value.value for value in drive.values}
        assert (drive.name, said["tick"]) == ("vlaps: drive", str(step.header.tick))
        assert said["speed_mps"] == f"{ego.speed_mps:.2f}"
    else:
        raise AssertionError(f"{topic} is not known")


def stamp_of(topic, message):
    if topic == "/tf":
        header = message.transforms[0].header
    elif topic in ("/ros/scene", "/ros/tree"):
        header = message.markers[0].header
    else:
        header = message.header
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def standard(path):
    """Compares the standard topics; returns how many messages each has."""
    store, known, counts = get_typestore(Stores.EMPTY), {}, {}
    # A step of each tick and of each observation, by epoch time.
    ticks, observations, shown = {}, {}, []
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        facts = {record.name: record.metadata for record in reader.iter_metadata()}
        offset = int(facts["vlaps.recording"]["epoch_offset_ns"])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            if channel.topic == "/step":
                ticks[offset + decoded.header.taken_ns] = decoded
                observations[offset + decoded.observation.header.taken_ns] = decoded
            if "made_from" not in channel.metadata:
                continue
            if schema.id not in known:
                known[schema.id] = definitions(schema)
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            types, name = known[schema.id], schema.name.replace("/msg/", "/")
            other = store.deserialize_cdr(message.data, schema.name)
            expected, there = leaves(types, name, decoded), leaves(types, name, other)
            assert same(expected, there), channel.topic
            # What is written again is the same bytes.
            assert bytes(store.serialize_cdr(other, schema.name)) == message.data, channel.topic
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            shown.append((channel.topic, decoded))
    for topic, decoded in shown:
        if topic == "/ros/picture":
            assert (decoded.format, bytes(decoded.data[:2])) == ("jpeg", b"\xff\xd8")
            continue
        steps = ticks if topic == "/diagnostics" else observations
        check_shown(topic, decoded, steps[stamp_of(topic, decoded)])
    return counts


def rerun(path):
    """Loads the file with Rerun's own reader, where it is installed; says what it made."""
    if importlib.util.find_spec("rerun") is None:
        return "skipped: Rerun: rerun-sdk is not installed"
    with tempfile.TemporaryDirectory() as folder:
        made = f"{folder}/made.rrd"
        command = [sys.executable, "-m", "rerun"]
        subprocess.run([*command, "mcap", "convert", path, "-o", made], check=True, capture_output=True)
        printed = subprocess.run([*command, "rrd", "print", made], check=True, capture_output=True)
    lines = printed.stdout.decode().splitlines()
    # What it draws, and what it shows as typed data.
    for topic, column in [
        ("/tf", "Transform3D:translation"),
        ("/ros/pose", "InstancePoses3D:translations"),
        ("/ros/plan", "nav_msgs.msg.Path:message"),
        ("/ros/scan", "sensor_msgs.msg.LaserScan:message"),
        ("/ros/scene", "visualization_msgs.msg.MarkerArray:message"),
        ("/diagnostics", "diagnostic_msgs.msg.DiagnosticArray:message"),
    ]:
        assert any(f" - {topic} - " in line and column in line for line in lines), (topic, column)
    return "Rerun decodes the standard topics"


def rerun_fields(path, known, expected):
    """Compares our messages as Rerun's own reader decodes them with `expected`: their numbers by
    topic and header; by topic the count of those that are too long."""
    if importlib.util.find_spec("rerun") is None:
        return "skipped: fields in Rerun: rerun-sdk is not installed"
    from rerun.chunk import McapReader

    left, count = dict(expected), 0
    for chunk in McapReader(path).stream().to_chunks():
        batch = None if chunk.is_static else chunk.to_record_batch()
        for column in batch.schema.names if batch else []:
            name = column.removesuffix(":message")
            if name not in known:
                continue
            count += batch.num_rows
            if chunk.entity_path in left:
                left[chunk.entity_path] -= batch.num_rows
                continue
            for cell in batch.column(column):
                # A list of one message.
                [message] = cell.as_py()
                found = flattened(*known[name], message)
                at = (chunk.entity_path, *found[:HEADER])
                assert same(left.pop(at), found), at
    missing = {at: numbers for at, numbers in left.items() if numbers}
    assert not missing, f"Rerun has not decoded {list(missing)[:3]} and more"
    return f"{count} messages are equal in Rerun"


def main(path):
    store = get_typestore(Stores.EMPTY)
    known, count, named, all_numbers = {}, 0, {}, {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            if "made_from" in channel.metadata:
                continue
            if schema.id not in known:
                known[schema.id] = definitions(schema)
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            types, name = known[schema.id], schema.name.replace("/msg/", "/")
            named[schema.name.replace("/", ".")] = (types, name)
            expected, end = numbers(types, name, message.data, 4)
            assert end == len(message.data), f"{channel.topic}: {end} of {len(message.data)} bytes"
            if len(expected) > NUMBERS_MAX:
                all_numbers[channel.topic] = all_numbers.get(channel.topic, 0) + 1
            else:
                all_numbers[(channel.topic, *expected[:HEADER])] = expected
                assert same(expected, flattened(types, name, decoded)), channel.topic
                other = store.deserialize_cdr(message.data, schema.name)
                assert same(expected, flattened(types, name, other)), channel.topic
            count += 1
    assert count > 0
    print(f"{count} messages of {len(known)} types are equal")
    print(rerun_fields(path, named, all_numbers))
    counts = standard(path)
    print(f"{sum(counts.values())} messages of {len(counts)} standard topics are equal: {counts}")
    print(rerun(path))


main(sys.argv[1])

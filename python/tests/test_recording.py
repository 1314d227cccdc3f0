"""Recordings: read as arrays, frames, tables and episodes; and refused with what to do."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vlaps
from vlaps.columns import flat
from vlaps.definition import NoFixedSize, dtype_of
from vlaps.tables import main

CHECKOUT = Path(os.environ.get("VLAPS_CHECKOUT", Path(__file__).parents[2]))
PROGRAMS = os.environ.get("VLAPS_PROGRAMS")
TICKS = 200


def needs(package):
    missing = importlib.util.find_spec(package) is None
    return pytest.mark.skipif(missing, reason=f"{package} is not installed")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The folder of a real recording, and the figures of its run."""
    if not (PROGRAMS and (Path(PROGRAMS) / "vlaps-supervisor").exists()):
        pytest.skip("VLAPS_PROGRAMS names no folder with the built programs")
    folder = tmp_path_factory.mktemp("recorded")
    policy = CHECKOUT / "results/learning/ppl-10000.onnx"
    command = [str((Path(PROGRAMS) / "vlaps-supervisor").absolute()), "up", "--lockstep", "--seed", "3"]
    command += ["--duration", str(TICKS / 10), "--policy", str(policy), "--gate", "rules"]
    command += ["--record", str(folder / "rec"), "--run", f"t{os.getpid()}-recording"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "rec"


@pytest.fixture
def recording(recorded):
    return vlaps.Recording(recorded)


def test_topics_have_counts_times_and_types(recording):
    step = recording.topics["step"]
    assert step.count == TICKS == len(recording["step"])
    assert step.schema == "vlaps_msgs/msg/Step" and step.is_current
    # In lockstep the recording has the simulated time.
    assert 0.0 <= step.start < step.end <= recording.duration
    assert step.end - step.start == pytest.approx((TICKS - 1) / 10, abs=0.3)
    assert {"observation", "plan", "command", "progress"} <= set(recording)
    assert recording.metadata["lockstep"] == "1" and recording.metadata["rate_hz"] == "10"
    assert not recording.damage and len(recording.files) == 1
    assert 'clock = "lockstep"' in recording.configuration
    policy = next(one for one in recording.attachments if one.name.startswith("policy/"))
    assert recording.attachment(policy.name) == (CHECKOUT / "results/learning/ppl-10000.onnx").read_bytes()


def test_messages_are_structured_arrays(recording):
    steps = recording["step"]
    assert steps["header"]["tick"].tolist() == list(range(TICKS))
    # A step holds copies of what it was decided from.
    observations = {int(row["header"]["sequence"]): row for row in recording["observation"]}
    for step in steps[:: TICKS // 20]:
        seen = step["observation"]
        assert observations[int(seen["header"]["sequence"])].tobytes() == seen.tobytes()
    assert steps["observation"]["ranges_m"].shape[0] == TICKS
    assert (np.abs(steps["command"]["steer"]) <= 1).all()
    assert recording.read("step", every=7)["header"]["tick"].tolist() == list(range(0, TICKS, 7))


def test_a_time_span_begins_and_ends_where_it_is_asked(recording):
    times, ticks = recording.times("step"), recording["step"]["header"]["tick"]
    assert (np.diff(times) >= 0).all()
    inside = (times >= times[50]) & (times <= times[80])
    part = recording.read("step", times[50], times[80])
    # Half a nanosecond is lost on the way.
    assert abs(len(part) - inside.sum()) <= 1
    assert set(part["header"]["tick"]) <= set(ticks[49:82])
    assert len(recording.read("step", recording.duration + 1)) == 0
    assert len(recording.read("step", -5, -1)) == 0
    assert len(recording.read("step", 1e300)) == 0
    assert len(recording.read("step", -1e300, 1e300)) == len(times)


def test_iteration_has_every_message_in_order(recording):
    counted, last = {}, -1.0
    for message in recording.iterate():
        counted[message.topic] = counted.get(message.topic, 0) + 1
        assert message.time >= last
        last = message.time
    assert counted == {topic.name: topic.count for topic in recording.topics.values()}
    ticks = [int(message.data["header"]["tick"]) for message in recording.iterate("step")]
    assert ticks == list(range(TICKS))
    joined = np.concatenate([rows for _, rows in recording.batches("step", 64)])
    assert (joined == recording["step"]).all()


def test_flat_columns_are_the_message(recording):
    steps = recording["step"]
    columns = flat(steps)
    assert (columns["plan.waypoints.x_body_m"] == steps["plan"]["waypoints"]["x_body_m"]).all()
    bytes_of = sum(column.dtype.itemsize * column[0].size for column in columns.values())
    # No field is left out.
    assert bytes_of == steps.dtype.itemsize
    with pytest.raises(KeyError, match="no column matches 'comand"):
        flat(steps, ["comand.*"])


@needs("pandas")
def test_pandas_frames(recording):
    frame = recording.to_pandas("step", columns=["header.tick", "command.*", "observation.ranges_m"])
    assert frame["header.tick"].tolist() == list(range(TICKS))
    assert (frame["command.steer"] == recording["step"]["command"]["steer"]).all()
    assert (frame["observation.ranges_m"][5] == recording["step"][5]["observation"]["ranges_m"]).all()


@needs("polars")
def test_polars_frames(recording):
    frame = recording.to_polars("plan", columns=["header.tick", "waypoints.*"])
    assert frame["header.tick"].to_list() == recording["plan"]["header"]["tick"].tolist()
    assert (frame["waypoints.x_body_m"].to_numpy() == recording["plan"]["waypoints"]["x_body_m"]).all()


@pytest.mark.parametrize("format", ["parquet", "arrow"])
@needs("pyarrow")
def test_exported_tables_hold_every_bit(recording, recorded, tmp_path, format):
    assert main([str(recorded), "--format", format, "--out", str(tmp_path), "--topic", "step"]) == 0
    path = tmp_path / f"step.{format}"
    if format == "parquet":
        from pyarrow import parquet

        table = parquet.read_table(path)
    else:
        from pyarrow import ipc

        table = ipc.open_file(path).read_all()
    columns = flat(recording["step"])
    assert table.column_names == ["recorded_s", *columns]
    for name, expected in columns.items():
        found = table[name].combine_chunks()
        found = found.flatten() if expected.ndim > 1 else found
        # NaN included.
        assert found.to_numpy(zero_copy_only=False).tobytes() == np.ascontiguousarray(expected).tobytes(), name
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_episodes_are_the_recorded_drive(recording):
    data = recording.episodes()
    steps = recording["step"]
    assert len(data.episodes) == 1 and len(data) == TICKS - 1
    one = data.episodes[0]
    assert one.seed == 3 and one.observations.shape == (TICKS, 259)
    assert (one.actions[:, 0] == steps["command"]["steer"][:-1].astype(np.float32)).all()
    words = {code: word for code, word in vlaps._vlaps.words()["Driver"].items()}
    drove = np.array([words[code] for code in steps["command"]["driver"][:-1].tolist()])
    assert (one.takeover == (drove != "policy")).all() and 0 < one.takeover.sum() < len(one.takeover)
    told = recording["progress"]
    driven_m = (told["completion"][-1] - told["completion"][0]) * told["route_m"][0]
    assert one.rewards.sum() == pytest.approx(driven_m, abs=2.0) and driven_m > 10
    assert one.truncated[-1] and not one.terminated.any()
    # The policy's input is the one that it was asked with.
    policy = vlaps.Policy(recording.attachment(next(a.name for a in recording.attachments if a.name.startswith("policy/"))))
    asked = steps["policy"]["present"][:-1] == 1
    again = policy(one.observations[:-1][asked])
    assert np.abs(again - one.proposals[asked]).max() < 1e-6


@needs("minari")
def test_minari_reads_a_recorded_drive(recorded, monkeypatch, tmp_path):
    pytest.importorskip("h5py", reason="minari needs h5py to store")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    import minari

    assert main([str(recorded), "--format", "minari", "--out", "vlaps/takeovers-v0"]) == 0
    stored = next(iter(minari.load_dataset("vlaps/takeovers-v0").iterate_episodes()))
    expected = vlaps.Recording(recorded).episodes().episodes[0]
    assert (stored.observations == expected.observations).all()
    assert (stored.infos["takeover"] == expected.takeover).all()


@needs("pandas")
@needs("pyarrow")
def test_lerobot_holds_a_recorded_drive(recorded, tmp_path, capsys):
    import pandas

    folder = tmp_path / "takeovers"
    assert main([str(recorded), "--format", "lerobot", "--out", str(folder)]) == 0
    expected = vlaps.Recording(recorded).episodes()
    one, count = expected.episodes[0], len(expected)
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_frames"]) == ("v3.0", 10, count)
    # As LeRobot finds it: the episode's row names the file of its frames.
    episodes = pandas.read_parquet(folder / "meta/episodes")
    row = episodes.iloc[0]
    place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
    frames = pandas.read_parquet(folder / info["data_path"].format(**place))
    assert list(frames.columns) == list(info["features"])
    assert (row["dataset_from_index"], row["dataset_to_index"], row["length"]) == (0, count, count)
    assert (np.stack(frames["observation.state"]) == one.observations[:-1]).all()
    assert (np.stack(frames["action"]) == one.actions).all()
    assert (frames["takeover"].to_numpy() == one.takeover).all() and frames["next.done"].sum() == 1
    assert np.allclose(frames["timestamp"], np.arange(count) / 10)
    for name, feature in info["features"].items():
        value = np.asarray(frames[name].iloc[0])
        assert (str(value.dtype), list(value.shape) or [1]) == (feature["dtype"], feature["shape"]), name
    stats = json.loads((folder / "meta/stats.json").read_text())
    assert np.allclose(stats["action"]["mean"], one.actions.mean(0), atol=1e-6)
    assert np.allclose(row["stats/action/max"], one.actions.max(0))
    tasks = pandas.read_parquet(folder / "meta/tasks.parquet")
    assert tasks.loc[row["tasks"][0], "task_index"] == 0
    # A second export writes over nothing.
    assert main([str(recorded), "--format", "lerobot", "--out", str(folder)]) == 2
    assert "it exists" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["takeovers"]


def test_a_fork_without_a_change_is_the_recording(recording):
    figures = recording.fork(TICKS // 2, program=Path(PROGRAMS) / "vlaps-lab")
    assert figures["identical"] is True and figures["tick"] == TICKS // 2
    with pytest.raises(RuntimeError, match="tick 99999"):
        recording.fork(99_999, program=Path(PROGRAMS) / "vlaps-lab")
    with pytest.raises(FileNotFoundError, match="no such program"):
        recording.fork(1, program="nowhere/vlaps")


def test_files_that_are_cut_off_are_read_to_their_end(recorded, tmp_path):
    whole = next(recorded.iterdir()).read_bytes()
    cut, read = tmp_path / "cut.mcap", 0
    # A file that lacks a part of its last eight bytes alone, a mark, is whole.
    for length in range(0, len(whole) - 8, len(whole) // 29):
        cut.write_bytes(whole[:length])
        try:
            recording = vlaps.Recording(cut)
            found = sum(1 for _ in recording.iterate())
            assert found == sum(topic.count for topic in recording.topics.values()), length
            assert len(recording.damage) == 1 and "cut.mcap" in recording.damage[0]
            read += found > 0
        except vlaps.RecordingError as error:
            assert "cut.mcap" in str(error) and "\n" not in str(error), length
    assert read > 3


def test_flipped_bits_raise_or_change_nothing(recorded, tmp_path):
    whole = next(recorded.iterdir()).read_bytes()
    flipped, expected = tmp_path / "flipped.mcap", vlaps.Recording(recorded)["step"].tobytes()
    raised = 0
    for at in range(0, len(whole), len(whole) // 151):
        changed = bytearray(whole)
        changed[at] ^= 4
        flipped.write_bytes(changed)
        try:
            recording = vlaps.Recording(flipped)
            found = recording["step"].tobytes()
            assert found == expected or (recording.damage and expected.startswith(found)), at
        except (vlaps.RecordingError, KeyError, TypeError) as error:
            assert "\n" not in str(error), at
            raised += 1
    assert raised > 5


def test_what_is_no_recording_says_what_to_do(tmp_path):
    with pytest.raises(FileNotFoundError, match="missing"):
        vlaps.Recording(tmp_path / "missing")
    with pytest.raises(vlaps.RecordingError, match="no file ending in .mcap; give"):
        vlaps.Recording(tmp_path)
    other = tmp_path / "other.mcap"
    other.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    with pytest.raises(vlaps.RecordingError, match="other.mcap"):
        vlaps.Recording(other)
    other.write_bytes(b"no recording at all")
    with pytest.raises(vlaps.RecordingError, match="it is no MCAP file"):
        vlaps.Recording(other)
    assert main([str(other), "--out", str(tmp_path / "tables")]) == 2


@needs("pyarrow")
def test_a_topic_that_is_not_there_ends_the_export_with_2(recorded, tmp_path, capsys):
    assert main([str(recorded), "--out", str(tmp_path), "--topic", "nope"]) == 2
    assert "--topic nope: the recording has observation" in capsys.readouterr().err
    # A span without a message is a table without rows.
    assert main([str(recorded), "--out", str(tmp_path), "--topic", "step", "--from", "1e6"]) == 0
    from pyarrow import parquet

    assert parquet.read_table(tmp_path / "step.parquet").num_rows == 0


def test_requests_that_do_not_fit_are_refused(recording):
    with pytest.raises(KeyError, match="no topic 'stepp'.*step"):
        recording["stepp"]
    with pytest.raises(KeyError, match="no attachment 'x'.*config.toml"):
        recording.attachment("x")
    with pytest.raises(ValueError, match="start = nan"):
        recording.read("step", start=float("nan"))
    with pytest.raises(ValueError, match="every = 0"):
        recording.read("step", every=0)
    with pytest.raises(ValueError, match="rows = 0"):
        next(recording.batches("step", 0))
    with pytest.raises(ValueError, match="259"):
        recording.features(np.zeros(2, recording.topics["observation"].dtype))


def test_observations_of_another_build_are_no_input_of_a_policy(recording):
    others = {name: replace(topic, is_current=False) for name, topic in recording.topics.items()}
    recording.__dict__["topics"] = others
    # Its messages are read all the same: their definition is in the file.
    assert len(recording["step"]) == TICKS
    with pytest.raises(vlaps.RecordingError, match="use the build that recorded it"):
        recording.features(recording["observation"])


def test_a_missing_package_is_named(recording, monkeypatch):
    import importlib

    def refuse(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", refuse)
    for call in (recording.to_pandas, recording.to_polars, recording.to_arrow):
        with pytest.raises(ImportError, match="pip install"):
            call("step")


def test_types_follow_the_definition():
    point = "=" * 80 + "\nMSG: vlaps_msgs/Point\nfloat64 x_m\nfloat64 y_m\n"
    made = dtype_of("uint64 tick # a comment\nuint32 LIMIT=3\nvlaps_msgs/Point[2] at\nuint8[8] map\n" + point, "vlaps_msgs/msg/New")
    assert made == np.dtype([("tick", "<u8"), ("at", [("x_m", "<f8"), ("y_m", "<f8")], 2), ("map", "u1", 8)])
    for text in ("string name\n", "float32[] ranges\n", "vlaps_msgs/Unknown at\n", "uint8 a\nfloat64 b\n", "a b c\n"):
        with pytest.raises(NoFixedSize, match="vlaps_msgs/msg/New"):
            dtype_of(text, "vlaps_msgs/msg/New")


def test_the_examples_of_the_page_run(recorded, tmp_path, monkeypatch):
    for package in ("pandas", "polars"):
        pytest.importorskip(package)
    shutil.copytree(recorded, tmp_path / "rec")
    monkeypatch.chdir(tmp_path)
    page = (CHECKOUT / "docs/export.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names = {}
    for number, block in enumerate(blocks):
        exec(compile(block, f"docs/export.md, block {number}", "exec"), names)
    assert len(blocks) >= 3 and len(names["steps"]) == TICKS


def test_the_examples_of_the_modules_hold():
    import doctest

    from vlaps import columns, definition

    for module in (columns, definition):
        failed, tried = doctest.testmod(module)
        assert tried and not failed, module.__name__

"""Pictures and videos."""

import struct
import zlib

import gymnasium
import numpy as np
import pytest

import vlaps


def test_pictures_show_the_world_as_it_moves():
    env = gymnasium.make(
        vlaps.ENV_ID, render_mode="rgb_array", render_size=(320, 240), num_scenarios=3
    )
    env.reset(seed=1)
    before = env.render()
    assert before.shape == (240, 320, 3) and before.dtype == np.uint8
    # The car is white, in the middle of the lower half, and the road around it is grey.
    assert (before[165:190, 155:166].min(axis=2) > 200).any()
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 5
    for _ in range(30):
        env.step(np.float32([0.0, 1.0]))
    assert (env.render() != before).mean() > 0.01
    ego = vlaps.MetaDriveEnv(render_mode="rgb_array", render_view="ego", render_size=(320, 240))
    ego.reset(seed=1)
    assert (ego.render() != before).mean() > 0.3


def test_a_vector_renders_every_world():
    env = vlaps.MetaDriveVectorEnv(3, num_scenarios=3, render_mode="rgb_array", render_size=(64, 48))
    env.reset()
    pictures = env.render()
    assert [picture.shape for picture in pictures] == [(48, 64, 3)] * 3
    assert (pictures[0] != pictures[1]).any()


def test_pictures_that_cannot_be():
    for size in ((0, 10), (10, 99_999), (-1, 5), (2.5, 3), (4,), "x", 5):
        for make in (vlaps.MetaDriveEnv, vlaps.MetaDriveVectorEnv):
            with pytest.raises(ValueError, match="render_size"):
                make(render_mode="rgb_array", render_size=size)
    with pytest.raises(ValueError, match="top_down"):
        vlaps.MetaDriveEnv(render_mode="rgb_array", render_view="behind")


def test_a_window_needs_a_display(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(RuntimeError, match="rgb_array.*write_video"):
        vlaps.MetaDriveEnv(render_mode="human")


def frames_of(path):
    """The pictures of an animated PNG, decoded by hand."""
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, size, frames, sequence, compressed = 8, None, [], [], []
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        assert zlib.crc32(kind + body) == struct.unpack(">I", data[at + 8 + length : at + 12 + length])[0]
        if kind == b"IHDR":
            size = struct.unpack(">II", body[:8])
        if kind in (b"fcTL", b"fdAT"):
            sequence.append(struct.unpack(">I", body[:4])[0])
        if kind in (b"IDAT", b"fdAT"):
            compressed.append(body[4 * (kind == b"fdAT") :])
        at += 12 + length
    assert sequence == list(range(len(sequence)))
    for stream in compressed:
        rows = np.frombuffer(zlib.decompress(stream), np.uint8).reshape(size[1], 1 + 3 * size[0])
        assert (rows[:, 0] == 2).all()
        frames.append(np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8).reshape(size[1], size[0], 3))
    return frames


def test_a_video_holds_its_frames(tmp_path):
    env = vlaps.MetaDriveEnv(render_mode="rgb_array", render_size=(80, 60))
    env.reset(seed=2)
    frames = []
    for _ in range(5):
        frames.append(env.render())
        env.step([0.1, 1.0])
    vlaps.write_video(tmp_path / "drive.png", frames)
    read = frames_of(tmp_path / "drive.png")
    assert len(read) == 5
    assert all((a == b).all() for a, b in zip(read, frames))
    for path, pictures in (("drive.gif", frames), ("a.png", []), ("b.png", [frames[0][:, :, 0]])):
        with pytest.raises(ValueError):
            vlaps.write_video(tmp_path / path, pictures)
    with pytest.raises(ValueError, match="frame 1"):
        vlaps.write_video(tmp_path / "c.png", [frames[0], frames[0][1:]])
    assert [file.name for file in tmp_path.iterdir()] == ["drive.png"]

"""Recorded episodes, and their export to Minari."""

import importlib.util

import numpy as np
import pytest

import vlaps
from drive import SHORT, turn_and_go


def test_a_recording_repeats_in_a_single_environment():
    data = vlaps.collect(turn_and_go, 200, num_envs=4, threads=2, **{**SHORT, "num_scenarios": 30})
    assert len(data) == 200 and data.driver == "turn_and_go"
    assert [one.seed for one in data.episodes if one.seed % 4 == 0][:3] == [0, 4, 8]
    for one in data.episodes:
        env = vlaps.MetaDriveEnv(**{**SHORT, "num_scenarios": 30})
        observation, _ = env.reset(seed=one.seed)
        assert (observation == one.observations[0]).all()
        for k, action in enumerate(one.actions):
            observation, reward, terminated, truncated, info = env.step(action)
            assert (observation == one.observations[k + 1]).all()
            assert (reward, info["cost"]) == (one.rewards[k], one.costs[k])
            assert (terminated, truncated) == (one.terminated[k], one.truncated[k])
            assert not (terminated or truncated) or k + 1 == len(one.actions)
    rows = data.transitions()
    assert rows["observations"].shape == rows["next_observations"].shape == (200, 43)
    assert not rows["takeover"].any() and (rows["proposals"] == rows["actions"]).all()


def test_takeovers_are_recorded():
    rule = vlaps.Takeover("differs", "idm", differ=0.7)
    random = np.random.default_rng(0)
    drive = lambda seen: random.uniform(-0.5, 1.0, (len(seen), 2)).astype(np.float32)  # noqa: E731
    data = vlaps.collect(drive, 60, num_envs=2, takeover=rule, num_scenarios=2).transitions()
    taken = data["takeover"]
    assert 0 < taken.sum() < 60
    assert (data["actions"][~taken] == data["proposals"][~taken]).all()
    assert (np.abs(data["actions"][taken] - data["proposals"][taken]).max(axis=1) > 0.7).all()


def test_experts_and_policies_are_recorded():
    assert len(vlaps.collect("idm", 10)) == 10
    assert len(vlaps.collect(lambda seen: np.zeros((len(seen), 2)), 3, num_envs=2)) == 4


def test_recordings_that_are_asked_wrongly():
    for arguments, options, error, message in [
        (("idm", 0), {}, ValueError, "steps"),
        (("none", 3), {}, ValueError, "idm"),
        ((3, 3), {}, TypeError, "cannot drive"),
        (("idm", 3), {"autoreset_mode": "Disabled"}, ValueError, "autoreset_mode"),
        (("idm", 3), {"num_envs": 0}, ValueError, "num_envs"),
    ]:
        with pytest.raises(error, match=message):
            vlaps.collect(*arguments, **options)


@pytest.mark.skipif(importlib.util.find_spec("minari") is None, reason="minari is not installed")
def test_minari_reads_a_recording(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    pytest.importorskip("h5py", reason="minari needs h5py to store")
    import minari

    data = vlaps.collect("idm", 100, num_envs=2, **SHORT)
    data.to_minari("vlaps/idm-v0", author="vlaps")
    found = minari.load_dataset("vlaps/idm-v0")
    assert found.total_steps == len(data) == 100
    assert found.total_episodes == len(data.episodes)
    for one, stored in zip(data.episodes, found.iterate_episodes()):
        assert (stored.observations == one.observations).all()
        assert (stored.actions == one.actions).all() and (stored.rewards == one.rewards).all()
        assert (stored.terminations == one.terminated).all()
        assert (stored.infos["cost"] == one.costs).all()
        assert stored.terminations[-1] or stored.truncations[-1]
    env = found.recover_environment()
    assert env.reset(seed=3)[0].shape == (43,)

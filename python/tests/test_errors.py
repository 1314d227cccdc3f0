"""Exceptions that say what to do; after each the environment still works."""

import json

import numpy as np
import pytest

import vlaps


@pytest.fixture
def env():
    env = vlaps.MetaDriveEnv(num_scenarios=3)
    env.reset()
    yield env
    env.step([0.0, 0.5])


@pytest.fixture
def vector():
    vector = vlaps.MetaDriveVectorEnv(3, num_scenarios=3)
    vector.reset()
    yield vector
    vector.step(np.zeros((3, 2), np.float32))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_actions_that_are_no_numbers(env, vector, bad):
    with pytest.raises(ValueError, match="finite"):
        env.step([0.0, bad])
    actions = np.zeros((3, 2), np.float32)
    actions[1, 0] = bad
    with pytest.raises(ValueError, match="action 1.*finite"):
        vector.step(actions)


@pytest.mark.parametrize("shape", [(3,), (1, 2), (0,), ()])
def test_actions_of_the_wrong_shape(env, shape):
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros(shape, np.float32))


@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (3,), (3, 2, 1)])
def test_batches_of_the_wrong_shape(vector, shape):
    for call in (vector.step, vector.send, vector.judge):
        with pytest.raises(ValueError, match=r"have the shape \(.*must be \(3, 2\)"):
            call(np.zeros(shape, np.float32))
    with pytest.raises(ValueError, match="takeover"):
        vector.send(np.zeros((3, 2), np.float32), takeover=np.ones(2, bool))


def test_actions_of_the_wrong_type(env, vector):
    with pytest.raises((ValueError, TypeError)):
        env.step(["left", "fast"])
    with pytest.raises(TypeError, match="None"):
        env.step(None)
    with pytest.raises(ValueError, match="shape"):
        vector.step(None)


def test_environments_that_are_closed():
    env = vlaps.MetaDriveEnv()
    env.reset()
    env.close()
    env.close()
    calls = (
        env.reset,
        env.get_state,
        env.expert,
        lambda: env.set_state(b""),
        lambda: env.judge([0, 0]),
        lambda: env.step([0, 0]),
        lambda: env.step([0, 0], takeover=True),
    )
    for call in calls:
        with pytest.raises(RuntimeError, match="closed"):
            call()
    vector = vlaps.MetaDriveVectorEnv(2)
    vector.close()
    still = np.zeros((2, 2), np.float32)
    calls = (
        vector.reset,
        vector.seeds,
        vector.expert,
        lambda: vector.get_state(0),
        lambda: vector.set_state(0, b""),
        lambda: vector.judge(still),
        lambda: vector.step(still),
        lambda: vector.send(still),
    )
    for call in calls:
        with pytest.raises(RuntimeError, match="closed"):
            call()


def test_a_step_before_the_first_reset():
    with pytest.raises(RuntimeError, match="reset"):
        vlaps.MetaDriveEnv().step([0, 0])
    with pytest.raises(RuntimeError, match="reset"):
        vlaps.MetaDriveVectorEnv(2).step(np.zeros((2, 2), np.float32))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trafic_density": 0.1}, "did you mean 'traffic_density'"),
        ({"vehicle_config": {"lidar": {"lasers": 2}}}, "num_lasers"),
        ({"vehicle_config": 3}, "dictionary"),
        ({"num_scenarios": 0}, "num_scenarios"),
        ({"start_seed": -1}, "seed"),
        ({"seeds": []}, "seeds"),
        ({"seeds": 3}, "seeds = 3"),
        ({"seeds": [2**63]}, "seeds"),
        ({"seeds": [1.5]}, "seeds = 1.5"),
        ({"max_episode_steps": 9}, "did you mean 'horizon'"),
        ({"num_lasers": 9}, "did you mean vehicle_config={'lidar': {'num_lasers'"),
        ({"lane_num": 9}, "did you mean map_config={'lane_num'"),
        ({"map": None}, "map = None.*number of blocks"),
        ({"map": 257}, "map = 257.*between 1 and 256"),
        ({"horizon": 0}, "horizon"),
        ({"map": "SZ"}, "Z"),
        ({"map_config": {"lane_num": 99}}, "lane"),
        ({"traffic_density": -1.0}, "density"),
        ({"accident_prob": 2.0}, "accident"),
        ({"vehicle_config": {"lidar": {"num_lasers": 10_000}}}, "num_lasers = 10000.*2048"),
        ({"vehicle_config": {"lidar": {"distance": -5.0}}}, "distance = -5"),
        ({"vehicle_config": {"lidar": {"dropout_prob": 1.5}}}, "dropout_prob"),
        ({"vehicle_config": {"lidar": {"gaussian_noise": float("nan")}}}, "gaussian_noise"),
        ({"driving_reward": float("nan")}, "driving_reward"),
        ({"driving_reward": "much"}, "driving_reward"),
        ({"horizon": "long"}, "horizon"),
        ({"render_mode": "ascii"}, "render_mode"),
        ({"expert_config": 3}, "expert_config must be a dictionary"),
        ({"expert_config": {"mpc": {"speed": 1.0}}}, "mpc.speed'; did you mean 'mpc.speed_mps'"),
        ({"expert_config": {"mpc": {"speed_mps": -1.0}}}, "mpc.speed_mps = -1: must be within"),
        ({"expert_config": {"mpc": {"speed_mps": float("nan")}}}, "speed_mps.* = nan"),
        ({"expert_config": {"mpc": {"speed_mps": None}}}, "speed_mps.* = None"),
        ({"expert_config": {"planner": {"method": "guess"}}}, "mpc.*in 'method = \"guess\"'"),
    ],
)
def test_options_that_are_wrong(options, message):
    with pytest.raises((ValueError, TypeError), match=message):
        vlaps.MetaDriveEnv(**options).reset()


def test_seeds_that_are_wrong(env, vector):
    for seed in (-1, 2**63, 1.5, "3"):
        with pytest.raises((TypeError, ValueError), match="seed = "):
            env.reset(seed=seed)
    for seeds in (1.5, [1.9, 2.9, 3.9], [1, 2, -1], "123"):
        with pytest.raises((TypeError, ValueError), match="seed = "):
            vector.reset(seed=seeds)
    assert vector.reset(seed=iter([4, 5, 6]))[1]["seed"].tolist() == [4, 5, 6]
    with pytest.raises(TypeError, match="options"):
        vector.reset(options=[1])
    with pytest.raises(ValueError, match="2 seeds for 3"):
        vector.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="reset_mask"):
        vector.reset(options={"reset_mask": np.ones(2, bool)})
    with pytest.raises(ValueError, match="reset_mask"):
        vector.reset(options={"reset_mask": [1, 0, 1]})


def test_sizes_that_are_wrong(vector):
    for count in (0, -3, 2**70, "8", None, True, 2.0):
        with pytest.raises((TypeError, ValueError), match="num_envs = "):
            vlaps.MetaDriveVectorEnv(count)
    for threads in (0, "2", 1.5):
        with pytest.raises((TypeError, ValueError), match="threads = "):
            vlaps.MetaDriveVectorEnv(2, threads=threads)
    with pytest.raises(ValueError, match="at most 1048576"):
        vlaps.MetaDriveVectorEnv(10**12)
    with pytest.raises(ValueError, match="'sometimes': choose from NextStep"):
        vlaps.MetaDriveVectorEnv(2, autoreset_mode="sometimes")
    with pytest.raises(TypeError, match="whole number"):
        vector.get_state("0")
    for index in (3, -1):
        with pytest.raises(IndexError, match="there are 3"):
            vector.get_state(index)
        with pytest.raises(IndexError, match="there are 3"):
            vector.set_state(index, b"")


def test_a_takeover_that_is_no_rule():
    with pytest.raises(TypeError, match="differ = 'x'"):
        vlaps.Takeover("always", "mpc", "x")


def test_a_takeover_that_is_no_mark(env):
    with pytest.raises(ValueError, match="True, False or None"):
        env.step([0, 0], takeover="yes")


def test_the_greatest_seed_is_reported_exactly():
    for seed in (2**53 + 1, 2**63 - 1):
        assert vlaps.MetaDriveEnv(seeds=[seed]).reset()[1]["seed"] == seed
        assert vlaps.MetaDriveEnv().reset(seed=seed)[1]["seed"] == seed
        vector = vlaps.MetaDriveVectorEnv(2, seeds=[seed, 7])
        assert vector.reset()[1]["seed"].tolist() == [seed, 7]
        assert vector.seeds().tolist() == [seed, 7]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"actions": [[0.0, 0.5]] * 5000}, "ends after"),
        ({"actions": [[0.0, None]]}, "no state"),
        ({"actions": [[0.0, 1e39]]}, "finite|no state"),
        ({"advised": [3]}, "questions"),
        ({"advised": [1, 0]}, "questions"),
        ({"seed": 2**63}, "seed"),
        ({"seed": -1}, "no state"),
    ],
)
def test_stored_states_that_were_changed(env, change, message):
    env.step([0.0, 0.5])
    env.step([0.0, 0.5])
    stored = {**json.loads(bytes(env.get_state())), **change}
    with pytest.raises(ValueError, match=message):
        env.set_state(json.dumps(stored).encode())
    env.reset()

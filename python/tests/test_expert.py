"""The expert, and the assessment of proposals."""

import numpy as np
import pytest

import vlaps
from drive import actions

VERDICTS = {"clear", "leaves", "hits"}


def test_the_expert_arrives():
    vector = vlaps.MetaDriveVectorEnv(
        16, start_seed=100, num_scenarios=16, autoreset_mode="SameStep"
    )
    vector.reset()
    arrived = np.zeros(16, bool)
    ended = np.zeros(16, bool)
    while not ended.all():
        _, _, terminated, truncated, info = vector.step(vector.expert("idm"))
        arrived |= info["arrive_dest"] & ~ended
        ended |= terminated | truncated
    assert arrived.sum() >= 12


def test_the_expert_of_a_state_goes_on_as_before():
    env = vlaps.MetaDriveEnv(start_seed=100, num_scenarios=5)
    env.reset()
    for _ in range(80):
        env.step(env.expert())
    state = env.get_state()
    expected = [env.step(env.expert())[0].tobytes() for _ in range(40)]
    for again in (state, bytes(state)):
        env.set_state(again)
        assert [env.step(env.expert())[0].tobytes() for _ in range(40)] == expected


def test_single_and_vector_experts_and_judges_agree():
    vector = vlaps.MetaDriveVectorEnv(3, threads=2, num_scenarios=3)
    envs = [vlaps.MetaDriveEnv(seeds=[seed]) for seed in range(3)]
    vector.reset()
    for env in envs:
        env.reset()
    for proposal in actions(3, 30):
        advice, measured = vector.expert(), vector.judge(proposal)
        for k, env in enumerate(envs):
            assert (env.expert() == advice[k]).all()
            for name, value in env.judge(proposal[k]).items():
                assert measured[name][k] == value, name
            env.step(advice[k])
        vector.step(advice)


def test_the_judge_vetoes_what_leaves_the_road():
    env = vlaps.MetaDriveEnv(map="SSSS", traffic_density=0.0, accident_prob=0.0)
    env.reset(seed=1)
    for _ in range(60):
        env.step(env.expert())
    ahead, aside = env.judge([0.0, 0.0]), env.judge([1.0, 1.0])
    assert (ahead["verdict"], ahead["veto"]) == ("clear", False)
    assert ahead["progress_m"] > aside["progress_m"]
    assert (aside["verdict"], aside["veto"]) == ("leaves", True)
    assert aside["safe_s"] < ahead["safe_s"] == 1.5


def test_a_judge_and_an_expert_that_are_asked_wrongly():
    env = vlaps.MetaDriveEnv()
    with pytest.raises(RuntimeError, match="reset"):
        env.judge([0, 0])
    env.reset()
    with pytest.raises(ValueError, match="idm"):
        env.expert("human")
    with pytest.raises(ValueError, match="finite"):
        env.judge([0, float("nan")])
    with pytest.raises(ValueError, match="shape"):
        env.judge([0, 0, 0])

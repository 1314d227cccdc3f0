"""The stack's experts, and steps in which one of them drives."""

import numpy as np
import pytest

import vlaps
from drive import SHORT, actions
from vlaps.env import EXPERTS

PLANNERS = EXPERTS[1:]


@pytest.mark.parametrize("method", PLANNERS)
def test_a_planner_answers_from_the_state_alone(method):
    vector = vlaps.MetaDriveVectorEnv(5, threads=1, start_seed=1000, num_scenarios=5)
    threaded = vlaps.MetaDriveVectorEnv(5, threads=3, start_seed=1000, num_scenarios=5)
    vector.reset(), threaded.reset()
    for action in actions(5, 20):
        vector.step(action), threaded.step(action)
    advice = vector.expert(method)
    assert advice.dtype == np.float32 and (np.abs(advice) <= 1.0).all()
    assert len({one.tobytes() for one in advice}) == 5
    assert (vector.expert(method) == advice).all()
    assert (threaded.expert(method) == advice).all()
    single = vlaps.MetaDriveEnv(start_seed=1000, num_scenarios=5)
    single.set_state(vector.get_state(3))
    assert (single.expert(method) == advice[3]).all()
    single.set_state(bytes(vector.get_state(3)))
    assert (single.expert(method) == advice[3]).all()
    mask = np.array([True, False, True, False, False])
    some = vector.expert(method, mask)
    assert (some[mask] == advice[mask]).all() and np.isnan(some[~mask]).all()


def test_the_planners_are_four_different_ones():
    env = vlaps.MetaDriveEnv(start_seed=1000)
    env.reset()
    for _ in range(30):
        env.step(env.expert("mpc"))
    assert len({env.expert(method).tobytes() for method in PLANNERS}) == 4


def test_the_mpc_arrives():
    vector = vlaps.MetaDriveVectorEnv(4, start_seed=1003, num_scenarios=4, autoreset_mode="SameStep")
    vector.reset()
    arrived, ended = np.zeros(4, bool), np.zeros(4, bool)
    while not ended.all():
        _, _, terminated, truncated, info = vector.step(vector.expert("mpc"))
        arrived |= info["strict_success"] & ~ended
        ended |= terminated | truncated
    assert arrived.sum() >= 3


def test_the_configuration_of_the_experts_counts():
    def driven(config):
        env = vlaps.MetaDriveEnv(expert_config=config, start_seed=1003)
        env.reset()
        for _ in range(60):
            info = env.step(env.expert("mpc"))[4]
        return info["velocity"]

    assert driven({"mpc": {"speed_mps": 3.0}}) < 3.2 < 4.5 < driven(None)
    for wrong, error, message in [
        ({"mpc": {"speed": 3.0}}, ValueError, "speed"),
        ({"mpc": {"speed_mps": -1.0}}, ValueError, "mpc.speed_mps"),
        ({"mcp": {}}, ValueError, "mcp"),
        (3, TypeError, "dictionary"),
    ]:
        with pytest.raises(error, match=message):
            vlaps.MetaDriveEnv(expert_config=wrong)


def test_the_expert_drives_where_it_is_asked_to():
    vector = vlaps.MetaDriveVectorEnv(3, threads=2, num_scenarios=3, autoreset_mode="Disabled")
    twin = vlaps.MetaDriveVectorEnv(3, threads=2, num_scenarios=3, autoreset_mode="Disabled")
    single = vlaps.MetaDriveEnv(seeds=[1])
    vector.reset(), twin.reset(), single.reset()
    for step, proposal in enumerate(actions(3, 10)):
        asked = np.array([False, step % 2 == 0, False])
        expert = vector.expert("mpc")
        observation, _, _, _, info = vector.step(proposal, takeover=asked)
        assert (info["proposal"] == proposal).all()
        assert (info["takeover"] == asked).all()
        assert info["driver"].tolist() == ["expert" if one else "policy" for one in asked]
        assert (info["applied"] == np.where(asked[:, None], expert, proposal)).all()
        assert (info["expert"][asked] == expert[asked]).all()
        assert np.isnan(info["expert"][~asked]).all()
        # The world obeyed the applied action, and nothing else.
        assert (twin.step(info["applied"])[0] == observation).all()
        result = single.step(proposal[1], takeover=bool(asked[1]))
        assert (result[0] == observation[1]).all()
        assert result[4]["driver"] == info["driver"][1]
        assert (result[4]["applied"] == info["applied"][1]).all()
    assert "driver" not in vector.step(proposal)[4]


def test_the_rules_of_takeover():
    always = vlaps.MetaDriveEnv(takeover=vlaps.Takeover("always", "idm"))
    always.reset(seed=3)
    info = always.step([1.0, -1.0])[4]
    assert info["driver"] == "expert" and (info["applied"] == info["expert"]).all()
    assert info["proposal"].tolist() == [1.0, -1.0]
    assert always.step([1.0, -1.0], takeover=False)[4]["driver"] == "policy"

    differs = vlaps.MetaDriveVectorEnv(2, takeover="differs", seeds=[3, 3])
    differs.reset()
    expert = differs.expert("mpc")
    far = np.clip(expert + [[0.0, 0.1], [0.0, -0.5]], -1.0, 1.0).astype(np.float32)
    info = differs.step(far)[4]
    assert info["takeover"].tolist() == [False, True]
    assert (info["expert"] == expert).all()

    vetoed = vlaps.MetaDriveEnv(takeover="vetoed", map="SSSS", traffic_density=0.0, accident_prob=0.0)
    vetoed.reset(seed=1)
    drivers = [vetoed.step([0.0, 1.0])[4]["driver"] for _ in range(40)]
    assert set(drivers) == {"policy"}
    assert vetoed.judge([1.0, 1.0])["veto"]
    info = vetoed.step([1.0, 1.0])[4]
    assert info["driver"] == "expert" and abs(info["applied"][0]) < 0.5


def test_a_step_that_begins_an_episode_has_no_driver():
    vector = vlaps.MetaDriveVectorEnv(3, takeover="always", autoreset_mode="NextStep", **SHORT)
    vector.reset()
    begun, ended = 0, np.zeros(3, np.bool_)
    for action in actions(3, 30):
        _, _, terminated, truncated, info = vector.step(action)
        begun += ended.sum()
        assert (info["_driver"] == ~ended).all() and not info["takeover"][ended].any()
        assert np.isnan(info["expert"][ended]).all()
        ended = terminated | truncated
    assert begun >= 3


def test_what_the_caller_writes_into_an_array_decides_nothing():
    vector = vlaps.MetaDriveVectorEnv(2, copy=False, takeover="always", **SHORT)
    vector.reset()
    _, _, terminated, _, _ = vector.step(np.zeros((2, 2), np.float32))
    terminated[:] = True
    info = vector.step(np.zeros((2, 2), np.float32))[4]
    assert set(info["driver"]) == {"expert"}


def test_a_takeover_of_another_type_is_refused():
    for wrong in (3, lambda: None):
        with pytest.raises(TypeError, match="takeover"):
            vlaps.MetaDriveVectorEnv(2, takeover=wrong)


def test_a_takeover_travels_with_send():
    vector = vlaps.MetaDriveVectorEnv(2, takeover="always", num_scenarios=2)
    twin = vlaps.MetaDriveVectorEnv(2, num_scenarios=2)
    vector.reset(), twin.reset()
    vector.send(np.zeros((2, 2)))
    observation, _, _, _, info = vector.recv()
    assert info["takeover"].all()
    assert (twin.step(info["applied"])[0] == observation).all()


def test_takeovers_that_are_asked_wrongly():
    with pytest.raises(ValueError, match="asked, always"):
        vlaps.MetaDriveEnv(takeover="sometimes")
    with pytest.raises(ValueError, match="idm, rrt-star"):
        vlaps.Takeover(method="lane")
    with pytest.raises(ValueError, match="differ"):
        vlaps.Takeover(differ=float("nan"))
    vector = vlaps.MetaDriveVectorEnv(3, num_scenarios=3)
    vector.reset()
    still = np.zeros((3, 2), np.float32)
    for wrong in (np.ones(2, bool), [1, 0, 1]):
        with pytest.raises(ValueError, match="takeover"):
            vector.step(still, takeover=wrong)
        with pytest.raises(ValueError, match="mask"):
            vector.expert("mpc", wrong)
    with pytest.raises(ValueError, match="shape"):
        vector.step(still[:2], takeover=True)
    still[1, 0] = np.nan
    for one in (True, False):
        with pytest.raises(ValueError, match="action 1.*finite"):
            vector.step(still, takeover=np.array([True, one, True]))
    with pytest.raises(RuntimeError, match="reset"):
        vlaps.MetaDriveVectorEnv(1).expert("mpc")

"""Many environments."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import vlaps
from drive import SHORT, actions

MODES = list(AutoresetMode)


def singles(count, **options):
    """Environments that each begin the episodes that a world of a vector begins."""
    chosen = range(options.get("start_seed", 0), options.get("num_scenarios", 1))
    seeds = [list(chosen)[k::count] for k in range(count)]
    return [vlaps.MetaDriveEnv(**{**options, "seeds": part}) for part in seeds]


@pytest.mark.parametrize("mode", MODES)
def test_a_vector_is_single_environments_stepped_by_hand(mode):
    """Observations, rewards, flags and figures of each mode, over several episodes."""
    count = 4
    vector = vlaps.MetaDriveVectorEnv(count, threads=2, autoreset_mode=mode, **SHORT)
    envs = singles(count, **SHORT)
    seen, info = vector.reset()
    for k, env in enumerate(envs):
        alone, alone_info = env.reset()
        assert (seen[k] == alone).all() and info["seed"][k] == alone_info["seed"]
    ended = np.zeros(count, bool)
    episodes = 0
    for action in actions(count, 60):
        if mode == AutoresetMode.DISABLED and ended.any():
            seen, _ = vector.reset(options={"reset_mask": ended})
            for k in np.flatnonzero(ended):
                assert (seen[k] == envs[k].reset()[0]).all()
        previous = ended
        seen, reward, terminated, truncated, info = vector.step(action)
        ended = terminated | truncated
        episodes += ended.sum()
        for k, env in enumerate(envs):
            if mode == AutoresetMode.NEXT_STEP and previous[k]:
                assert (seen[k] == env.reset()[0]).all()
                assert (reward[k], ended[k]) == (0.0, False)
                continue
            alone, alone_reward, *ends, alone_info = env.step(action[k])
            assert (reward[k], terminated[k], truncated[k]) == (alone_reward, *ends)
            for name, value in alone_info.items():
                assert info[name][k] == value, name
            if mode == AutoresetMode.SAME_STEP and ended[k]:
                assert info["_final_obs"][k] and info["final_info"]["_cost"][k]
                assert (info["final_obs"][k] == alone).all()
                alone, _ = env.reset()
            assert (seen[k] == alone).all()
        if mode == AutoresetMode.SAME_STEP and ended.any():
            assert (info["_final_obs"] == ended).all()
        else:
            assert "final_obs" not in info
    assert episodes >= 3 * count


@pytest.mark.parametrize("mode", MODES)
def test_the_number_of_threads_changes_no_bit(mode):
    def run(threads):
        env = vlaps.MetaDriveVectorEnv(
            7, threads=threads, autoreset_mode=mode, num_scenarios=50, horizon=40, shuffle=True
        )
        result = [env.reset()[0].tobytes()]
        for action in actions(7, 120):
            *arrays, info = env.step(action)
            result += [array.tobytes() for array in arrays]
            result += [info[name].tobytes() for name in ("cost", "seed", "route_completion")]
        return result

    one = run(1)
    assert run(2) == one
    assert run(5) == one


def test_make_vec_and_its_spaces():
    env = gymnasium.make_vec(vlaps.ENV_ID, num_envs=3, num_scenarios=9)
    assert env.observation_space.shape == (3, 259) and env.action_space.shape == (3, 2)
    observation, _ = env.reset(seed=4)
    assert env.observation_space.contains(observation)
    assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP


def test_wrappers_count_episodes():
    env = vlaps.MetaDriveVectorEnv(4, **SHORT)
    recorded = gymnasium.wrappers.vector.RecordEpisodeStatistics(env)
    recorded.reset()
    for action in actions(4, 40):
        recorded.step(action)
    assert len(recorded.return_queue) >= 8
    assert max(recorded.length_queue) == 12


def test_seeds_of_a_reset():
    env = vlaps.MetaDriveVectorEnv(3, num_scenarios=100)
    assert list(env.reset(seed=10)[1]["seed"]) == [10, 11, 12]
    assert list(env.reset(seed=[5, 1, 9])[1]["seed"]) == [5, 1, 9]
    mask = np.array([True, False, True])
    info = env.reset(seed=[50, 51, 52], options={"reset_mask": mask})[1]
    assert list(info["seed"]) == [50, 1, 52]


def episode_seeds(count, resets, **options):
    env = vlaps.MetaDriveVectorEnv(count, **{**SHORT, **options})
    return np.array([env.reset()[1]["seed"] for _ in range(resets)])


def test_seeds_of_a_range_a_list_and_a_stride():
    assert episode_seeds(2, 3, start_seed=8, num_scenarios=5).tolist() == [[8, 9], [10, 11], [12, 8]]
    assert episode_seeds(2, 2, seeds=[3, 1, 4]).tolist() == [[3, 1], [4, 3]]
    parts = [episode_seeds(2, 5, seeds=range(0, 40)[part::2]) for part in (0, 1)]
    assert set(parts[0].ravel()) == set(range(0, 20, 2))
    assert set(parts[1].ravel()) == set(range(1, 20, 2))


def test_shuffled_seeds_are_a_permutation_in_each_pass():
    drawn = episode_seeds(4, 10, start_seed=100, num_scenarios=20, shuffle=True).ravel()
    first, second = drawn[:20], drawn[20:]
    assert sorted(first) == sorted(second) == list(range(100, 120))
    assert list(first) != sorted(first) and list(first) != list(second)
    again = episode_seeds(4, 10, start_seed=100, num_scenarios=20, shuffle=True).ravel()
    other = episode_seeds(4, 10, start_seed=100, num_scenarios=20, shuffle=True, order_seed=1).ravel()
    assert (again == drawn).all() and (other != drawn).any()


def test_arrays_are_copies_unless_told_otherwise():
    kept = vlaps.MetaDriveVectorEnv(2, num_scenarios=4)
    first = kept.reset()[0]
    before = first.copy()
    info = kept.step(np.ones((2, 2), np.float32))[4]
    speed = info["velocity"].copy()
    kept.step(np.ones((2, 2), np.float32))
    assert (first == before).all() and (info["velocity"] == speed).all()
    shared = vlaps.MetaDriveVectorEnv(2, num_scenarios=4, copy=False)
    first = shared.reset()[0]
    assert shared.step(np.ones((2, 2), np.float32))[0] is first


def test_a_thousand_environments():
    env = vlaps.MetaDriveVectorEnv(1000, threads=2, num_scenarios=1000, shuffle=True)
    observation, info = env.reset()
    assert len(set(info["seed"].tolist())) == 1000
    for _ in range(5):
        observation, reward, *_ = env.step(np.tile(np.float32([0.0, 1.0]), (1000, 1)))
    assert np.isfinite(observation).all() and (reward > 0.0).mean() > 0.9


def test_a_step_that_is_sent_is_the_step():
    halves = vlaps.MetaDriveVectorEnv(4, threads=2, **SHORT)
    whole = vlaps.MetaDriveVectorEnv(4, threads=2, **SHORT)
    halves.reset(), whole.reset()
    for action in actions(4, 30):
        written = action.copy()
        halves.send(written)
        written[:] = 0.0
        with pytest.raises(RuntimeError, match="recv"):
            halves.step(action)
        for a, b in zip(halves.recv()[:4], whole.step(action)[:4]):
            assert (a == b).all()
    with pytest.raises(RuntimeError, match="send"):
        halves.recv()
    halves.send(np.full((4, 2), np.nan))
    with pytest.raises(ValueError, match="finite"):
        halves.recv()
    halves.send(action)
    halves.close()

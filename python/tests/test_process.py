"""Threads, forks and the time of an import."""

import multiprocessing
import os
import pkgutil
import subprocess
import sys
import threading

import numpy as np
import pytest

import vlaps
from drive import actions


def in_child(call):
    """The text that a call in a forked process returns."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(write, str(call()).encode())
        except BaseException as error:
            os.write(write, f"{type(error).__name__}: {error}".encode())
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    return text


def forks(test):
    """A test that forks."""
    test = pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")(test)
    return pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")(test)


@forks
def test_after_a_fork_threads_are_missed_and_one_thread_works():
    still = np.zeros((4, 2), np.float32)
    threaded = vlaps.MetaDriveVectorEnv(4, threads=2, num_scenarios=4)
    threaded.reset()
    text = in_child(lambda: threaded.step(still))
    assert text.startswith("RuntimeError") and "threads=1" in text
    alone = vlaps.MetaDriveVectorEnv(4, threads=1, num_scenarios=4)
    alone.reset()
    expected = str(alone.get_state(0).__bytes__())
    seen = alone.step(still)[0].sum()
    again = vlaps.MetaDriveVectorEnv(4, threads=1, num_scenarios=4)
    again.reset()
    assert in_child(lambda: again.get_state(0).__bytes__()) == expected
    assert in_child(lambda: again.step(still)[0].sum()) == str(seen)
    threaded.step(still)


@forks
def test_after_a_fork_a_step_can_be_sent_and_one_sent_before_is_refused():
    still = np.zeros((4, 2), np.float32)
    vector = vlaps.MetaDriveVectorEnv(4, threads=1, num_scenarios=4)
    vector.reset()
    vector.send(still)
    assert "before a fork" in in_child(vector.recv)
    vector.recv()

    def sent_again():
        vector.send(still)
        return vector.recv()[0].shape

    assert in_child(sent_again) == "(4, 259)"


def spawned(seed):
    env = vlaps.MetaDriveVectorEnv(3, threads=2, num_scenarios=9)
    env.reset(seed=seed)
    return env.step(np.ones((3, 2), np.float32))[0].tobytes()


def test_spawned_processes_compute_the_same():
    context = multiprocessing.get_context("spawn")
    with context.Pool(2) as pool:
        assert pool.map(spawned, [1, 2]) == [spawned(1), spawned(2)]


def test_environments_run_in_threads_at_once():
    def run(seed, out):
        env = vlaps.MetaDriveVectorEnv(4, threads=1, num_scenarios=99)
        env.reset(seed=seed)
        out[seed] = [env.step(action)[0].tobytes() for action in actions(4, 60)]

    results, expected = {}, {}
    threads = [threading.Thread(target=run, args=(seed, results)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed in range(4):
        run(seed, expected)
    assert results == expected


def test_one_environment_stepped_by_many_threads_raises_and_survives():
    env = vlaps.MetaDriveVectorEnv(64, threads=1, num_scenarios=64)
    env.reset()
    errors, steps = [], []

    def run():
        for _ in range(50):
            try:
                env.step(np.ones((64, 2), np.float32))
                steps.append(1)
            except RuntimeError as error:
                errors.append(str(error))

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(steps) + len(errors) == 200 and steps
    assert all("at once" in error for error in errors), set(errors)
    env.step(np.ones((64, 2), np.float32))


def test_the_package_imports_numpy_and_gymnasium_alone():
    code = (
        "import sys, vlaps; "
        "heavy = ('torch', 'stable_baselines3', 'minari', 'ray', 'onnxruntime', 'PIL', "
        "'matplotlib', 'multiprocessing.pool', 'tkinter', 'pandas', 'scipy'); "
        "print([m for m in heavy if m in sys.modules])"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert output.stdout.strip() == "[]"


def test_no_module_hides_a_name_of_the_package():
    """Importing the module `vlaps.x` sets the attribute `x`, and would replace a function."""
    modules = {module.name for module in pkgutil.iter_modules(vlaps.__path__)}
    assert len(modules) > 10 and not modules & set(vlaps.__all__)

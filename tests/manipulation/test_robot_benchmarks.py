"""What simulators tell of the benchmarks' environments, compared with the environments."""

import warnings
from typing import Any

import numpy as np
import pytest
from arms import fetch, meta_world

from cgtorch.manipulation.fetch import FetchSimulator
from cgtorch.manipulation.metaworld import MetaWorldSimulator
from cgtorch.manipulation.simulator import CLOSEST, SEEN

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (12, 4))


@pytest.fixture(scope="module")
def sawyer() -> MetaWorldSimulator:
    """One of which nothing was asked yet."""
    return MetaWorldSimulator("push-v3", 200)


@pytest.fixture(scope="module")
def played() -> Any:
    """Another environment of the benchmark."""
    import metaworld

    other: Any = metaworld.MT1("push-v3").train_classes["push-v3"]()
    other._set_task_called, other._partially_observable, other.seeded_rand_vec = True, False, True
    other._freeze_rand_vec = False
    return other


def test_every_fifth_step_and_the_last_are_looked_at(sawyer: MetaWorldSimulator) -> None:
    sawyer.states.write(sawyer.start(3)[SEEN + 21 :], 3)

    def looks(count: int) -> list[bool]:
        return [sawyer.move(np.zeros(4), False) is not None for _ in range(count)]

    assert looks(11) == 2 * [*[False] * 4, True] + [False]
    assert sawyer.move(np.zeros(4), True) is not None
    assert looks(5) == [*[False] * 4, True]


def test_steps_between_looks_are_those_of_the_environment(
    sawyer: MetaWorldSimulator, played: Any
) -> None:
    played.seed(4)
    first = played.reset()[0]
    row = sawyer.start(4)
    assert row[SEEN : SEEN + 21].tolist() == [*first[:18], *first[36:]]
    assert row[SEEN + 18 : SEEN + 21].any()  # the goal is seen
    sawyer.states.write(row[SEEN + 21 :], 4)
    for action in ACTIONS:
        found, other = sawyer.move(action, False), played.step(action)
        assert np.array_equal(sawyer.states.data.qpos, played.data.qpos)
        assert np.array_equal(sawyer.hand(), played.data.body("hand").xpos)
        if found is not None:
            assert np.array_equal(found[0][:18], other[0][:18])
            assert found[1:] == (other[1] / 10, bool(other[4]["success"]))
            assert sawyer.perceive(found[0])[18:].tolist() == row[SEEN + 18 : SEEN + 21].tolist()


def test_starts_follow_from_their_seeds(sawyer: MetaWorldSimulator) -> None:
    other = meta_world("push-v3").simulators[0]
    assert np.array_equal(sawyer.start(5)[: SEEN + 21], other.start(5)[: SEEN + 21])
    goals = {tuple(sawyer.start(seed)[SEEN + 18 : SEEN + 21]) for seed in range(4)}
    assert len(goals) == 4
    assert sawyer.start(5)[CLOSEST] == 0


def test_an_episode_may_be_longer_than_the_benchmark_s(sawyer: MetaWorldSimulator) -> None:
    sawyer.states.write(sawyer.start(6)[SEEN + 21 :], 6)
    sawyer.environment.curr_path_length = 10_000
    assert sawyer.move(np.zeros(4), True) is not None


def test_fetch_perceives_hand_object_goal_and_opening() -> None:
    simulator = fetch("FetchPickAndPlace-v4").simulators[0]
    row, data = simulator.start(3), simulator.states.data
    simulator.states.write(row[SEEN + 10 :], 3)
    seen = row[SEEN : SEEN + 10]
    assert np.allclose(seen[:3], simulator.hand())
    assert np.allclose(seen[:3], data.site("robot0:grip").xpos)
    assert np.allclose(seen[3:6], data.site("object0").xpos)
    assert np.allclose(seen[6:9], simulator.environment.goal)
    opened = simulator.run(row, 3, np.array([*seen[:3], -1.0, 12, 1.0, 0.0]))
    shut = simulator.run(opened, 3, np.array([*seen[:3], 1.0, 12, 1.0, 0.0]))
    for after, low, high in ((opened, 0.0, 0.2), (shut, -0.1, 0.02)):
        simulator.states.write(after[SEEN + 10 :], 3)
        joints = [data.joint(f"robot0:{side}_gripper_finger_joint").qpos[0] for side in "rl"]
        assert after[SEEN + 9] == pytest.approx(sum(joints), abs=1e-6)
        assert low < sum(joints) < high


def test_without_an_object_the_hand_is_in_its_place() -> None:
    simulator = fetch("FetchReach-v4").simulators[0]
    seen = simulator.start(3)[SEEN : SEEN + 10]
    assert seen[3:6].tolist() == seen[:3].tolist()
    assert seen[9] == 0
    assert seen[6:9].tolist() == simulator.environment.goal.tolist()


@pytest.mark.parametrize(("far", "close"), [(0.0, 1.0), (0.2, np.exp(-1)), (0.4, np.exp(-2))])
def test_each_fifth_of_a_metre_is_less_close_by_the_same_factor(far: float, close: float) -> None:
    there = np.array([1.0, 2.0, 3.0])
    told = {"achieved_goal": there, "desired_goal": there + np.array([0.0, far, 0.0])}
    assert fetch("FetchReach-v4").simulators[0].closeness(told) == pytest.approx(close)


def test_a_goal_is_shown_where_it_is() -> None:
    simulator = fetch("FetchReach-v4").simulators[0]
    simulator.states.write(simulator.start(8)[SEEN + 10 :], 8)
    shown = simulator.states.data.site("target0").xpos
    shown[:] = 0
    simulator.show()
    assert shown.tolist() == simulator.environment.goal.tolist()


def test_an_environment_is_made_without_warnings() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FetchSimulator("FetchReach-v4", 50)

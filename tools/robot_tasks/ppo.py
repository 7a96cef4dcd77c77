"""PPO of Stable-Baselines3 (Raffin et al., JMLR 2021) over primitives, with its default settings.

Only the number of decisions between two updates is another one, since an episode has few of them.
After each update, the mean action meets the criterion, start by start up to the first failure.
"""

from torch import Tensor

from cgtorch.manipulation.world import ArmWorld
from robot_tasks.environment import Primitives
from robot_tasks.problem import Found, Play, Problem

GIVEN = "the grade of each primitive as its reward, and 1 for success"
DECISIONS = 256  # between two updates


def search(problem: Problem, decisions: int = DECISIONS) -> Found:
    """Learn until the criterion is met or the budget is spent."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    class Ends(BaseCallback):  # type: ignore[misc]
        """Ends the learning."""

        met = False

        def _on_step(self) -> bool:
            return not (self.met or problem.over)

        def _on_rollout_start(self) -> None:
            if self.num_timesteps and not problem.over:
                self.met = problem.in_a_row(play) == problem.wanted

    environment = Primitives(problem.domain)
    how = {"n_steps": decisions, "seed": problem.seed, "device": "cpu"}
    learner = PPO("MlpPolicy", environment, **how)
    play, ends = player(learner, Primitives(problem.domain)), Ends()
    learner.learn(problem.budget, callback=ends)  # a decision takes at least one low-level step
    return problem.found(play, ends.met)


def player(learner: "object", environment: Primitives) -> Play:
    """What plays the mean action of a policy."""

    def play(world: ArmWorld) -> Tensor:
        observation, over = environment.begin(world), False
        while not over:
            action = learner.predict(observation, deterministic=True)[0]  # type: ignore[attr-defined]
            observation, _, over, _, _ = environment.step(action)
        return environment.lanes.state[0]

    return play

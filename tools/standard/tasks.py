"""The standard tasks by their names."""

from standard.cards import RepeatFirst, RepeatPrevious
from standard.classic import (
    Acrobot,
    AcrobotNoVelocities,
    CartPole,
    CartPoleNoVelocities,
    MountainCarContinuous,
    NarrowCartPole,
    Pendulum,
    PendulumNoVelocity,
)
from standard.double_pole import CHALLENGES, DoublePole, DoublePoleNoVelocities
from standard.lander import lunar_lander
from standard.task import Task, TaskWorld


def _of(name: str, title: str, world: type[TaskWorld], inputs: int, test: object = None) -> Task:
    """The task of a world; controls of more than one number are preferences here."""
    return Task(
        name=name,
        title=title,
        world=world,
        inputs=inputs,
        outputs=world.control_size,
        discrete=world.control_size > 1,
        solved=world.solved_return,
        most_steps=world.most_steps,
        test=test,
    )


TASKS: dict[str, Task] = {
    task.name: task
    for task in (
        _of("cartpole", "CartPole", CartPole, 4),
        _of("acrobot", "Acrobot", Acrobot, 6),
        _of("mountain_car_continuous", "MountainCarContinuous", MountainCarContinuous, 2),
        lunar_lander(),
        _of("pendulum", "Pendulum", Pendulum, 3),
        _of("cartpole_no_velocities", "CartPole without velocities", CartPoleNoVelocities, 2),
        _of(
            "narrow_cartpole_no_velocities",
            "Narrow CartPole without velocities",
            NarrowCartPole,
            2,
        ),
        _of("acrobot_no_velocities", "Acrobot without velocities", AcrobotNoVelocities, 4),
        _of("pendulum_no_velocity", "Pendulum without velocity", PendulumNoVelocity, 2),
        _of("double_pole", "Double pole", DoublePole, 6),
        _of(
            "double_pole_no_velocities",
            "Double pole without velocities",
            DoublePoleNoVelocities,
            3,
            CHALLENGES,
        ),
        _of("repeat_first", "RepeatFirst", RepeatFirst, 4),
        _of("repeat_previous", "RepeatPrevious", RepeatPrevious, 4),
    )
}
"""All of them, in the order of the table."""

"""Stands from which a robot can grasp what it cannot from the floor, as they lift its feet."""

from collections.abc import Callable

from cgtorch.tabletop.kinematics import Robot, graspable
from cgtorch.tabletop.robot_folder.reach import HEIGHT, OBJECTS, objects

STANDS = (0.3, 0.6, 0.9)  # m higher than it stands


def better_stand(on_stand: Callable[[float], Robot | None], stand: float) -> str:
    """What to do where a robot on a stand can grasp objects on usual tables; "" if none helps.

    `on_stand` is the robot on a stand of some height, m, or None if this moves it up only, as
    other heights of tables are tried without it. Its footprint is smaller if parts of it are lifted
    above what is seen as near the floor.
    """
    found = dict[float, int]()
    for height in (round(stand + higher, 2) for higher in STANDS):
        if (robot := on_stand(height)) is not None:
            found[height] = int(graspable(robot, *objects(robot, HEIGHT)).sum())
    best = max(found, key=lambda height: found[height], default=0.0)
    if not found.get(best):
        return ""
    return (
        f"on a stand of {best:g} m, on which less of it is near the floor, it can grasp "
        f"{found[best]} of {OBJECTS}, so put it there by --stand {best:g}"
    )

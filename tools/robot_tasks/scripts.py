"""Scripts of primitives that a person would write for a task; only their parameters are open."""

from collections.abc import Mapping

from cgtorch.ground.errors import SettingsError

SCRIPTS: Mapping[str, str] = {
    "hammer-v3": "Pick CarryOther Shift",
    "push-wall-v3": "Pick Place",
    "faucet-close-v3": "Push",
    "faucet-open-v3": "Push",
    "push-back-v3": "Pick Place",
    "stick-pull-v3": "Pick InsertOther CarryGoal",
    "stick-push-v3": "Pick InsertOther CarryGoal",
    "handle-press-side-v3": "Push",
    "handle-press-v3": "Push",
    "push-v3": "PushTo",
    "shelf-place-v3": "Pick Place",
    "window-close-v3": "Push",
    "window-open-v3": "Push",
    "peg-unplug-side-v3": "Pick Shift",
    "reach-v3": "ReachGoal",
    "pick-place-v3": "Pick Place",
    "pick-place-wall-v3": "Pick Place",
    "door-open-v3": "Push",
    "door-close-v3": "Drag",
    "drawer-open-v3": "Drag",
    "drawer-close-v3": "Drag",
    "button-press-topdown-v3": "Push",
    "button-press-v3": "Push",
    "peg-insert-side-v3": "Pick InsertGoal",
    "sweep-v3": "PushTo",
    "sweep-into-v3": "PushTo",
    "soccer-v3": "PushTo",
    "plate-slide-v3": "Drag",
    "bin-picking-v3": "Pick Place",
    "basketball-v3": "Pick Place Open",
    "FetchReach-v4": "ReachGoal Wait",
    "FetchPush-v4": "Steer",
    "FetchSlide-v4": "Strike Wait",
    "FetchPickAndPlace-v4": "Pick Place Wait",
}


def script_of(task: str) -> tuple[str, ...]:
    """The primitives of a task in their order; SettingsError if nobody has written any."""
    if task not in SCRIPTS:
        raise SettingsError(
            f"task {task!r} has no script for cma; write one in tools/robot_tasks/scripts.py, or "
            "leave cma out (--searches)"
        )
    return tuple(SCRIPTS[task].split())

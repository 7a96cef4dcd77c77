"""The structures of the C sources, for numbers of either type."""

import ctypes
from functools import cache
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor

POINTER = ctypes.c_void_p
WHOLE = ctypes.c_int64
REAL = {torch.float32: ctypes.c_float, torch.float64: ctypes.c_double}
WIDTH = {torch.float32: 16, torch.float64: 8}
"""Numbers in a vector of real.h."""
ACTION_KINDS = (
    "MOVE_BASE", "DETECT", "GRASP", "CONTINUOUS", "BRANCHING", "EDGE", "EDGE_BRANCHING",
)  # fmt: skip
"""The actions that C knows, in the order of its enumeration in lanes.h."""
MOST_FEATURES, MOST_OUTPUTS, MOST_PERCEPT, MOST_MESSAGE, MOST_HIDDEN, MOST_DEPTH = (
    64, 16, 64, 16, 64, 16,
)  # fmt: skip
MOST_FRAMES, MOST_CAPSULES = 64, 256
"""What the C sources have room for; what is larger runs in torch."""


@cache
def structures(dtype: torch.dtype) -> SimpleNamespace:
    """The structures by the names that they have in C."""
    real = REAL[dtype]

    def structure(name: str, **fields: Any) -> type[ctypes.Structure]:
        return type(name, (ctypes.Structure,), {"_fields_": list(fields.items())})

    machine = structure(
        "Machine",
        centres=POINTER, weights=POINTER, bias=POINTER, scale=real, m=WHOLE, d=WHOLE, k=WHOLE,
    )  # fmt: skip
    gamma = structure(
        "Gamma",
        machine=machine, mean=4 * real, scale=4 * real, sides=2 * real, most=4 * real, trust=real,
        reach=real, per_distance=real,
    )  # fmt: skip
    classifier = structure(
        "Classifier", machine=machine, mean=POINTER, scale=POINTER, slope=real, offset=real
    )
    body = structure("Body", bx=real, by=real, hx=real, hy=real, farthest=real)
    action = structure("Action", kind=WHOLE, inputs=WHOLE, hidden=WHOLE, outputs=WHOLE)
    program = structure(
        "Program",
        primitives=POINTER, kinds=POINTER, ends=POINTER, kind=POINTER, heads=POINTER, entry=POINTER,
        limit=POINTER, learned=POINTER, actions=WHOLE, most=WHOLE, count=WHOLE, outcomes=WHOLE,
        width=WHOLE, rows=WHOLE, depth=WHOLE, action=POINTER, edges=POINTER, start=POINTER,
        parameters=POINTER, nodes=WHOLE, seen=WHOLE, each=WHOLE,
    )  # fmt: skip
    models = structure(
        "Models",
        gamma=gamma, classifier=classifier, body=body, percepts=POINTER, state=POINTER,
        errors=POINTER, size=WHOLE, turns=WHOLE, most_novel=real,
    )  # fmt: skip
    task = structure(
        "Task",
        program=POINTER, models=POINTER, scenarios=POINTER, graphs=WHOLE, count=WHOLE,
        max_transitions=WHOLE, max_steps=WHOLE, percept=POINTER, state=POINTER, status=POINTER,
        transitions=POINTER, again=POINTER, wrong=WHOLE,
    )  # fmt: skip
    evaluation = structure(
        "Evaluation",
        task=task, keep=WHOLE, fitness=POINTER, score=POINTER, succeeded=POINTER,
        transitions=WHOLE, not_finite=WHOLE, chunks=POINTER, count=WHOLE,
    )  # fmt: skip
    collision = structure(
        "Collision",
        start=POINTER, end=POINTER, radius=POINTER, centre=POINTER, rotation=POINTER, half=POINTER,
        postures=WHOLE, capsules=WHOLE, boxes=WHOLE, same=WHOLE, bisections=WHOLE,
        rounding=ctypes.c_double, hit=POINTER,
    )  # fmt: skip
    chain = structure(
        "Chain",
        offset=POINTER, axis=POINTER, kind=POINTER, joint=POINTER, frames=WHOLE, joints=WHOLE,
    )  # fmt: skip
    arms = structure(
        "Arms",
        chain=chain, table=collision, body=collision, q=POINTER, start=POINTER, end=POINTER,
        frame=POINTER, loose=POINTER, hit=POINTER,
    )  # fmt: skip
    return SimpleNamespace(
        Arms=arms,
        Chain=chain,
        Collision=collision,
        Evaluation=evaluation,
        Machine=machine,
        Gamma=gamma,
        Classifier=classifier,
        Body=body,
        Action=action,
        Program=program,
        Models=models,
        Task=task,
    )


def suits(*tensors: Tensor) -> bool:
    """Whether compiled code may be asked about tensors: on the CPU, of one type, no gradient."""
    if torch.is_grad_enabled() and any(t.requires_grad for t in tensors):
        return False
    dtype = tensors[0].dtype
    return dtype in REAL and all(t.dtype == dtype and t.device.type == "cpu" for t in tensors)

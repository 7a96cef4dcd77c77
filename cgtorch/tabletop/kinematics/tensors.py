"""Dataclasses of tensors that go to a device together."""

from typing import Self

from torch import Tensor


class Tensors:
    """A base for dataclasses some of whose fields are tensors."""

    def to(self, like: Tensor) -> Self:
        """The same on the device of a tensor and, where it is of floating point, in its dtype."""
        moved = {
            name: x.to(like) if x.is_floating_point() else x.to(like.device)
            for name, x in vars(self).items()
            if isinstance(x, Tensor)
        }
        return type(self)(**{**vars(self), **moved})

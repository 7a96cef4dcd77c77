"""The files of a domain in a run's folder, besides its settings."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

D = TypeVar("D")
"""The domain of files."""


class Files(Generic[D]):
    """Files of a domain, which names a subclass as `Domain.files` if it needs any.

    Attributes:
        domain: The domain.
        names: The names of files and folders that `write` makes.
    """

    names: ClassVar[tuple[str, ...]] = ()

    def __init__(self, domain: D) -> None:
        """The files of a domain."""
        self.domain = domain

    def write(self, folder: Path) -> None:
        """Store in a run's folder what the domain needs besides its settings, or replace it."""

    @classmethod
    def read(cls, kind: type[D], settings: Any, folder: Path) -> D:
        """The domain of a class, from its settings and what `write` stored, or a CgtorchError."""
        made: Any = kind
        return made(settings)

    def made_with(self) -> Mapping[str, str]:
        """Versions of everything on which the domain's numbers depend, by name."""
        return {}

    def options(self, folder: Path) -> Mapping[str, str]:
        """Settings by name that make the domain again from what `write` stored in a folder."""
        return {}

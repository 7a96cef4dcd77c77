"""The contents of reports on a domain: words, published results, drawings and films."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from torch import Tensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cgtorch.domains.film import Film
    from cgtorch.graphs import Skill

D = TypeVar("D")
"""The domain of pictures."""


@dataclass(frozen=True)
class Published:
    """A published result of a stage, or of all scenarios: how many of those tried succeeded.

    It has a remark on the result, and details as headings and texts.
    """

    succeeded: int
    tried: int
    remark: str = ""
    details: tuple[tuple[str, str], ...] = ()

    @property
    def text(self) -> str:
        """Solved of tried, in short."""
        return f"{self.succeeded}/{self.tried}"


class Pictures(Generic[D]):
    """Pictures and words of a domain, which names a subclass as `Domain.pictures` to have any.

    Attributes:
        domain: The domain.
        published: Published results by stage, or under "" for all scenarios together.
        publisher: The authors of these results.
        solved: The word for a solved scenario, and for several of them.
    """

    published: ClassVar[Mapping[str, Published]] = {}
    publisher: ClassVar[str] = "published"
    solved: ClassVar[tuple[str, str]] = ("solved", "Scenarios solved")

    def __init__(self, domain: D) -> None:
        """The pictures of a domain."""
        self.domain = domain

    def about(self) -> list[tuple[str, str]]:
        """Names and values for a report, such as the robot."""
        return []

    def remarks(self) -> list[str]:
        """Sentences that a training says about the domain when it begins."""
        return []

    def advice(self) -> str:
        """What to change before a training goes on that has not reached its goal; "" if nothing."""
        return ""

    def scenarios(
        self, scenarios: Any, succeeded: Tensor, targets: Tensor, title: str = ""
    ) -> "Figure | None":
        """A picture of which of B scenarios succeeded (B,) bool; None if there is none.

        `targets` (B,) bool marks the test scenarios of a stage. A report shows the figure's label
        (`Figure.set_label`) below it.
        """
        return None

    def stage(self, name: str) -> str:
        """A small SVG drawing of a stage; "" if there is none."""
        return ""

    def film(self, skill: "Skill", scenarios: Any, width: int) -> "Film | None":
        """Pictures of about that width (px) of a skill on the first scenario; None without any.

        Where it moves nothing on that one, the next one on which it does may be shown.

        CgtorchError if they cannot be drawn on this machine.
        """
        return None

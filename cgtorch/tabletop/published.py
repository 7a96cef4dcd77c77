"""Pictures of the tabletop, and what Riano & McGinnity report: section VI, figures 3 to 10."""

import tomllib
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from cgtorch.domains.pictures import Pictures, Published
from cgtorch.tabletop.physics.film import film_of
from cgtorch.tabletop.table_picture import draw_placements
from cgtorch.tabletop.world import Scenarios, stage_scenarios

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cgtorch.domains.film import Film
    from cgtorch.graphs import Skill


_FILES = files("cgtorch.tabletop")
EXPERIMENTS = {
    stage: Published(**{**figures, "details": tuple(figures.get("details", {}).items())})
    for stage, figures in tomllib.loads(
        _FILES.joinpath("published.toml").read_text("utf-8")
    ).items()
}
"""By stage, and for all together under ""."""

ROOM = 14.0  # cm around the paper's drawings


def stage_drawing(edge: str, footprint: tuple[float, float, float, float]) -> str:
    """The paper's schematic drawing of an experiment as SVG, seen by the robot, in cm.

    The robot is drawn by its footprint x min, x max, y min, y max (m), with the test scenarios.
    """
    from jinja2 import Environment

    tests = stage_scenarios(edge)
    depth, width = tests.table[0, 3:5].tolist()
    x, y, _ = tests.pose[0].tolist()
    objects = (-100 * tests.object.flip(1)).tolist()
    low, high = torch.tensor(objects).aminmax(dim=0)
    x_min, x_max, y_min, y_max = footprint
    robot = _rectangle(x + x_max, y + y_max, x_max - x_min, y_max - y_min)
    table = _rectangle(depth / 2, width / 2, depth, width)
    left, top = table[0] - ROOM, table[1] - ROOM
    view = (left, top, table[2] + 2 * ROOM, robot[1] + robot[3] + ROOM - top)
    environment = Environment(autoescape=True)
    environment.filters["cm"] = "{:.1f}".format
    template = environment.from_string(_FILES.joinpath("schematic.svg.jinja").read_text("utf-8"))
    return template.render(
        view=view, table=table, robot=robot, objects=objects,
        centre=((low + high) / 2).tolist(), radius=((high - low) / 2).tolist(),
    )  # fmt: skip


def _rectangle(x: float, y: float, depth: float, width: float) -> tuple[float, ...]:
    """A rectangle by its far left corner, as left, top, width and height, in cm."""
    return tuple(100 * v for v in (-y, -x, width, depth))


class TabletopPictures(Pictures[Any]):
    """Scenes from above, and what the paper published."""

    published = EXPERIMENTS
    publisher = "the paper"
    solved = ("reached", "Objects reached")

    def about(self) -> list[tuple[str, str]]:
        """See `Pictures.about`."""
        s = self.domain.settings
        world = f"{s.world}, a touch {s.touch}" if s.world == "mujoco" else s.world
        return [("Robot", self.domain.robot.description.name), ("World", world)]

    def scenarios(
        self, scenarios: Scenarios, succeeded: Tensor, targets: Tensor, title: str = ""
    ) -> "Figure":
        """See `Pictures.scenarios`: the scenes from above."""
        footprint = self.domain.robot.description.footprint
        return draw_placements(scenarios, succeeded, targets, footprint=footprint, title=title)

    def film(self, skill: "Skill", scenarios: Scenarios, width: int) -> "Film | None":
        """See `Pictures.film`: what MuJoCo's renderer sees of it in physics."""
        if self.domain.settings.world != "mujoco":
            return None
        return film_of(skill, self.domain.physics, self.domain.world_in, scenarios, width)

    def stage(self, name: str) -> str:
        """See `Pictures.stage`: the paper's drawing of an experiment."""
        return stage_drawing(self.domain.stages[name], self.domain.robot.description.footprint)

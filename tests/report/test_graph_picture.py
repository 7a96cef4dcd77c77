from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
import torch
from support import (
    custom_actions,
    nested_actions,
    random_graphs,
    random_skill,
    stochastic_actions,
)
from torch import Tensor

from cgtorch.graphs import (
    ActionSet,
    BranchingNN,
    ContinuousNN,
    DelayNN,
    Graphs,
    Perceive,
    Skill,
    Step,
    SubSkill,
    Test,
    to_networkx,
)
from cgtorch.graphs.clusters import clusters_of
from cgtorch.improvement.compose import branching_action, compose
from cgtorch.report import draw_skill
from cgtorch.report.graph_picture import (
    BACK,
    COLOURS,
    END_BAD,
    END_GOOD,
    LINE,
    OTHERS,
    START,
    gid_of,
)
from cgtorch.tabletop.actions import paper_actions

PAPER = paper_actions()


def skills_of(skill: Skill) -> list[tuple[Skill, str]]:
    """All skills in a skill, with the names on the way to them."""
    return [(cluster.skill, cluster.path) for cluster in clusters_of(skill)]


def skill_of(n: int, seed: int, actions: ActionSet = PAPER) -> Skill:
    """A random skill of n nodes."""
    while True:
        many = random_graphs(seed, 400, actions, capacity=24, nodes=(n, n + 6))
        fitting = (many.num_nodes == n).nonzero()[:, 0]
        if len(fitting):
            return Skill(f"S{n}", many[fitting[:1]], actions)
        seed += 1000


def graph(kinds: list[str], edges: list[list[int]], start: int = 0) -> Graphs:
    action = torch.tensor([[PAPER.index(k) for k in kinds]])
    padded = [row + [-1] * (PAPER.outcome_capacity - len(row)) for row in edges]
    parameters = torch.zeros(1, len(kinds), PAPER.parameter_capacity)
    return Graphs(action, torch.tensor([padded]), parameters, torch.tensor([start]))


def composed() -> Skill:
    """Five members under four branches, one of them made of two."""
    branch = branching_action(PAPER)[1]
    small = [Skill(f"S0.{i}", skill_of(i + 2, i).graph, PAPER) for i in range(2)]
    inner = compose("S1", small, torch.zeros(1, branch.num_parameters), PAPER, 20)
    members = [Skill(f"S2.{i}", skill_of(i + 3, 7 * i).graph, PAPER) for i in range(4)]
    return compose("S2", [*members, inner], torch.zeros(4, branch.num_parameters), PAPER, 20)


MANY = [
    *(skill_of(n, seed) for n in range(1, 16) for seed in (n, n + 50)),
    *(skill_of(n, n, custom_actions()) for n in (6, 10, 14)),
    *(skill_of(n, n, stochastic_actions()) for n in (7, 13)),
    Skill("loops", graph(["BranchingNN"], [[0, 0]]), PAPER),
    Skill("parallel", graph(["BranchingNN", "MoveBase"], [[1, 1], [0, 0]]), PAPER),
    Skill("chain", graph(["Detect"] * 14 + ["Grasp"], [[i + 1] for i in range(14)] + [[-1, 0]]),
          PAPER),
    Skill("star", graph(["Grasp", *["MoveBase"] * 6], [[-1, 1], *([(i + 1) % 7, 0]
          for i in range(1, 7))]), PAPER),
    random_skill(5, "nested", nested_actions()),
    composed(),
]  # fmt: skip


class Picture:
    """What a figure shows, measured by the renderer that draws it, in pixels."""

    def __init__(self, skill: Skill):
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.figure = draw_skill(skill)
        canvas = FigureCanvasAgg(self.figure)
        canvas.draw()
        self.size = canvas.get_width_height()
        axes = self.figure.axes[0]
        self.named: dict[str, list[Any]] = {}
        for artist in (*axes.patches, *axes.texts):
            if artist.get_gid():
                self.named.setdefault(artist.get_gid(), []).append(artist)
        self.renderer = canvas.get_renderer()

    def of(self, *kinds: str) -> dict[str, Any]:
        """The artists of some kinds, which must be unique, by their gid."""
        found = {g: a for g, a in self.named.items() if g.startswith(tuple(f"{k}:" for k in kinds))}
        assert all(len(a) == 1 for a in found.values()), "a gid is used twice"
        return {g: a[0] for g, a in found.items()}

    def box(self, artist: Any) -> Any:
        patch = artist.get_bbox_patch() if hasattr(artist, "get_bbox_patch") else None
        return (patch or artist).get_window_extent(self.renderer)

    def line(self, arrow: Any) -> Any:
        """Points (n, 2) close together on the line of an edge."""
        path = arrow.axes.transData.transform_path(arrow._path_original)
        corners = path.cleaned(curves=False, simplify=False).vertices[:-1]
        assert np.abs(corners[-1] - corners[-2]).max() > 0.5, "too short a piece for the arrow"
        steps = np.linspace(0, 1, 20)[:, None]
        return np.concatenate([a + steps * (b - a) for a, b in pairwise(corners)])


@pytest.fixture(scope="module", params=MANY, ids=lambda s: f"{s.name}-{s.num_nodes}")
def drawn(request: pytest.FixtureRequest) -> tuple[Skill, Picture]:
    return request.param, Picture(request.param)


def overlap(first: Any, second: Any, slack: float = 0.0) -> bool:
    return bool(
        first.x0 + slack < second.x1
        and second.x0 + slack < first.x1
        and first.y0 + slack < second.y1
        and second.y0 + slack < first.y1
    )


def test_every_node_edge_and_end_is_there_by_name(drawn: tuple[Skill, Picture]) -> None:
    skill, picture = drawn
    nodes, edges, ends = set(), set(), set()
    for inner, path in skills_of(skill):
        view = to_networkx(inner.graph, inner.actions)
        label = {n: d["label"] for n, d in view.nodes(data=True)}
        nodes |= {f"node:{path}:{name}" for name in label.values()}
        for tail, head, data in view.edges(data=True):
            edges.add(f"edge:{path}:{label[tail]}:{data['outcome']}:{label[head]}")
        for node, data in view.nodes(data=True):
            action = inner.actions.actions[inner.actions.index(data["action"])]
            ends |= {f"end:{path}:{label[node]}:{o}" for o in action.terminal}
    assert set(picture.of("node")) == nodes
    assert set(picture.of("edge")) == edges
    assert set(picture.of("end")) == ends
    text = picture.of("text")
    assert {gid.removeprefix("text:") for gid in text} == nodes | edges | ends
    for gid, artist in text.items():
        part = gid.split(":")
        assert artist.get_text() == (part[3] if part[1] == "node" else part[4])
    assert set(picture.of("panel")) == {f"panel:{path}" for _, path in skills_of(skill)}


def test_nothing_lies_on_anything_else(drawn: tuple[Skill, Picture]) -> None:
    _, picture = drawn
    boxes = {g: picture.box(a) for g, a in picture.of("node").items()}
    boxes |= {g: picture.box(a) for g, a in picture.of("text").items() if "text:node" not in g}
    for (name, first), (other, second) in combinations(boxes.items(), 2):
        assert not overlap(first, second), f"{name} lies on {other}"
    width, height = picture.size
    for name, box in boxes.items():
        assert box.x0 >= 0, name
        assert box.y0 >= 0, name
        assert box.x1 <= width, name
        assert box.y1 <= height, name
    panels = [picture.box(a) for a in picture.of("panel").values()]
    for pair in combinations(panels, 2):
        assert not overlap(*pair)


def test_nodes_hold_their_names_and_panels_their_nodes(drawn: tuple[Skill, Picture]) -> None:
    _, picture = drawn
    texts, panels = picture.of("text"), picture.of("panel")
    for gid, artist in picture.of("node").items():
        box, text = picture.box(artist), picture.box(texts[f"text:{gid}"])
        panel = picture.box(panels[f"panel:{gid.split(':')[1]}"])
        for outer, inner in ((box, text), (panel, box)):
            assert outer.x0 < inner.x0 < inner.x1 < outer.x1
            assert outer.y0 < inner.y0 < inner.y1 < outer.y1
    titles = [text for text in picture.figure.axes[0].texts if not text.get_gid()]
    for title, (path, frame) in zip(titles, panels.items(), strict=True):
        path, box, text = path.removeprefix("panel:"), picture.box(frame), picture.box(title)
        count = sum(gid.startswith(f"node:{path}:") for gid in picture.of("node"))
        assert title.get_text() == f"{path} · {count} node{'s' if count != 1 else ''}"
        assert box.x0 < text.x0 < text.x1 < box.x1
        assert box.y0 < text.y0 < text.y1 < box.y1


def test_edges_go_from_rim_to_rim_around_all_nodes(drawn: tuple[Skill, Picture]) -> None:
    _, picture = drawn
    boxes = {g: picture.box(a) for g, a in picture.of("node").items()}
    for gid, arrow in picture.of("edge").items():
        _, path, tail, _, head = gid.split(":")
        line = picture.line(arrow)
        for at, node in ((line[0], tail), (line[-1], head)):
            box = boxes[f"node:{path}:{node}"]
            assert box.x0 - 2 <= at[0] <= box.x1 + 2, gid
            assert box.y0 - 2 <= at[1] <= box.y1 + 2, gid
        for name, box in boxes.items():
            inside = (line > [box.x0 + 2, box.y0 + 2]) & (line < [box.x1 - 2, box.y1 - 2])
            assert not inside.all(1).any(), f"{gid} crosses {name}"


def test_no_edge_lies_on_another_nor_on_a_foreign_label(drawn: tuple[Skill, Picture]) -> None:
    _, picture = drawn
    lines = {g: picture.line(a) for g, a in picture.of("edge").items()}
    labels = {g: picture.box(a) for g, a in picture.of("text").items() if "text:node" not in g}
    for (name, first), (other, second) in combinations(lines.items(), 2):
        if name.split(":")[1] == other.split(":")[1]:
            apart = np.abs(first[::9, None] - second[None, ::3]).max(-1).min(1)
            assert (apart > 4).mean() > 0.3, f"{name} lies on {other}"
    for name, line in lines.items():
        for label, box in labels.items():
            inside = (line > [box.x0, box.y0 + 1]) & (line < [box.x1, box.y1 - 1])
            assert not inside.all(1).any(), f"{name} crosses {label}"


def test_start_is_red_and_square_and_the_rest_is_not(drawn: tuple[Skill, Picture]) -> None:
    from matplotlib.colors import to_hex
    from matplotlib.patches import BoxStyle

    skill, picture = drawn
    red, square = set(), set()
    for gid, artist in picture.of("node").items():
        if to_hex(artist.get_facecolor()) == START:
            red.add(gid)
        if isinstance(artist.get_boxstyle(), BoxStyle.Square):
            square.add(gid)
    wanted = set()
    for inner, path in skills_of(skill):
        view = to_networkx(inner.graph, inner.actions)
        wanted.add(f"node:{path}:{view.nodes[view.graph['start']]['label']}")
    assert red == square == wanted


def test_nodes_are_coloured_by_action(drawn: tuple[Skill, Picture]) -> None:
    from matplotlib.colors import to_hex

    skill, picture = drawn
    fills: dict[str, set[str]] = {}
    for gid, artist in picture.of("node").items():
        kind = gid.split(":")[2].rpartition("_")[0]
        fills.setdefault(kind, set()).add(to_hex(artist.get_facecolor()))
    fills = {kind: found - {START} for kind, found in fills.items()}
    wanted = {"MoveBase": Step, "Detect": Perceive, "Grasp": Test, "BranchingNN": BranchingNN}
    for name, kind in (wanted | {"ContinuousNN": ContinuousNN, "DelayNN": DelayNN}).items():
        assert fills.get(name, set()) <= {COLOURS[kind]}  # which names nothing of the tabletop
    subs = {name for s, _ in skills_of(skill) for name in s.sub_skills}
    assert all(fills[name] <= {"#ffffff"} for name in subs)
    others = {*fills} - {*wanted, "ContinuousNN", "DelayNN", *subs}
    assert {fill for name in others for fill in fills[name]} <= {*COLOURS.values(), *OTHERS}


def test_a_skill_in_a_node_has_a_second_rim(drawn: tuple[Skill, Picture]) -> None:
    skill, picture = drawn
    subs = {name for s, _ in skills_of(skill) for name in s.sub_skills}
    rims = [p for p in picture.figure.axes[0].patches if not p.get_gid()]
    holding = [
        (picture.box(a), gid) for gid, a in picture.of("node").items()
        if gid.split(":")[2].rpartition("_")[0] in subs
    ]  # fmt: skip
    for rim in map(picture.box, rims):
        assert any(
            outer.x0 < rim.x0 < rim.x1 < outer.x1 and outer.y0 < rim.y0 < rim.y1 < outer.y1
            for outer, _ in holding
        )
    assert len(rims) == len(holding)


def test_colours_say_how_a_skill_ends_and_what_leads_back(drawn: tuple[Skill, Picture]) -> None:
    from matplotlib.colors import to_hex

    skill, picture = drawn
    texts = picture.of("text")
    for cluster in clusters_of(skill):
        for edge in cluster.edges:
            gid = gid_of(cluster, edge)
            arrow, text = picture.named[gid][0], texts[f"text:{gid}"]
            colour, said = to_hex(arrow.get_edgecolor()), to_hex(text.get_color())
            if edge.head in cluster.ends:
                assert colour == (END_GOOD if cluster.ends[edge.head] else END_BAD)
                assert to_hex(text.get_bbox_patch().get_facecolor()) == colour
                assert said == "#ffffff"
                continue
            line = picture.line(arrow)
            back = edge.head == edge.tail or line[-1, 1] > line[0, 1]
            assert colour == said == (BACK if back else LINE)
            assert text.get_bbox_patch() is None


def test_what_is_read_lies_on_what_is_drawn(drawn: tuple[Skill, Picture]) -> None:
    _, picture = drawn
    kinds = [picture.of(kind).values() for kind in ("panel", "edge", "node", "text")]
    orders = [{artist.get_zorder() for artist in kind} for kind in kinds]
    assert all(not a or not b or max(a) < min(b) for a, b in pairwise(orders))


def test_names_of_skills_in_nodes_are_no_formulas() -> None:
    name = r"$\frac{a}{b}$"
    inner = Skill(name, graph(["Grasp"], [[-1, 0]]), PAPER)
    actions = PAPER.extended([name], [SubSkill(inner)])
    node: Tensor = torch.tensor([[actions.index(name)]])
    empty = torch.zeros(1, 1, actions.parameter_capacity)
    skill = Skill("S", Graphs(node, torch.tensor([[[-1, 0]]]), empty, torch.tensor([0])), actions)
    picture = Picture(skill)
    box = picture.box(picture.named[f"node:S:{name}_0"][0])
    text = picture.box(picture.named[f"text:node:S:{name}_0"][0])
    assert 0.7 * (box.x1 - box.x0) < text.x1 - text.x0 < box.x1 - box.x0


def test_pictures_are_the_same_under_any_settings_of_matplotlib() -> None:
    from matplotlib import rc_context
    from matplotlib.colors import to_hex

    skill = skill_of(3, 0)
    with rc_context({"figure.facecolor": "black", "figure.dpi": 50}):
        figure = draw_skill(skill)
    assert to_hex(figure.get_facecolor()) == "#ffffff"
    assert figure.get_dpi() == 100


def test_a_skill_used_twice_has_one_panel() -> None:
    inner = skill_of(3, 0)
    actions = PAPER.extended(["A", "B"], [SubSkill(inner), SubSkill(inner)])
    a, b = actions.index("A"), actions.index("B")
    edges = torch.tensor([[[-1, 1], [-1, 0]]])
    both: Tensor = torch.tensor([[a, b]])
    empty = torch.zeros(1, 2, actions.parameter_capacity)
    skill = Skill("S", Graphs(both, edges, empty, torch.tensor([0])), actions)
    assert len(Picture(skill).of("panel")) == 2


def test_drawing_leaves_pyplot_alone() -> None:
    import matplotlib.pyplot as plt

    before = plt.get_fignums()  # of programs in pages that other tests run
    draw_skill(skill_of(4, 0))
    assert plt.get_fignums() == before

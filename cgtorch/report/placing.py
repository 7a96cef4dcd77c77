"""Where everything of a graph picture goes, in inches, once its rows are known."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from cgtorch.report.layers import Link, Rows, in_rows

LABEL_ROW, GAP, BETWEEN, PORTS = 0.2, 0.2, 0.2, 0.16
LOOP_ROOM, LOOP_HEIGHT, NODE_HEIGHT = 0.34, 0.24, 0.34
LINE_LEFT, LINE_RIGHT = 0.07, 0.06
PASSES = 40

Point = tuple[float, float]


@dataclass(frozen=True)
class Box:
    """A node: centre and size."""

    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class Route:
    """How a link is drawn.

    Attributes:
        points: corners of the line; pieces that are not vertical are drawn as S-curves.
        label: where its label begins, at half height; for an end the centre of its mark.
        upward: whether it leads back up.
        loop: whether it leads back to its own node.
    """

    points: tuple[Point, ...]
    label: Point
    upward: bool = False
    loop: bool = False


@dataclass(frozen=True)
class Placement:
    """A laid out graph, from (0, 0) at the top left to (width, height), y downwards."""

    boxes: dict[Hashable, Box]
    routes: list[Route]
    width: float
    height: float


def place(
    widths: Mapping[Hashable, float],
    start: Hashable,
    links: Sequence[Link],
    label_widths: Sequence[float],
) -> Placement:
    """Lay out a graph whose nodes can all be reached from `start`.

    Args:
        widths: of the nodes' boxes, by node.
        start: the start node.
        links: its edges, loops and ends.
        label_widths: of the text of each link.
    """
    rows = in_rows(list(widths), start, links)
    loops = {node: [i for i, e in enumerate(links) if e.tail == e.head == node] for node in widths}
    extent = _extents(rows, widths, links, label_widths, loops)
    x = _columns(rows, extent)
    left = min(x[i] - extent[i][0] for row in rows.rows for i in row)
    right = max(x[i] + extent[i][1] for row in rows.rows for i in row)
    x = {item: value - left for item, value in x.items()}
    tall = {n: max(NODE_HEIGHT, LOOP_HEIGHT * len(i)) for n, i in loops.items()}
    node_of = {item: node for node, item in rows.node.items()}
    tops, bottoms = _row_bands(rows, x, {i: tall[n] for i, n in node_of.items()})
    row_of = {item: r for r, row in enumerate(rows.rows) for item in row}
    middle = {item: (tops[r] + bottoms[r]) / 2 for item, r in row_of.items()}
    boxes = {n: Box(x[i], middle[i], widths[n], tall[n]) for n, i in rows.node.items()}

    ports = _ports(rows, x, {rows.node[n]: w for n, w in widths.items()})
    routes: list[Route] = []
    for k, link in enumerate(links):
        if link.head == link.tail:
            routes.append(_loop(boxes[link.tail], loops[link.tail].index(k), len(loops[link.tail])))
            continue
        chain, points = rows.chains[k], []
        for j, item in enumerate(chain):
            if item in node_of:
                half, below = tall[node_of[item]] / 2, j == 0
                at = ports[k, below]
                rim = middle[item] + (half if below else -half)
                band = bottoms[row_of[item]] if below else tops[row_of[item]]
                points += [(at, rim), (at, band)] if below else [(at, band), (at, rim)]
            elif link.head is None:
                points.append((x[item], tops[row_of[item]]))
            else:
                points += [(x[item], tops[row_of[item]]), (x[item], bottoms[row_of[item]])]
        item = rows.labels[k]
        at = x[item] if link.head is None else x[item] + LINE_RIGHT
        upward = rows.upward[k]
        routes.append(Route(tuple(points[::-1] if upward else points), (at, middle[item]), upward))
    return Placement(boxes, routes, right - left, bottoms[-1])


def _extents(
    rows: Rows,
    widths: Mapping[Hashable, float],
    links: Sequence[Link],
    label_widths: Sequence[float],
    loops: Mapping[Hashable, list[int]],
) -> dict[int, tuple[float, float]]:
    """How far each item reaches to the left and right of its line or centre."""
    extent = dict.fromkeys(rows.above, (LINE_LEFT, LINE_LEFT))
    for node, item in rows.node.items():
        aside = [LOOP_ROOM + label_widths[i] for i in loops[node]]
        extent[item] = (widths[node] / 2, widths[node] / 2 + max(aside, default=0.0))
    for k, item in rows.labels.items():
        if links[k].head is None:
            extent[item] = (label_widths[k] / 2 + 0.05, label_widths[k] / 2 + 0.05)
        else:
            extent[item] = (LINE_LEFT, LINE_RIGHT + label_widths[k])
    return extent


def _columns(rows: Rows, extent: Mapping[int, tuple[float, float]]) -> dict[int, float]:
    """The x of each item: near its neighbours, and clear of those beside it."""
    x: dict[int, float] = {}
    for row in rows.rows:
        _spread(row, dict.fromkeys(row, 0.0), dict.fromkeys(row, 1.0), extent, x)
    nodes = set(rows.node.values())
    for n in range(PASSES):
        order = rows.rows if n % 2 == 0 else rows.rows[::-1]
        sides = [rows.above if n % 2 == 0 else rows.below]
        if n >= PASSES // 2:
            sides = [rows.above, rows.below]
        for row in order:
            wanted, weight = {}, {}
            for item in row:
                near = [(i, _pull(item, i, nodes)) for side in sides for i in side[item]]
                total = sum(w for _, w in near)
                wanted[item] = sum(w * x[i] for i, w in near) / total if near else x[item]
                weight[item] = total if near else 0.1
            _spread(row, wanted, weight, extent, x)
    _straighten(rows, extent, x)
    return x


def _straighten(rows: Rows, extent: Mapping[int, tuple[float, float]], x: dict[int, float]) -> None:
    """Make long lines vertical for as many rows as what stands beside them allows."""
    beside: dict[int, tuple[int | None, int | None]] = {}
    for row in rows.rows:
        for left, item, right in zip([None, *row], row, [*row[1:], None], strict=False):
            beside[item] = (left, right)

    def room(item: int) -> tuple[float, float]:
        (left, right), (own_left, own_right) = beside[item], extent[item]
        gap = BETWEEN / 2
        low = -1e9 if left is None else x[left] + extent[left][1] + own_left + gap
        high = 1e9 if right is None else x[right] - extent[right][0] - own_right - gap
        return low, high

    nodes = set(rows.node.values())
    lines = [[i for i in chain if i not in nodes] for chain in rows.chains.values()]
    for _ in range(4):
        for line in lines:
            run: list[int] = []
            low, high = -1e9, 1e9
            for item in line:
                a, b = room(item)
                if run and max(low, a) > min(high, b):
                    _align(run, low, high, x)
                    run, low, high = [], -1e9, 1e9
                run, low, high = [*run, item], max(low, a), min(high, b)
            _align(run, low, high, x)


def _align(run: list[int], low: float, high: float, x: dict[int, float]) -> None:
    """Put all of `run` at the place between `low` and `high` that is nearest to their mean."""
    if run:
        middle = sum(x[i] for i in run) / len(run)
        x.update(dict.fromkeys(run, min(max(middle, low), high)))


def _pull(item: int, other: int, nodes: set[int]) -> float:
    """How strongly two items want to stand above each other: lines want to be straight."""
    return (1.0, 2.0, 8.0)[(item not in nodes) + (other not in nodes)]


def _spread(
    row: list[int],
    wanted: Mapping[int, float],
    weight: Mapping[int, float],
    extent: Mapping[int, tuple[float, float]],
    x: dict[int, float],
) -> None:
    """Write to `x` the places nearest to `wanted` at which the row's items keep clear."""
    shift, shifts = 0.0, []
    for i, item in enumerate(row):
        if i:
            shift += extent[row[i - 1]][1] + extent[item][0] + BETWEEN / 2
        shifts.append(shift)
    values = monotone(
        [wanted[i] - s for i, s in zip(row, shifts, strict=True)], [weight[i] for i in row]
    )
    x.update({item: v + s for item, v, s in zip(row, values, shifts, strict=True)})


def monotone(values: Sequence[float], weights: Sequence[float]) -> list[float]:
    """The ascending numbers nearest to `values`: least squares, by pooling adjacent violators."""
    blocks: list[tuple[float, float, int]] = []
    for value, weight in zip(values, weights, strict=True):
        count = 1
        while blocks and blocks[-1][0] > value:
            before, heavy, n = blocks.pop()
            value = (before * heavy + value * weight) / (heavy + weight)
            weight, count = heavy + weight, count + n
        blocks.append((value, weight, count))
    return [value for value, _, count in blocks for _ in range(count)]


def _row_bands(
    rows: Rows, x: Mapping[int, float], tall: Mapping[int, float]
) -> tuple[list[float], list[float]]:
    """Top and bottom of each row; gaps grow where lines have far to go sideways."""
    tops, bottoms, y = [], [], 0.0
    for r, row in enumerate(rows.rows):
        height = max((tall[i] for i in row if i in tall), default=LABEL_ROW)
        tops.append(y)
        bottoms.append(y + height)
        far = max((abs(x[i] - x[j]) for i in row for j in rows.below[i]), default=0.0)
        y += height + GAP * (0.8 + min(far / 2.5, 1.6)) * (1 if r % 2 == 0 else 1.3)
    return tops, bottoms


def _ports(
    rows: Rows, x: Mapping[int, float], width: Mapping[int, float]
) -> dict[tuple[int, bool], float]:
    """Where each link meets its upper (True) and lower (False) node, apart from the others."""
    meets: dict[tuple[int, bool], list[tuple[float, int]]] = {}
    for k, chain in rows.chains.items():
        meets.setdefault((chain[0], True), []).append((x[chain[1]], k))
        if chain[-1] in width:
            meets.setdefault((chain[-1], False), []).append((x[chain[-2]], k))
    ports = {}
    for (item, below), lines in meets.items():
        lines.sort()
        reach = 0.42 * width[item]
        apart = min(PORTS, 2 * reach / max(len(lines) - 1, 1))
        wanted = [v - i * apart for i, (v, _) in enumerate(lines)]
        room = 2 * reach - apart * (len(lines) - 1)
        low = x[item] - reach
        values = [min(max(v, low), low + room) for v in monotone(wanted, [1.0] * len(wanted))]
        for i, (v, (_, k)) in enumerate(zip(values, lines, strict=True)):
            ports[k, below] = v + i * apart
    return ports


def _loop(box: Box, index: int, count: int) -> Route:
    """One of `count` loops, one below another at the right of a node."""
    y = box.y + (index - (count - 1) / 2) * LOOP_HEIGHT
    right, out, half = box.x + box.width / 2, box.x + box.width / 2 + 0.26, 0.07
    points = ((right, y - half), (out, y - half), (out, y + half), (right, y + half))
    return Route(points, (out + 0.0, y), loop=True)


def pieces(points: Sequence[Point]) -> list[tuple[Point, Point, bool]]:
    """A route's pieces, and whether each is a curve; straight ones in a row are one."""
    found: list[tuple[Point, Point, bool]] = []
    for a, b in pairwise(points):
        curved = abs(a[0] - b[0]) > 1e-3
        if found and not curved and not found[-1][2]:
            found[-1] = (found[-1][0], b, False)
        elif max(abs(a[0] - b[0]), abs(a[1] - b[1])) > 1e-6:
            found.append((a, b, curved))
    return found

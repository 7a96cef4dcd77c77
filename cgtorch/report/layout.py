"""The layout of a graph picture: the row of every node, the order in rows, and all positions.

This is layered graph drawing: reverse the edges that close a cycle, put every node below all that
lead to it, cut edges into pieces from row to row, and order the rows for few crossings. Every edge
has a piece of its own in the row after its tail, for its label. So parallel edges never overlap,
and no label covers a node.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import networkx as nx
import numpy as np

from cgtorch.graphs.clusters import Edge

SWEEPS = 12
LABEL_ROW, GAP, BETWEEN, PORTS = 0.2, 0.2, 0.1, 0.16
LOOP_ROOM, LOOP_HEIGHT, NODE_HEIGHT = 0.34, 0.24, 0.34
LINE_LEFT, LINE_RIGHT = 0.07, 0.06

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
    """The line of an edge.

    Attributes:
        points: The corners of the line; pieces that are not vertical are drawn as S-curves.
        label: Where its label begins, at half height; for an end, the centre of its mark.
        upward: Whether it leads back up.
        loop: Whether it leads back to its own node.
    """

    points: tuple[Point, ...]
    label: Point
    upward: bool = False
    loop: bool = False


@dataclass(frozen=True)
class Placement:
    """The layout of a graph, from (0, 0) at the top left to (width, height), y downwards."""

    boxes: dict[str, Box]
    routes: list[Route]
    width: float
    height: float


@dataclass(frozen=True)
class Rows:
    """Items in rows from top to bottom: nodes in even rows, labels and ends in odd ones.

    Attributes:
        rows: The items of each row, from left to right.
        node: The item of each node.
        chains: The items of each edge that is not a loop, from the top; an end is its own item.
        upward: Which of these edges lead upwards.
        above: The items to which each item is connected in the row above.
        below: The same in the row below.
    """

    rows: list[list[int]]
    node: dict[str, int]
    chains: dict[int, list[int]]
    upward: set[int]
    above: dict[int, list[int]]
    below: dict[int, list[int]]

    def label(self, edge: int) -> int:
        """The item with an edge's label."""
        return self.chains[edge][-2 if edge in self.upward else 1]


def place(
    widths: Mapping[str, float], start: str, edges: Sequence[Edge], label_widths: Sequence[float]
) -> Placement:
    """Lay out a graph whose nodes can all be reached from `start`; widths are in inches."""
    rows = in_rows(list(widths), start, edges)
    loops = {node: [i for i, e in enumerate(edges) if e.tail == e.head == node] for node in widths}
    extent = dict.fromkeys(rows.above, (LINE_LEFT, LINE_LEFT))
    for node, item in rows.node.items():
        aside = max((LOOP_ROOM + label_widths[i] for i in loops[node]), default=0.0)
        extent[item] = (widths[node] / 2, widths[node] / 2 + aside)
    for k in rows.chains:
        if edges[k].head in widths:
            extent[rows.label(k)] = (LINE_LEFT, LINE_RIGHT + label_widths[k])
        else:
            extent[rows.label(k)] = (label_widths[k] / 2 + 0.05, label_widths[k] / 2 + 0.05)
    x = _columns(rows, extent)
    tall = {i: max(NODE_HEIGHT, LOOP_HEIGHT * len(loops[n])) for n, i in rows.node.items()}
    band = _bands(rows, x, tall)
    middle = {item: sum(band[item]) / 2 for item in band}
    boxes = {n: Box(x[i], middle[i], widths[n], tall[i]) for n, i in rows.node.items()}
    ports = _ports(rows, x, {i: widths[n] for n, i in rows.node.items()})
    routes = []
    for k, edge in enumerate(edges):
        if edge.head == edge.tail:
            routes.append(_loop(boxes[edge.tail], loops[edge.tail].index(k), len(loops[edge.tail])))
            continue
        first, *between, last = rows.chains[k]
        ys = (middle[first] + tall[first] / 2, band[first][1])
        points = [(ports[k, first], y) for y in ys]
        points += [(x[item], y) for item in between for y in band[item]]
        label = (x[rows.label(k)] + LINE_RIGHT, middle[rows.label(k)])
        if last in tall:
            ys = (band[last][0], middle[last] - tall[last] / 2)
            points += [(ports[k, last], y) for y in ys]
        else:
            points.append((x[last], band[last][0]))
            label = (x[last], middle[last])
        upward = k in rows.upward
        routes.append(Route(tuple(points[::-1] if upward else points), label, upward))
    right = max(x[i] + extent[i][1] for i in x)
    return Placement(boxes, routes, right, max(bottom for _, bottom in band.values()))


def _columns(rows: Rows, extent: Mapping[int, tuple[float, float]]) -> dict[int, float]:
    """The x of each item, clear of its neighbours, with the least sideways extent of edges.

    It is the linear program of Gansner et al. (1993, A technique for drawing directed graphs, 4.2).
    """
    from scipy.optimize import linprog
    from scipy.sparse import block_array, coo_array, eye_array

    count, nodes = len(extent), set(rows.node.values())

    def differences(pairs: list[tuple[int, int]]) -> coo_array:
        """(len(pairs), count), the x of the first of a pair minus that of the second."""
        signs, row = np.tile([1.0, -1.0], len(pairs)), np.repeat(np.arange(len(pairs)), 2)
        columns = np.array(pairs, dtype=int).reshape(-1)
        return coo_array((signs, (row, columns)), shape=(len(pairs), count))

    pieces = [(a, b) for a, below in rows.below.items() for b in below]
    beside = [pair for row in rows.rows for pair in pairwise(row)]
    apart = [extent[a][1] + extent[b][0] + BETWEEN for a, b in beside]
    # Lines want to be straight, those that pass many rows most of all.
    pull = [(1.0, 2.0, 8.0)[(a not in nodes) + (b not in nodes)] for a, b in pieces]
    sideways, unit = differences(pieces), eye_array(len(pieces))
    limits = (
        block_array([[sideways, -unit], [-sideways, -unit], [differences(beside), None]]),
        np.concatenate([np.zeros(2 * len(pieces)), -np.array(apart)]),
    )
    far = [(0, None)] * len(pieces)
    # In the middle between the leftmost and the rightmost of all best places.
    low = [(extent[item][0], None) for item in range(count)]
    left = linprog([1e-4] * count + pull, *limits, bounds=low + far).x[:count]
    both = [(extent[item][0], left.max() + 1e-6) for item in range(count)]
    right = linprog([-1e-4] * count + pull, *limits, bounds=both + far).x[:count]
    return dict(enumerate(((left + right) / 2).tolist()))


def _bands(
    rows: Rows, x: Mapping[int, float], tall: Mapping[int, float]
) -> dict[int, tuple[float, float]]:
    """Top and bottom of each item's row; gaps are larger where lines run far sideways."""
    bands, y = dict[int, tuple[float, float]](), 0.0
    for r, row in enumerate(rows.rows):
        height = max((tall[i] for i in row if i in tall), default=LABEL_ROW)
        bands |= dict.fromkeys(row, (y, y + height))
        far = max((abs(x[i] - x[j]) for i in row for j in rows.below[i]), default=0.0)
        y += height + GAP * (0.8 + min(far / 2.5, 1.6)) * (1 if r % 2 == 0 else 1.3)
    return bands


def _ports(
    rows: Rows, x: Mapping[int, float], width: Mapping[int, float]
) -> dict[tuple[int, int], float]:
    """Where each edge meets its upper and its lower node, apart from other edges."""
    from scipy.optimize import isotonic_regression

    meets: dict[tuple[int, bool], list[tuple[float, int]]] = {}
    for k, chain in rows.chains.items():
        meets.setdefault((chain[0], True), []).append((x[chain[1]], k))
        if chain[-1] in width:
            meets.setdefault((chain[-1], False), []).append((x[chain[-2]], k))
    ports = dict[tuple[int, int], float]()
    for (item, _), lines in meets.items():
        lines.sort()
        reach = 0.42 * width[item]
        apart = min(PORTS, 2 * reach / max(len(lines) - 1, 1))
        wanted = [at - i * apart for i, (at, _) in enumerate(lines)]
        low, high = x[item] - reach, x[item] + reach - apart * (len(lines) - 1)
        found = isotonic_regression(wanted).x.clip(low, high).tolist()
        ports |= {(k, item): found[i] + i * apart for i, (_, k) in enumerate(lines)}
    return ports


def _loop(box: Box, index: int, count: int) -> Route:
    """One of `count` loops, one below another, at the right of a node."""
    y = box.y + (index - (count - 1) / 2) * LOOP_HEIGHT
    right, out, half = box.x + box.width / 2, box.x + box.width / 2 + 0.26, 0.07
    points = ((right, y - half), (out, y - half), (out, y + half), (right, y + half))
    return Route(points, (out, y), loop=True)


def pieces(points: Sequence[Point]) -> list[tuple[Point, Point, bool]]:
    """A route's pieces, and whether each is a curve; adjacent straight ones are merged."""
    found: list[tuple[Point, Point, bool]] = []
    for a, b in pairwise(points):
        curved = abs(a[0] - b[0]) > 1e-3
        if found and not curved and not found[-1][2]:
            found[-1] = (found[-1][0], b, False)
        elif max(abs(a[0] - b[0]), abs(a[1] - b[1])) > 1e-6:
            found.append((a, b, curved))
    return found


def in_rows(nodes: Sequence[str], start: str, edges: Sequence[Edge]) -> Rows:
    """Rows of a graph whose nodes can all be reached from `start`, without loops.

    Edges that lead to no node are ends.
    """
    graph = nx.DiGraph((e.tail, e.head) for e in edges if e.head in nodes)
    graph.add_node(start)
    deep = list(nx.dfs_postorder_nodes(graph, start))[::-1]
    broad = [start, *(head for _, head in nx.bfs_edges(graph, start))]
    found = [_ordered(_cut(edges, order)) for order in (deep, broad)]
    return min(found, key=lambda rows: 10 * crossings(rows) + len(rows.below))


def _cut(edges: Sequence[Edge], order: list[str]) -> Rows:
    """Rows by longest path, with every edge cut into pieces from row to row."""
    place = {node: i for i, node in enumerate(order)}
    downwards: nx.DiGraph[str] = nx.DiGraph()
    downwards.add_nodes_from(order)
    for edge in edges:
        if edge.head in place and edge.head != edge.tail:
            downwards.add_edge(*sorted((edge.tail, edge.head), key=place.__getitem__))
    layers = enumerate(nx.topological_generations(downwards))
    rank = {node: 2 * number for number, layer in layers for node in layer}
    ending = {edge.tail for edge in edges if edge.head not in place}
    rows: list[list[int]] = [[] for _ in range(1 + max(rank[n] + (n in ending) for n in order))]
    result = Rows(rows, {}, {}, set(), {}, {})

    def new(row: int) -> int:
        item = len(result.above)
        result.above[item], result.below[item] = [], []
        rows[row].append(item)
        return item

    for node in order:
        result.node[node] = new(rank[node])
    for i, edge in sorted(enumerate(edges), key=lambda e: place[e[1].tail]):
        if edge.head == edge.tail:
            continue
        if edge.head not in place:
            chain = [result.node[edge.tail], new(rank[edge.tail] + 1)]
        else:
            upper, lower = sorted((edge.tail, edge.head), key=place.__getitem__)
            between = [new(row) for row in range(rank[upper] + 1, rank[lower])]
            chain = [result.node[upper], *between, result.node[lower]]
            if upper == edge.head:
                result.upward.add(i)
        result.chains[i] = chain
        for a, b in pairwise(chain):
            result.below[a].append(b)
            result.above[b].append(a)
    return result


def _ordered(rows: Rows) -> Rows:
    """The order with the fewest crossings that sweeps up and down find."""
    best, fewest = [row[:] for row in rows.rows], crossings(rows)
    for sweep in range(SWEEPS):
        down = sweep % 2 == 0
        numbers = range(1, len(rows.rows)) if down else range(len(rows.rows) - 2, -1, -1)
        for r in numbers:
            _sort_by_mean(rows, r, r - 1 if down else r + 1, rows.above if down else rows.below)
        _swap(rows)
        if (count := crossings(rows)) < fewest:
            best, fewest = [row[:] for row in rows.rows], count
    rows.rows[:] = best
    return rows


def _places(rows: Rows, r: int) -> dict[int, int]:
    """The place of each item in row `r`; empty if there is no such row."""
    return {item: i for i, item in enumerate(rows.rows[r])} if 0 <= r < len(rows.rows) else {}


def _sort_by_mean(rows: Rows, r: int, other: int, beside: Mapping[int, list[int]]) -> None:
    """Sort row `r` by the mean place of each item's neighbours in row `other`."""
    there, here = _places(rows, other), _places(rows, r)

    def mean(item: int) -> float:
        if not (around := beside[item]):
            return here[item] / max(len(here) - 1, 1)
        return sum(there[n] for n in around) / len(around) / max(len(there) - 1, 1)

    rows.rows[r].sort(key=mean)


def _swap(rows: Rows) -> None:
    """Swap neighbours as long as that removes crossings."""
    for r, row in enumerate(rows.rows):
        sides = (rows.above, _places(rows, r - 1)), (rows.below, _places(rows, r + 1))
        swapped = True
        while swapped:
            swapped = False
            for i in range(len(row) - 1):
                a, b = row[i], row[i + 1]
                saved = sum(_pair(*side, a, b) - _pair(*side, b, a) for side in sides)
                if saved > 0:
                    row[i], row[i + 1], swapped = b, a, True


def _pair(beside: Mapping[int, list[int]], place: Mapping[int, int], a: int, b: int) -> int:
    """Crossings between the pieces of `a` and those of `b`, `a` to the left."""
    return sum(place[m] > place[n] for m in beside[a] for n in beside[b])


def crossings(rows: Rows) -> int:
    """The number of crossing pairs of pieces."""
    count = 0
    for upper, lower in pairwise(rows.rows):
        place = {item: i for i, item in enumerate(lower)}
        pieces = [n for item in upper for n in sorted(place[i] for i in rows.below[item])]
        count += sum(a > b for i, a in enumerate(pieces) for b in pieces[i + 1 :])
    return count

"""Which row every node stands in, and the order within the rows.

The classic way of drawing a directed graph in layers: turn round the edges that close a cycle, put
every node below all that lead to it, cut edges into pieces from row to row, and order the rows so
that few pieces cross. Every edge has a piece of its own in the row after its tail, where its label
goes, so parallel edges never lie on each other and no label on a node.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import networkx as nx

SWEEPS = 12


@dataclass(frozen=True)
class Link:
    """An edge to be drawn; `head` None where the outcome ends the skill."""

    tail: Hashable
    head: Hashable | None
    outcome: str


@dataclass
class Rows:
    """Items in rows from top to bottom: nodes in even rows, labels and ends in odd ones.

    Attributes:
        rows: the items of each row, from left to right.
        node: the item of each node.
        chains: for each link that is no loop, its items from the upper end to the lower; an end
            is an item of its own.
        upward: for each of these links, whether it leads upwards.
        labels: the item with each link's label.
        above: the items that each item is connected to in the row above.
        below: the same in the row below.
    """

    rows: list[list[int]]
    node: dict[Hashable, int]
    chains: dict[int, list[int]]
    upward: dict[int, bool]
    labels: dict[int, int]
    above: dict[int, list[int]]
    below: dict[int, list[int]]


def in_rows(nodes: Sequence[Hashable], start: Hashable, links: Sequence[Link]) -> Rows:
    """Rows for a graph whose nodes can all be reached from `start`; loops are left out."""
    found = [_ordered(_cut(nodes, links, order)) for order in _node_orders(nodes, start, links)]
    return min(found, key=lambda rows: 10 * crossings(rows) + len(rows.below))


def _node_orders(
    nodes: Sequence[Hashable], start: Hashable, links: Sequence[Link]
) -> list[list[Hashable]]:
    """Orders of the nodes, each of which says what edges lead upwards: depth and breadth first."""
    graph: nx.DiGraph[Hashable] = nx.DiGraph()
    graph.add_nodes_from(nodes)
    graph.add_edges_from((e.tail, e.head) for e in links if e.head is not None)
    deep = list(nx.dfs_postorder_nodes(graph, start))[::-1]
    broad = [start, *(head for _, head in nx.bfs_edges(graph, start))]
    return [deep, broad]


def _cut(nodes: Sequence[Hashable], links: Sequence[Link], order: list[Hashable]) -> Rows:
    """Rows by longest path, every link cut into pieces from row to row."""
    place = {node: i for i, node in enumerate(order)}
    rank = dict.fromkeys(order, 0)
    ending = {edge.tail for edge in links if edge.head is None}
    followers: dict[Hashable, list[Hashable]] = {node: [] for node in nodes}
    for edge in links:
        if edge.head is not None and edge.head != edge.tail:
            first, second = sorted((edge.tail, edge.head), key=place.__getitem__)
            followers[first].append(second)
    for node in order:
        for follower in followers[node]:
            rank[follower] = max(rank[follower], rank[node] + 2)
    height = 1 + max(rank[node] + (node in ending) for node in order)
    rows: list[list[int]] = [[] for _ in range(height)]
    result = Rows(rows, {}, {}, {}, {}, {}, {})

    def new(row: int) -> int:
        item = len(result.above)
        result.above[item], result.below[item] = [], []
        rows[row].append(item)
        return item

    for node in order:
        result.node[node] = new(rank[node])
    for i, edge in sorted(enumerate(links), key=lambda e: place[e[1].tail]):
        if edge.head == edge.tail:
            continue
        if edge.head is None:
            chain = [result.node[edge.tail], new(rank[edge.tail] + 1)]
            up = False
        else:
            up = place[edge.head] < place[edge.tail]
            upper, lower = (edge.head, edge.tail) if up else (edge.tail, edge.head)
            between = [new(row) for row in range(rank[upper] + 1, rank[lower])]
            chain = [result.node[upper], *between, result.node[lower]]
        result.chains[i], result.upward[i] = chain, up
        result.labels[i] = chain[-2] if up else chain[1]
        for a, b in pairwise(chain):
            result.below[a].append(b)
            result.above[b].append(a)
    return result


def _ordered(rows: Rows) -> Rows:
    """The rows in the order, among those that sweeps up and down find, with fewest crossings."""
    best, fewest = [row[:] for row in rows.rows], crossings(rows)
    for sweep in range(SWEEPS):
        down = sweep % 2 == 0
        numbers = range(1, len(rows.rows)) if down else range(len(rows.rows) - 2, -1, -1)
        beside = rows.above if down else rows.below
        for r in numbers:
            _sort_by_mean(rows.rows, r, r - 1 if down else r + 1, beside)
        _swap(rows)
        if (count := crossings(rows)) < fewest:
            best, fewest = [row[:] for row in rows.rows], count
    rows.rows[:] = best
    return rows


def _sort_by_mean(rows: list[list[int]], r: int, other: int, beside: dict[int, list[int]]) -> None:
    """Sort row `r` by the mean place of each item's neighbours in row `other`."""
    place = {item: i / max(len(rows[other]) - 1, 1) for i, item in enumerate(rows[other])}
    here = {item: i / max(len(rows[r]) - 1, 1) for i, item in enumerate(rows[r])}

    def mean(item: int) -> float:
        around = beside[item]
        return sum(place[n] for n in around) / len(around) if around else here[item]

    rows[r].sort(key=mean)


def _swap(rows: Rows) -> None:
    """Swap neighbours as long as that saves crossings."""
    for r, row in enumerate(rows.rows):
        above = {n: i for i, n in enumerate(rows.rows[r - 1])} if r else {}
        below = {n: i for i, n in enumerate(rows.rows[r + 1])} if r + 1 < len(rows.rows) else {}
        swapped = True
        while swapped:
            swapped = False
            for i in range(len(row) - 1):
                a, b = row[i], row[i + 1]
                now = _pair(rows.above, above, a, b) + _pair(rows.below, below, a, b)
                then = _pair(rows.above, above, b, a) + _pair(rows.below, below, b, a)
                if then < now:
                    row[i], row[i + 1], swapped = b, a, True


def _pair(beside: dict[int, list[int]], place: dict[int, int], a: int, b: int) -> int:
    """Crossings between the pieces of `a` and those of `b`, `a` to the left."""
    return sum(place[m] > place[n] for m in beside[a] for n in beside[b])


def crossings(rows: Rows) -> int:
    """How many pairs of pieces cross."""
    count = 0
    for upper, lower in pairwise(rows.rows):
        place = {item: i for i, item in enumerate(lower)}
        pieces = [n for item in upper for n in sorted(place[i] for i in rows.below[item])]
        count += sum(a > b for i, a in enumerate(pieces) for b in pieces[i + 1 :])
    return count

"""The row of every node, and the order of nodes within rows.

This is layered graph drawing: reverse the edges that close a cycle, put every node below all that
lead to it, cut edges into pieces from row to row, and order the rows for few crossings. Every edge
has a piece of its own in the row after its tail, for its label. So parallel edges never overlap,
and no label covers a node.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import networkx as nx

from cgtorch.graphs.clusters import Edge

SWEEPS = 12


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

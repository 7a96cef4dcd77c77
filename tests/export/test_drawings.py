"""DOT, GraphML and Mermaid say the same graph, read back by programs that are not ours."""

import io
import re
from dataclasses import replace

import networkx as nx
import pydot
import pytest
from driving import reference
from hypothesis import given, settings
from hypothesis import strategies as st
from support import (
    custom_actions,
    nested_actions,
    random_graphs,
    random_skill,
    stochastic_actions,
)

from cgtorch.export import to_dot, to_graphml, to_mermaid
from cgtorch.graphs import ActionSet, Skill, SubSkill
from cgtorch.graphs.clusters import clusters_of

Triple = tuple[str, str, str]

SKILLS = [
    reference()[1],
    random_skill(0, "S2", nested_actions(0)),
    random_skill(5, "flat", custom_actions()),
    random_skill(6, "random", stochastic_actions()),
]


def said(skill: Skill) -> tuple[dict[str, str], set[Triple], set[Triple], dict[str, set[str]]]:
    """Labels of nodes and ends, edges, calls (tail, first node, cluster), and cluster members."""
    clusters = {c.key: c for c in clusters_of(skill)}
    labels, edges, calls, members = {}, set(), set(), {}
    for c in clusters.values():
        labels |= {n.key: n.label for n in c.nodes.values()}
        labels |= {end: "success" if good else "failure" for end, good in c.ends.items()}
        edges |= {(e.tail, e.head, e.outcome) for e in c.edges}
        calls |= {(n.key, clusters[n.runs].start, n.runs) for n in c.nodes.values() if n.runs}
        members[c.key] = {*c.ends, *c.nodes}
    return labels, edges, calls, members


def plain(text: str) -> str:
    """A DOT string's text."""
    return re.sub(r"\\(.)", r"\1", text[1:-1])


@pytest.mark.parametrize("skill", SKILLS, ids=lambda skill: skill.name)
def test_dot_as_pydot_reads_it(skill: Skill) -> None:
    (graph,) = pydot.graph_from_dot_data(to_dot(skill).decode())
    labels, edges, calls, members = said(skill)
    found_labels, found_edges, starts = {}, set(), set()
    for part in graph.get_subgraphs():
        names = {n.get_name() for n in part.get_nodes()}
        assert names == members[part.get_name().removeprefix("cluster_")]
        for node in part.get_nodes():
            found_labels[node.get_name()] = plain(node.get("label"))
            if node.get("fillcolor"):
                starts.add(node.get_name())
        found_edges |= {
            (e.get_source(), e.get_destination(), plain(e.get("label"))) for e in part.get_edges()
        }
    assert (found_labels, found_edges) == (labels, edges)
    assert starts == {c.start for c in clusters_of(skill)}
    assert calls == {
        (e.get_source(), e.get_destination(), e.get("lhead").removeprefix("cluster_"))
        for e in graph.get_edges()
    }


@pytest.mark.parametrize("skill", SKILLS, ids=lambda skill: skill.name)
def test_graphml_as_networkx_reads_it(skill: Skill) -> None:
    graph = nx.read_graphml(io.BytesIO(to_graphml(skill)), force_multigraph=True)
    labels, edges, calls, members = said(skill)
    groups = {c.key: c.name for c in clusters_of(skill)}
    assert nx.get_node_attributes(graph, "label") == labels | groups
    data = list(graph.edges(data=True))
    assert edges == {(a, b, d["outcome"]) for a, b, d in data if not d.get("runs")}
    assert {(a, b) for a, b, d in data if d.get("runs")} == {(a, c) for a, _, c in calls}
    starts = {n for n, start in graph.nodes(data="start") if start}
    assert starts == {c.start for c in clusters_of(skill)}
    for cluster in clusters_of(skill):
        for node in cluster.nodes.values():
            values = graph.nodes[node.key].get("parameters") or ""
            assert tuple(map(float, values.split())) == node.parameters
        assert all(graph.nodes[end]["success"] == good for end, good in cluster.ends.items())
    assert set(graph) == set(groups) | set().union(*members.values())


@pytest.mark.parametrize("skill", SKILLS, ids=lambda skill: skill.name)
def test_mermaid_line_by_line(skill: Skill) -> None:
    first, *lines = to_mermaid(skill).decode().splitlines()
    assert first == "flowchart TD"
    labels, edges, calls, members = said(skill)
    found_labels, found_edges, found_calls, starts = {}, set(), set(), set()
    found_members: dict[str, set[str]] = {}
    inside = ""
    for line in map(str.strip, lines):
        if match := re.fullmatch(r'subgraph (\w+)\["(.*)"\]', line):
            inside = match[1]
            found_members[inside] = set()
        elif line == "end":
            inside = ""
        elif match := re.fullmatch(r'(\w+)(?:\[\[|\[|\(\[)"(.*?)"(?:\]\]|\]\)|\])(:::\w+)?', line):
            found_labels[match[1]] = match[2]
            found_members[inside].add(match[1])
            if match[3] == ":::start":
                starts.add(match[1])
        elif match := re.fullmatch(r'(\w+) -->\|"(.*)"\| (\w+)', line):
            found_edges.add((match[1], match[3], match[2]))
        elif match := re.fullmatch(r"(\w+) -\.-> (\w+)", line):
            found_calls.add((match[1], match[2]))
        else:
            assert line.startswith("classDef ")
    assert (found_labels, found_edges, found_members) == (labels, edges, members)
    assert found_calls == {(a, c) for a, _, c in calls}
    assert starts == {c.start for c in clusters_of(skill)}


names = st.text(min_size=1, max_size=20)


@settings(max_examples=4)
@given(names, names, names)
def test_whatever_the_names_the_drawings_can_be_read(one: str, two: str, three: str) -> None:
    base = custom_actions()
    if {two, three} & set(base.names) or two == three:
        return
    base = ActionSet((*base.names[:-1], two), base.actions)
    inner = Skill(three, random_graphs(0, 1, base), base)
    skill = random_skill(1, one, base.extended([three], [SubSkill(inner)]))
    skill = replace(skill, name=one)
    labels, edges, *_ = said(skill)
    (graph,) = pydot.graph_from_dot_data(to_dot(skill).decode())
    parts = graph.get_subgraphs()
    assert {n.get_name() for p in parts for n in p.get_nodes()} == set(labels)
    assert sum(len(p.get_edges()) for p in parts) == len(edges)
    read = nx.read_graphml(io.BytesIO(to_graphml(skill)), force_multigraph=True)
    assert set(read) == set(labels) | {c.key for c in clusters_of(skill)}
    lines = to_mermaid(skill).decode().splitlines()
    assert sum(" -->|" in line for line in lines) == len(edges)
    assert {line.count('"') for line in lines} == {0, 2}

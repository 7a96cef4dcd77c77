"""Clusters are the skill, against the views that everything else is stored from."""

import copy

import pytest
from support import (
    custom_actions,
    nested_actions,
    random_graphs,
    random_skill,
    seeded,
    stochastic_actions,
)

from cgtorch.evolution.population import random_population
from cgtorch.graphs import Skill, to_networkx
from cgtorch.graphs.clusters import clusters_of


@pytest.mark.parametrize(
    "skill",
    [
        random_skill(0, "S2", nested_actions(0)),
        random_skill(5, "flat", custom_actions()),
        random_skill(6, "random", stochastic_actions()),
    ],
    ids=lambda skill: skill.name,
)
def test_every_node_edge_and_end_of_every_skill_is_there_once(skill: Skill) -> None:
    clusters, skills = clusters_of(skill), skill.levels
    assert (clusters[0].skill, clusters[0].name) == (skill, skill.name)
    assert [cluster.skill for cluster in clusters] == list(skills)
    assert len(skills) == skill.depth
    keys = {cluster.key: cluster for cluster in clusters}
    for cluster in clusters:
        view = to_networkx(cluster.skill.graph, cluster.skill.actions)
        label = {key: node.label for key, node in cluster.nodes.items()}
        assert list(label.values()) == list(dict(view.nodes(data="label")).values())
        assert label[cluster.start] == view.nodes[view.graph["start"]]["label"]
        edges = {
            (view.nodes[a]["label"], outcome, view.nodes[b]["label"])
            for a, b, outcome in view.edges(data="outcome")
        }
        for node in cluster.nodes.values():
            assert (node.runs is not None) == (node.name in cluster.skill.sub_skills)
            if node.runs is not None:
                assert keys[node.runs].skill is cluster.skill.sub_skills[node.name]
            edges |= {(node.label, outcome, good) for outcome, good in node.action.terminal.items()}
        heads = label | cluster.ends
        assert {(label[e.tail], e.outcome, heads[e.head]) for e in cluster.edges} == edges
        assert len(cluster.edges) == len(edges)


def test_graphs_skills_and_populations_can_be_compared_and_kept_in_sets() -> None:
    actions = custom_actions()
    for one in (
        random_graphs(0, 3, actions),
        random_skill(0, "one", nested_actions()),
        random_population(3, actions, 12, (3, 10), seeded(0)),
    ):
        other = copy.deepcopy(one)
        assert one == one
        assert one != other
        assert one in [other, one]
        assert len({one, other, one}) == 2

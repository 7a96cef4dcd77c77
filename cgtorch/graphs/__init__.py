"""Computational graphs: graphs as tensors, validity, skills and their files."""

from cgtorch.graphs.files import load_skill as load_skill
from cgtorch.graphs.files import save_skill as save_skill
from cgtorch.graphs.files import skill_from_dict as skill_from_dict
from cgtorch.graphs.files import skill_to_dict as skill_to_dict
from cgtorch.graphs.flatten import flattened as flattened
from cgtorch.graphs.graphs import NO_NODE as NO_NODE
from cgtorch.graphs.graphs import Graphs as Graphs
from cgtorch.graphs.graphs import compacted as compacted
from cgtorch.graphs.graphs import concatenate as concatenate
from cgtorch.graphs.graphs import narrowed as narrowed
from cgtorch.graphs.graphs import resized as resized
from cgtorch.graphs.graphs import trimmed as trimmed
from cgtorch.graphs.graphs import widened as widened
from cgtorch.graphs.graphs import without as without
from cgtorch.graphs.merge import merged as merged
from cgtorch.graphs.merge import same_behaviour as same_behaviour
from cgtorch.graphs.skill import Skill as Skill
from cgtorch.graphs.skill import SubSkill as SubSkill
from cgtorch.graphs.validity import check_graph as check_graph
from cgtorch.graphs.validity import pruned as pruned
from cgtorch.graphs.validity import reachable as reachable
from cgtorch.graphs.validity import valid as valid
from cgtorch.graphs.view import from_networkx as from_networkx
from cgtorch.graphs.view import to_networkx as to_networkx

import pytest
import torch
from support import Counter, custom_actions, random_skill, seeded, world

from cgtorch.graphs import NO_NODE, Action, ActionSet, SubSkill
from cgtorch.ground.environment import start_lanes
from cgtorch.ground.errors import ActionError
from cgtorch.tabletop.actions import Detect, Grasp, paper_actions


def test_the_papers_five() -> None:
    actions = paper_actions()
    assert actions.names == ("MoveBase", "Detect", "Grasp", "ContinuousNN", "BranchingNN")
    outcomes = [a.outcomes for a in actions.actions]
    assert outcomes == [
        ("success", "failure"),
        ("success",),
        ("success", "failure"),
        ("success",),
        ("out1", "out2"),
    ]
    assert actions.has_edge.tolist() == [
        [True, True],
        [True, False],
        [False, True],
        [True, False],
        [True, True],
    ]
    assert actions.terminal.nonzero().tolist() == [[2, 0]]
    assert actions.succeeds.nonzero().tolist() == [[2, 0]]
    assert actions.message_size == 3
    assert actions.parameter_capacity == 36


def test_the_five_read_percepts_of_any_length() -> None:
    seven, thirteen = paper_actions(), paper_actions(13)
    assert seven.names == thirteen.names
    assert seven.num_parameters.tolist() == [0, 0, 0, 3 * 7 + 3 + 9 + 3, 3 * 7 + 3 + 6 + 2]
    longer = thirteen.num_parameters - seven.num_parameters
    assert longer.tolist() == [0, 0, 0, 3 * 6, 3 * 6]


def test_extending_keeps_indices_and_grows_tables() -> None:
    base, actions = paper_actions(), custom_actions()
    assert actions.names[:5] == base.names
    assert actions.outcome_capacity == 3
    assert actions.terminal[5].tolist() == [False, False, True]
    assert not actions.succeeds[5].any()
    assert actions.message_size == 4
    assert [actions.index(name) for name in actions.names] == list(range(6))
    with pytest.raises(ActionError, match="unknown action 'Fly'; known are MoveBase, Detect"):
        actions.index("Fly")


def test_lists_are_as_good_as_tuples() -> None:
    base = paper_actions()
    listed = ActionSet(list(base.names), list(base.actions))
    assert listed == base
    assert hash(listed) == hash(base)
    with pytest.raises(ActionError, match="1 names for 5 actions"):
        ActionSet(["Only"], list(base.actions))


def test_initial_parameters_do_not_depend_on_other_nodes() -> None:
    actions = custom_actions()
    one, two = (torch.tensor(x) for x in ([3, 4, 5, 0], [3, 1, 3, 5]))
    a, b = (actions.initial_parameters(x, seeded(0)) for x in (one, two))
    assert torch.equal(a[0], b[0])
    assert (a[3] == 0).all()
    assert (a[2, 2:] == 0).all()
    assert (a[2, :2] != 0).all()


def test_nodes_that_a_mutation_makes_get_numbers_where_they_have_parameters_only() -> None:
    actions = custom_actions()
    action = torch.tensor([[3, NO_NODE, 0], [5, 4, NO_NODE]])
    found = actions.parameters_of(action, seeded(0))
    used = torch.where(action < 0, 0, actions.num_parameters[action])[..., None]
    assert torch.equal(found != 0, torch.arange(actions.parameter_capacity) < used)


def test_a_skill_in_a_set_needs_the_longest_message_in_it() -> None:
    assert ActionSet(("Detect",), (Detect(),)).message_size == 0
    skill = SubSkill(random_skill(0, "S0", custom_actions()))
    assert paper_actions().extended(["S0"], [skill]).message_size == 4


def test_a_skill_is_no_single_step() -> None:
    skill, place = SubSkill(random_skill(0, "S0", custom_actions())), world(0, 1)
    lanes = start_lanes(place, torch.arange(1), 4, 2)
    with pytest.raises(ActionError, match=r"'S0' cannot run as one step; run it with rollout\(\)"):
        skill(lanes, torch.zeros(1, 0), place)


class NoOutcome(Counter):
    outcomes = ()


class TwiceTheSame(Counter):
    outcomes = ("a", "a")


class EndsOnNothing(Counter):
    terminal = {"gone": True}  # noqa: RUF012


@pytest.mark.parametrize(
    ("names", "actions", "message"),
    [
        ((), (), "0 names for 0 actions"),
        (("a",), (), "1 names for 0 actions"),
        (("a", "a"), (Detect(), Grasp()), "'a' is used twice"),
        (("a",), ("text",), "'a' is a str; subclass Action"),
        (("a",), (NoOutcome(),), r"'a' has outcomes \(\)"),
        (("a",), (TwiceTheSame(),), r"'a' has outcomes \('a', 'a'\); give unique names"),
        (("a",), (EndsOnNothing(),), "'a' ends on 'gone', which is none of its outcomes"),
    ],
)
def test_sets_that_cannot_be(
    names: tuple[str, ...], actions: tuple[Action, ...], message: str
) -> None:
    with pytest.raises(ActionError, match=message):
        ActionSet(names, actions)

"""The message of each event, and of all that was asked."""

from dataclasses import replace

import pytest
from members import nearly
from screens import CHANCE, LOOKS, TRIALS, practised
from support import random_graphs

from cgtorch.domains.knowledge import Knowledge, summary_of
from cgtorch.graphs import Skill
from cgtorch.ground.asked import Asked, Purse
from cgtorch.ground.statistics import Acceptance
from cgtorch.improvement.events import (
    AboutToKeep,
    EpisodePlayed,
    Event,
    FreshTested,
    JournalDamaged,
    MeanTested,
    ModelsFitted,
    SkillAccepted,
    StageStarted,
    WorldAsked,
    WorldTested,
)
from cgtorch.improvement.imagined_state import CHAMPIONS, RANDOM, STARTS
from cgtorch.report.messages import asked_of, mean_text, message_of, place_of, stage_number
from cgtorch.tabletop.actions import paper_actions


def test_what_models_have_learned_is_told(events: list[Event], knowledge: Knowledge) -> None:
    fitted = next(e for e in events if isinstance(e, ModelsFitted))
    said = Acceptance(True, 20, 0.02, 0.01, 0.001), Acceptance(False, 20, 0.03, 0.04, 0.001)
    learned = replace(knowledge, acceptances=said)
    assert message_of(replace(fitted, summary=summary_of(learned))).startswith(
        "S1: Γ was trained on more data; C stays as it was, since its error on earlier data would "
        "be 0.0400 instead of 0.0300; now from 120 transitions"
    )


def test_a_round_without_a_new_skill_says_which_one_was_tested() -> None:
    tested = FreshTested("auto-5", "auto-4", 390, 400, 0.99, decisive=False)
    assert message_of(tested) == (
        "auto-5: no skill was accepted; auto-4 was tested again, 390 of 400 fresh scenarios = "
        "97.5%, the goal is 0.99"
    )
    final = replace(tested, decisive=True)
    assert message_of(final).startswith("auto-5: final test, 390 of 400 fresh scenarios")
    own = replace(tested, skill="auto-5")
    assert message_of(own).startswith("auto-5: 390 of 400 fresh scenarios")


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (TRIALS, "S1: trials: 68 motions and 19 tests, 17 of 18 succeeded"),
        (replace(TRIALS, recalled=True), "S1: trials: 68 motions and 19 tests, 17 of 18 succeeded"),
        (
            WorldAsked("start", "exploration", Asked(84, 65, 14)),
            "start: exploration: 84 motions and 65 tests",
        ),
        (
            WorldAsked("S1", "practice", Asked(0, 0, 1, 1)),
            "S1: practice: 0 motions and 0 tests, 0 of 1 succeeded",
        ),
        (LOOKS, ""),  # percepts that were only looked at take a robot no time
        (practised(7), "ahead 0.5: 7 of 24 fresh scenarios solved in a row"),
        (
            CHANCE,
            "S1: under other noise the same skill solves 40% of the 30 scenarios that it solved: "
            "this world is chance; from now on skills are evolved in it on fresh scenarios, and "
            "means count (--chance no overrules it)",
        ),
        (
            MeanTested("S1", nearly(0.5), True, 2.8567, 0.0104, 4096, 12, 123456),
            "S1: mean 2.86 ± 0.02 on 4,096 fresh episodes; 12 in each generation, 123,456 played",
        ),
        (
            MeanTested("S1", nearly(0.5), True, None, None, 0, 4, 192),
            "S1: mean – on 0 fresh episodes; 4 in each generation, 192 played",
        ),
        (
            FreshTested("auto-2", "auto-2", 5, 16384, 3.0, True, 2.8567, 0.0104),
            "auto-2: final test, mean return 2.86 ± 0.02 on 16384 fresh episodes, the goal is 3",
        ),
        (
            FreshTested("auto-2", "auto-2", 0, 0, 0.9, False),
            "auto-2: 0 of 0 fresh scenarios = 0.0%, the goal is 0.9",
        ),
        (
            WorldAsked("S1", "trials", Asked(3, 2, 0, 4, 90, 60), succeeded=1),
            "S1: trials: 90 low-level steps, 60 of them simulated, 1 of 4 succeeded",
        ),
        (WorldAsked("S1", "search", Asked(3, 2, 0, 4, 90, 60)), ""),
        (
            EpisodePlayed("auto-1", "curious", -3.25, 200, 12345),
            "auto-1: curious, an episode in the world of 200 steps with return -3.25; "
            "12,345 steps so far",
        ),
        (
            EpisodePlayed("auto-1", "curious", None, 200, 200),
            "auto-1: curious, an episode in the world of 200 steps with return –; 200 steps so far",
        ),
        (
            JournalDamaged("S1", ("a.json", "b.json")),
            "S1: damaged files, whose work is repeated: a.json, b.json",
        ),
        (WorldTested("S1", "S1.2", 6, 6, 3, 5), "S1.2: in the world W 6/6, M 3/5"),
        (
            WorldTested("S1", "S1.2", 5, 6, 3, 5),
            "S1.2: in the world W 5/6, M 3/5; not accepted, as it loses some of W; "
            "the search goes on",
        ),
        (
            StageStarted("auto-3", (), 7, 2, 4),
            "auto-3: round 3, 7 scenarios to keep (W), 2 to solve",
        ),
        (AboutToKeep(), ""),
    ],
)
def test_messages(event: Event, message: str) -> None:
    assert message_of(event) == message


def test_all_that_was_asked_is_summed_up_with_the_time_it_takes_a_robot() -> None:
    purse = Purse()
    purse.add("exploration", Asked(84, 65, 14))
    purse.add("looks", Asked(looks=69))
    purse.add("trials", Asked(61, 30, 20, 20))
    assert asked_of("world", purse) == (
        "asked of the world: 145 motions, 95 tests, 2.0 h at 30 s (exploration 149, trials 91); "
        "103 scenes were looked at"
    )


def test_looks_alone_take_no_time() -> None:
    purse = Purse()
    purse.add("looks", Asked(looks=64))
    said = "asked of the world: no motions and no tests; 64 scenes were looked at"
    assert asked_of("world", purse) == said


def test_low_level_steps_and_episodes_with_rewards_are_summed_up_as_such() -> None:
    purse = Purse()
    purse.add("exploration", Asked(looks=5))
    purse.add("trials", Asked(2, 1, 0, 3, 90, 60))
    purse.add("search", Asked(4, 0, 0, 2, 1900, 400))
    assert asked_of("world", purse) == (
        "asked of the world: 1990 low-level steps (trials 90, search 1900), of which 460 had to "
        "be simulated, in 5 trials and a search"
    )
    purse = Purse()
    purse.add(STARTS, Asked(looks=5))
    purse.add(RANDOM, Asked(1500, 0, 7, 3))
    purse.add(CHAMPIONS, Asked(500, 0, 1, 1))
    assert asked_of("world", purse) == (
        f"asked of the world: 2,000 steps ({RANDOM} 1500, {CHAMPIONS} 500) in 4 episodes, and 13 "
        "first percepts; fresh episodes of tests are not among them"
    )
    assert asked_of("robot", purse).startswith("asked of the robot: 2000 motions, 0 tests, 16.7 h")


def test_the_skill_of_a_stage_is_counted_in_words(events: list[Event]) -> None:
    accepted = next(e for e in events if isinstance(e, SkillAccepted))
    alone = replace(accepted, skill=nearly(0.5), seconds=7.0)
    nodes = alone.skill.num_nodes
    assert nodes > 1
    assert message_of(alone).endswith(f", {nodes} nodes in 1 level, 0:07")
    single = Skill("one", random_graphs(0, 1, paper_actions(), nodes=(1, 2)), paper_actions())
    assert message_of(replace(alone, skill=single)).endswith(", 1 node in 1 level, 0:07")
    none = accepted.succeeded[:0]
    unkept = replace(alone, succeeded=none, keep=none, targets=none)
    assert message_of(unkept) == f"S1: accepted; {nodes} nodes in 1 level, 0:07"


def test_a_stage_has_a_number_among_those_of_its_run() -> None:
    third = StageStarted("S2", ("S0", "S1", "S2", "S3"), 0, 5, 4)
    assert (stage_number(third), place_of(third)) == ((3, 4), "stage 3 of 4")
    assert stage_number(replace(third, stages=())) == (1, 1)
    assert stage_number(replace(third, stage="other")) == (1, 4)


@pytest.mark.parametrize(
    ("mean", "error", "text"),
    [
        (None, 0.5, "–"),
        (123456.0, None, "1.2346e+05"),
        (1234.56, 30.0, "1235 ± 60"),
        (0.5, 7e-7, "0.500000 ± 0.000001"),
        (0.5, 4e-7, "5.000000e-01 ± 8e-07"),
        (0.25, 4e-8, "2.5000000e-01 ± 8e-08"),
        (0.0, 4e8, "0 ± 800000000"),
        (2e-9, 4e8, "2e-09 ± 8e+08"),
    ],
)
def test_a_mean_is_written_up_to_the_first_digit_of_its_error(
    mean: float | None, error: float | None, text: str
) -> None:
    assert mean_text(mean, error) == text

"""Skills of any domain at work in the browser, picture by picture (`cgtorch-view`)."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from cgtorch.commands import common
from cgtorch.commands.interrupts import interrupts
from cgtorch.ground.errors import CgtorchError, SettingsError

if TYPE_CHECKING:
    from cgtorch.report.episode_page import Wish
    from cgtorch.runs.chosen import Chosen

MOST_SEED = 2**31 - 1


def play(chosen: "Chosen", count: int, seed: int, host: str, port: int) -> None:
    """Serve pages on which the skills of a run act, until the process is terminated.

    SettingsError if the scenarios are unknown, or their world is a robot.
    """
    from cgtorch.domains.way import Judge
    from cgtorch.ground.environment import Live
    from cgtorch.report.episode_page import Wish, episode_of, episode_page
    from cgtorch.report.episode_server import answer_for_ever, serving
    from cgtorch.training.evaluate import drawn
    from cgtorch.training.explained import background_of

    run, domain, skills = chosen.run, chosen.domain, _skills(chosen)
    if isinstance(domain.world(drawn(chosen.skill, domain, chosen.kind, 1, seed)), Live):
        raise SettingsError("a robot is watched where it stands; give a run in a simulated world")
    known = None if run is None or chosen.stage is None else background_of(run, chosen.stage)
    judge = Judge(known.knowledge if known else None, domain.percept)
    usual = Wish(chosen.skill.name, chosen.kind, 1, seed)

    def pages(query: dict[str, str]) -> bytes:
        wish = wished(query, usual, [*skills], domain.kinds, count)
        about = domain, [*skills], count
        try:
            scenarios = drawn(skills[wish.skill], domain, wish.kind, count, wish.seed)
            scenario = scenarios[wish.number - 1 : wish.number]
            episode = episode_of(skills[wish.skill], domain, scenario, judge)
            return episode_page(wish, episode, *about)
        except CgtorchError as e:
            return episode_page(wish, None, *about, str(e))

    with interrupts.awaited(), serving(host, port) as (address, waiting):
        common.say(f"{chosen.skill.name} at work: {address} (Ctrl-C ends it)")
        answer_for_ever(waiting, pages)


def _skills(chosen: "Chosen") -> dict[str, Any]:
    """The skills of a run by name, the chosen one among them."""
    from cgtorch.graphs import load_skill

    found = {}
    if (run := chosen.run) is not None:
        files = (run.folder / name / "skill.json" for name in run.stages)
        made = [load_skill(path, run.actions) for path in files]
        found = {skill.name: skill for skill in made}
    return {**found, chosen.skill.name: chosen.skill}


def wished(
    query: Mapping[str, str], usual: "Wish", skills: list[str], kinds: tuple[str, ...], count: int
) -> "Wish":
    """What a query wishes for; the usual in place of what it does not say, or says wrongly.

    A query names a skill by its number in `skills`, from 1.
    """
    from cgtorch.report.episode_page import Wish

    first = skills.index(usual.skill) + 1
    skill = _within(query.get("skill"), 1, len(skills), first)
    kind = query.get("scenarios", "")
    return Wish(
        skills[skill - 1],
        kind if kind in kinds else usual.kind,
        _within(query.get("number"), 1, count, usual.number),
        _within(query.get("seed"), 0, MOST_SEED, usual.seed),
    )


def _within(text: str | None, least: int, most: int, usual: int) -> int:
    """A whole number from a query, within bounds."""
    try:
        return min(max(int(text or ""), least), most)
    except ValueError:
        return usual

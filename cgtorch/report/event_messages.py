"""Messages for events on the screen: one line each, without colour."""

from typing import Any

from cgtorch.ground.asked import Purse
from cgtorch.improvement import events
from cgtorch.report.estimate import as_time, place_of

SECONDS = 30  # of a robot's motion or grasp, with all that belongs to it


def message_of(event: events.Event) -> str:
    """The message of an event, "" if it has none."""
    match event:
        case events.StageStarted():
            return (
                f"{event.stage}: {place_of(event)}, "
                f"{event.size_w} scenarios to keep (W), {event.size_m} to solve"
            )
        case events.EvolutionRecalled():
            known = event.found.generations
            return f"{event.candidate}: {known} generations are already in the journal"
        case events.JournalDamaged():
            files = ", ".join(event.files)
            return f"{event.stage}: damaged files, whose work is repeated: {files}"
        case events.ModelsFitted():
            return f"{event.stage}: {event.summary.text}, {event.seconds:.1f} s"
        case events.WorldTested():
            return _world_tested(event)
        case events.WorldAsked():
            return "" if event.phase == "looks" else f"{event.stage}: {_asked(event)}"
        case events.ChanceFound():
            share = event.succeeded / event.tried
            return (
                f"{event.stage}: under other noise the same skill solves {share:.0%} of the "
                f"{event.tried} scenarios that it solved: this world is chance; a scenario that "
                "was solved is no fact, and skills are compared by counts"
            )
        case events.Practised():
            return (
                f"{event.skill.name}: {event.in_a_row} of {event.wanted} fresh scenarios solved in "
                "a row"
            )
        case events.SkillAccepted():
            return _skill_accepted(event)
        case events.FreshTested():
            share = event.succeeded / max(1, event.tried)
            kind = "final test, " if event.decisive else ""
            if event.skill != event.stage and not event.decisive:
                kind = f"no skill was accepted; {event.skill} was tested again, "
            mean = "" if event.mean_return is None else f", mean return {event.mean_return:.5g}"
            return (
                f"{event.stage}: {kind}{event.succeeded} of {event.tried} fresh scenarios = "
                f"{share:.1%}{mean}, the goal is {event.target:.4g}"
            )
    return ""


def _asked(event: events.WorldAsked) -> str:
    asked = event.asked
    tried = f", {event.succeeded} of {asked.episodes} succeeded" if asked.episodes else ""
    return f"{event.phase}: {asked.motions} motions and {asked.tests} tests{tried}"


def asked_of(whom: str, purse: Purse) -> str:
    """What was asked in all phases, such as of a robot, and how long that takes one."""
    total = purse.total
    hours = total.actions * SECONDS / 3600
    phases = ", ".join(f"{phase} {a.actions}" for phase, a in purse.spent.items() if a.actions)
    return (
        f"asked of the {whom}: {total.motions} motions, {total.tests} tests, {hours:.1f} h at "
        f"{SECONDS} s ({phases}); {total.looks} scenes were looked at"
    )


def few_solved(tried: int, solved: int) -> str:
    """The message that few of the episodes succeeded for which skills were evolved."""
    return (
        f"of {tried} episodes that skills were evolved for, {solved} succeeded in the world: Γ or "
        "C is wrong where the search goes; see 'When it does not learn' in docs/own-domain.md"
    )


def _world_tested(event: events.WorldTested) -> str:
    text = (
        f"{event.candidate}: in the world W {event.solved_w}/{event.size_w}, "
        f"M {event.solved_m}/{event.size_m}"
    )
    if event.solved_w < event.size_w:
        text += "; not accepted, as it loses some of W; the search goes on"
    return text


def _skill_accepted(event: events.SkillAccepted[Any]) -> str:
    w, targets = event.succeeded[event.keep], event.targets
    others = event.succeeded[~event.keep]
    nodes = f"{event.skill.num_nodes} node{'s' if event.skill.num_nodes != 1 else ''}"
    tests = f"tests {int(event.succeeded[targets].sum())}/{int(targets.sum())}"
    parts = [
        *([tests] if int(targets.sum()) < len(others) else []),  # in a round, M is the test
        f"W {int(w.sum())}/{len(w)}",
        f"M {int(others.sum())}/{len(others)}",
        f"{nodes} in {event.skill.depth} level{'s' if event.skill.depth != 1 else ''}",
        as_time(event.seconds),
    ]
    return f"{event.stage}: accepted; {', '.join(parts)}"

"""What to blame for failures and what to change, in sentences that follow from measurements."""

from typing import Any

from cgtorch.domains.domain import Domain, rewarded
from cgtorch.domains.failures import Advice, Failures, Searched
from cgtorch.domains.way import Motion
from cgtorch.training.evaluate import Score

MODELS = "Γ and C"
NEAR_DATA = 0.5  # novelty of a motion that is among Γ's data
TOLD = 3  # kinds about which advice says where Γ is wrong
UNKNOWN = (
    "there are no data like it: collect some there (go on training, as every trial in the world "
    "teaches Γ, or give a log by --data)"
)
FAMILIAR = (
    "although there are data like it: such cases may be rare, so collect more data "
    "(--transitions), or the percept may lack what decides this, so add that"
)


def blame_of(found: Failures, modelled: bool) -> str:
    """Whether the models or the search are to blame for failures; "" without any."""
    causes = found.causes()
    total = sum(causes.values())
    if not total:
        return ""
    wrong = causes.get("gamma", 0) + causes.get("classifier", 0)
    said = []
    if not modelled:
        said.append("The skill was evolved in the world itself, so no model is to blame.")
    if count := causes.get("open"):
        said.append(
            f"For {count} of {total} it is open: the models in which the skill was evolved are not "
            "in the run's folder, or have rewards, so they are not asked here."
        )
    if wrong:
        parts = [
            f"{name} for {causes[key]}"
            for key, name in (("gamma", "Γ"), ("classifier", "C"))
            if key in causes
        ]
        said.append(
            f"The models are to blame for {wrong} of {total} ({', '.join(parts)}): there the skill "
            "succeeds in Γ and C, but not in the world."
        )
    if count := causes.get("search"):
        said.append(
            f"The search is to blame for {count} of {total}: there the skill fails in Γ and C, too."
        )
    if count := causes.get("world"):
        said.append(f"The search is to blame for {count} of {total}: it has found nothing better.")
    if rest := [f"{causes[name]} {words}" for name, words in OTHERS.items() if name in causes]:
        said.append(f"Neither is to blame for {', '.join(rest)}.")
    return " ".join(said)


def unskilled(searched: Searched | None, where: str) -> Failures:
    """What is known of a run without a skill, whose skills are evolved in Γ and C or elsewhere."""
    s, modelled = searched, where == MODELS
    if s is None and modelled:
        blame = "Nothing was searched so far."
        text = (
            "Γ and C could not be learned from the first data, or the training has not come so "
            "far. If success was met too rarely, give scenarios that begin nearer to success, say "
            "which controls are worth trying (Models.worth_trying), or evolve in the world "
            "(--models none)."
        )
    elif s is not None and modelled and s.imagined[0] and s.met[1] and not s.met[0]:
        blame = (
            f"The models are to blame: in Γ and C an individual solved {s.imagined[0]} of "
            f"{s.imagined[1]} scenarios, in the world skills solved none in {s.met[1]} episodes."
        )
        text = (
            "Collect more data, and nearer to success (--transitions, Models.worth_trying, a log "
            "by --data), or evolve in the world (--models none)."
        )
    else:
        blame, text = f"The search has found none in {where}.", " ".join(about_search(s))
    return Failures(
        "", blame=f"There is no skill yet. {blame}", advice=(Advice("search", 0, text),)
    )


OTHERS = {
    "unreachable": "that nothing can solve",
    "noise": "that the skill solves under most other noise",
    "limit": "that it solves with more transitions",
}


def advice_about(
    found: Failures, domain: Domain[Any], score: Score, searched: Searched | None
) -> tuple[Advice, ...]:
    """What to change, the advice about the most failures first."""
    said = []
    for cause, count in found.causes().items():
        text = " ".join(_advice(cause, found, domain, searched))
        said.append(Advice(cause, count, text))
    if found.lucky:
        text = "They succeeded when they were met again: the world does not repeat itself."
        said.append(Advice("noise", found.lucky, text))
    mean = score.mean_return if rewarded(domain) else None
    if found.failed and mean is not None and mean - (score.error or 0) >= domain.target_return:
        text = (
            f"Nothing has to be changed: the mean return of {mean:.5g} reaches the target of "
            f"{domain.target_return:g}, which is one for the mean, so single episodes may fall "
            "short of it. For a higher mean raise --target."
        )
        return (Advice("goal", found.failed, text),)
    return tuple(said)


def _advice(
    cause: str, found: Failures, domain: Domain[Any], searched: Searched | None
) -> list[str]:
    """Sentences about one cause."""
    match cause:
        case "unreachable":
            return ["Nothing solves them, so leave such scenarios out, or change what can be done."]
        case "noise":
            return [
                "They are bad luck: the skill solves them under most other noise. More practice "
                "(--practice) makes skills a little more robust."
            ]
        case "limit":
            return [
                "They are solved with more than twice as many transitions: raise --max-transitions."
            ]
        case "gamma":
            return about_gamma(found, domain)
        case "classifier":
            return [
                "C says success where a test in the world fails. It needs labels there, and every "
                "failed test is "
                "one: go on training. If it stays wrong, the percept lacks what decides success: "
                "add that, or features for C (Models.success_features)."
            ]
        case "search" | "world":
            return about_search(searched)
    return ["Evaluate the run where its models are, or train again."]


def about_gamma(found: Failures, domain: Domain[Any]) -> list[str]:
    """Sentences about a Γ that is wrong, from where it and the world part in the first kinds."""
    said = []
    for number, kind in enumerate(found.kinds, 1):
        if all(cause.name != "gamma" for cause in kind.causes):
            continue
        if (step := kind.way.parts) is not None:
            motion = worst_of(kind.way.acts[step].motions)
            names = ", ".join(wrong_numbers(motion, domain))
            where = UNKNOWN if (motion.novelty or 0) > NEAR_DATA else FAMILIAR
            said.append(f"In kind {number} Γ is wrong about {names} in step {step}; {where}.")
        elif kind.causes[0].name == "gamma":
            said.append(
                f"In kind {number} no prediction is far off: small errors of Γ add up, which more "
                "data make smaller (--transitions, or go on training)."
            )
    return said[:TOLD] or ["Γ is wrong: collect more data (--transitions, or go on training)."]


def worst_of(motions: tuple[Motion, ...]) -> Motion:
    """The motion about which Γ is most wrong."""
    return max(motions, key=lambda motion: motion.error or 0)


def wrong_numbers(motion: Motion, domain: Domain[Any]) -> list[str]:
    """The names of the numbers of a percept about which Γ errs more than it does usually.

    The most wrong one comes first; it is named in any case.
    """
    if motion.errors is None:
        return []
    order = motion.errors.argsort(descending=True).tolist()
    known = len(domain.percept) == len(order)
    names = [domain.percept[d].name if known else f"number {d}" for d in order]
    return [
        name
        for i, (d, name) in enumerate(zip(order, names, strict=True))
        if i == 0 or motion.errors[d] > 1
    ][:3]


def about_search(searched: Searched | None) -> list[str]:
    """Sentences about a search that has found no better skill, from what the log says of it."""
    if searched is None:
        return ["Go on training, with more --generations or a larger --population."]
    s, said = searched, []
    if s.scarce and s.ended not in ("goal", "practice"):
        said.append(f"The search had little: {', '.join(s.scarce)}. Give it the usual first.")
    elif s.generations and not s.solving:
        return [
            f"In {s.generations} generations no individual solved anything (the best fitness is "
            f"{s.best:.3g}), so more of them, or a larger --population, will hardly help. Give the "
            "search a way to begin: scenarios "
            "nearer to success (--scenarios, stages), rewards for progress, or actions that do "
            "more (--actions)."
        ]
    if s.ended == "goal":
        said.append(
            f"The training ended since it reached its target of {s.value:g}: raise --target."
        )
    elif s.ended == "practice":
        said.append(
            f"The search ended since {s.value:g} fresh scenarios in a row were solved: raise "
            "--practice."
        )
    elif s.ended == "limits":
        said.append(
            f"The training ended at its limits ({s.limits}): go on with cgtorch-train --resume RUN "
            "and higher ones."
        )
    elif s.ended == "interrupted":
        said.append(f"{s.stage} has not come to its end: go on with cgtorch-train --resume RUN.")
    if s.rising:
        said.append(
            f"The fitness still rose when the last evolution ended after {s.limit} generations: "
            "raise --generations."
        )
    elif s.ended == "failed" and not s.scarce:
        said.append(
            "The fitness did not rise any more: raise --population, or give other actions "
            "(--actions)."
        )
    return said or ["Raise --population, or give other actions (--actions)."]

"""Skills as commands are given them: of a run, a stage in it, its ledger, or a file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cgtorch.actions import resolve_actions
from cgtorch.domains.domain import Domain
from cgtorch.domains.registry import make_domain
from cgtorch.domains.settings import from_plain
from cgtorch.graphs import Skill, load_skill
from cgtorch.ground.errors import ActionError, GraphError, RunError, SettingsError
from cgtorch.runs.ledger import read_entry
from cgtorch.runs.run import Run, open_run, read_about
from cgtorch.runs.settings import RunSettings


@dataclass(frozen=True)
class Chosen:
    """A skill with the domain and kind of the scenarios that it is to be tried on.

    The run is None where a file stands for itself, the stage's folder where it is not known.
    """

    skill: Skill
    domain: Domain[Any]
    kind: str
    run: Run | None = None
    stage: Path | None = None


def chosen_skill(
    path: Path,
    name: str | None,
    actions: Sequence[str],
    kind: str | None,
    domain: str | None = None,
) -> Chosen:
    """The skill of a path: of a run, which stands for its last, of a stage in it, or of a file.

    It may be another of the run's ledger by `name`, and use further `actions`, which may be
    imported. The `kind` of scenarios, if not given, is what the run is about, or the usual one of
    the domain. The `domain` is what a file is for, or the run's if that is code that may be
    imported. CgtorchError if there is none, or it cannot be read.
    """
    if path.is_file():
        made, kind, skill = lone_skill(path, actions, kind, domain or RunSettings.domain)
        return Chosen(skill, made, kind)
    if name is not None:
        run = open_run(path, actions, domain)
        skill = read_entry(path, name, run.actions, run.like()).skill
        stage = path / name if (path / name).is_dir() else None
    else:
        run, skill = last_skill(path, actions, domain)
        stage = path if (path / "skill.json").is_file() else path / run.stages[-1]
    return Chosen(skill, run.domain, kind or run.kind, run, stage)


def stored_domain(path: Path) -> str | None:
    """The domain's name of a run's or stage's folder; None without run, RunError if damaged."""
    for folder in (path, path.absolute().parent):
        if (folder / "run.json").is_file():
            return from_plain(RunSettings, read_about(folder).get("settings")).domain
    return None


def last_skill(
    path: Path, trusted: Sequence[str] = (), domain: str | None = None
) -> tuple[Run, Skill]:
    """The last skill of a run's folder, or the skill of a stage's folder such as RUN/S2.

    `trusted` and `domain` are those of `open_run`. RunError if there is no run or no skill yet.
    """
    if (path / "run.json").is_file():
        run = open_run(path, trusted, domain)
        if not run.stages:
            raise RunError(f"run {str(path)!r} has no finished stage; continue with --resume")
        return run, load_skill(path / run.stages[-1] / "skill.json", run.actions)
    if (path / "skill.json").is_file():
        run = open_run(path.absolute().parent, trusted, domain)  # also of "."
        return run, load_skill(path / "skill.json", run.actions)
    raise RunError(f"{str(path)!r} is no run and no stage of one; give RUN or RUN/S2")


def lone_skill(
    path: Path, names: Sequence[str] = (), kind: str | None = None, domain: str = RunSettings.domain
) -> tuple[Domain[Any], str, Skill]:
    """The domain, kind of scenarios and skill of a file that stands for itself.

    GraphError if it is no skill for a variant of the domain, ActionError if an action is unknown.
    """
    made = make_domain(domain)
    kind = made.usual_kind if kind is None else kind
    if kind not in made.kinds:
        raise SettingsError(f"scenarios is {kind!r:.40}; use one of {', '.join(made.kinds)}")
    errors: list[GraphError | ActionError] = []
    for variant in made.variants(kind):
        sizes = len(variant.percept), len(variant.control)
        try:
            actions = resolve_actions(names, variant.actions(), sizes)
            return variant, kind, load_skill(path, actions)
        except (GraphError, ActionError) as e:
            errors.append(e)
    raise next((e for e in errors if isinstance(e, GraphError)), errors[0])

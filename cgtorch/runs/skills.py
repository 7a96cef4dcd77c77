"""Skills from command-line arguments: of a run, a stage, a ledger, or a file."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cgtorch.domains.domain import Adaptable, Domain
from cgtorch.domains.registry import make_domain
from cgtorch.domains.settings import from_plain
from cgtorch.graphs import Skill, load_skill, resolve_actions
from cgtorch.ground.errors import ActionError, GraphError, RunError, SettingsError
from cgtorch.runs.ledger import read_entry
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.stored_run import StoredRun, read_about, read_run

EXPORTED = (".pt2", ".onnx", ".py")
"""The ends of names of exports that programs run."""


@dataclass(frozen=True)
class Chosen:
    """A skill, with the domain and the kind of the scenarios to try it on.

    `run` is None for a skill file; the stage's folder is None if it is not known.
    """

    skill: Skill
    domain: Domain[Any]
    kind: str
    run: StoredRun | None = None
    stage: Path | None = None


def chosen_skill(
    path: Path,
    name: str | None,
    actions: Sequence[str],
    kind: str | None,
    domain: str | None = None,
) -> Chosen:
    """The skill of a path: the last skill of a run, the skill of a stage, or a skill file.

    Args:
        path: A run, a stage in it, or a file.
        name: Another skill of the run's ledger.
        actions: Additional actions, which may be imported.
        kind: The kind of scenarios; by default the run's, or the domain's usual one.
        domain: The domain of a file, or the run's domain if it is code that may be imported.

    Raises:
        CgtorchError: There is no such skill, or it cannot be read.
    """
    if path.is_file():
        made, kind, skill = lone_skill(path, actions, kind, domain or RunSettings.domain)
        return Chosen(skill, made, kind)
    if name is not None:
        run = read_run(path, actions, domain)
        skill = read_entry(path, name, run.actions, run.like()).skill
        stage = path / name if (path / name).is_dir() else None
    else:
        run, skill = last_skill(path, actions, domain)
        stage = path if (path / "skill.json").is_file() else path / run.stages[-1]
    return Chosen(skill, run.domain, kind or run.kind, run, stage)


def stored_domain(path: Path) -> str | None:
    """The domain's name of a run or a stage; None without a run, RunError if it is damaged."""
    for folder in (path, path.absolute().parent):
        if (folder / "run.json").is_file():
            return from_plain(RunSettings, read_about(folder).get("settings")).domain
    return None


def last_skill(
    path: Path, trusted: Sequence[str] = (), domain: str | None = None
) -> tuple[StoredRun, Skill]:
    """The last skill of a run, or the skill of a stage such as RUN/S2.

    For `trusted` and `domain` see `read_run`. RunError if there is no run, or no skill yet.
    """
    if (path / "run.json").is_file():
        run = read_run(path, trusted, domain)
        if not run.stages:
            raise RunError(
                f"run {str(path)!r} has no finished stage or round; finish "
                f"one with cgtorch-train --resume {path}"
            )
        return run, load_skill(path / run.stages[-1] / "skill.json", run.actions)
    if (path / "skill.json").is_file():
        run = read_run(path.absolute().parent, trusted, domain)  # also of "."
        return run, load_skill(path / "skill.json", run.actions)
    raise RunError(f"{str(path)!r} is no run and no stage of one; give RUN or RUN/S2")


def _variants(domain: Domain[Any], kind: str) -> Iterable[Domain[Any]]:
    return domain.variants(kind) if isinstance(domain, Adaptable) else (domain,)


def lone_skill(
    path: Path, names: Sequence[str] = (), kind: str | None = None, domain: str = RunSettings.domain
) -> tuple[Domain[Any], str, Skill]:
    """The domain, kind of scenarios and skill of a skill file.

    GraphError if it does not fit any variant of the domain, ActionError for an unknown action.
    """
    made = make_domain(domain)
    kind = made.kinds[0] if kind is None else kind
    if kind not in made.kinds:
        raise SettingsError(f"scenarios is {kind!r:.40}; use one of {', '.join(made.kinds)}")
    errors: list[GraphError | ActionError] = []
    known = set[str]()
    for variant in _variants(made, kind):
        sizes = len(variant.percept), len(variant.control)
        actions = resolve_actions(names, variant.actions(), sizes)
        known.update(actions.names)
        try:
            return variant, kind, load_skill(path, actions)
        except (GraphError, ActionError) as e:
            errors.append(e)
    damaged = [e for e in errors if isinstance(e, GraphError)]
    if damaged and path.suffix in EXPORTED:
        raise GraphError(
            f"{str(path)!r} is an export for other programs, which is not read back; give the run, "
            "or a file of cgtorch-export --format json"
        )
    if damaged:
        raise damaged[0]
    # Each variant lacks some actions of the others; what all of them lack is meant.
    elsewhere = tuple(f"unknown action {name!r}" for name in known)
    others = [e for e in errors if not str(e).startswith(elsewhere)]
    raise ActionError(
        f"{(others or errors)[0]}; name your own domain or action with --domain or --actions "
        "package.module:Class"
    )

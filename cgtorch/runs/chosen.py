"""Skills and data from command-line arguments: of a run, of a stage, or of a file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from cgtorch.domains.domain import Adaptable, Domain
from cgtorch.domains.registry import is_code, make_domain
from cgtorch.graphs import Skill, load_skill, resolve_actions
from cgtorch.ground.environment import Dataset
from cgtorch.ground.errors import ActionError, GraphError, RunError, SettingsError
from cgtorch.ground.files import as_word
from cgtorch.runs.settings import RunSettings
from cgtorch.runs.storage import ASIDE, DATA, load_dataset
from cgtorch.runs.stored_run import SKILL, StoredRun, read_about, read_run, settings_in

EXPORTED = (".pt2", ".onnx", ".py")
"""The ends of names of exports that programs run."""
START = "start"


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
        name: The skill of an earlier stage or round of the run.
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
        if name not in run.stages:
            known = ", ".join(run.stages) or "another run; this one has no skill yet"
            raise RunError(f"no skill {name!r:.40} in run {str(path)!r}; give one of {known}")
        stage = path / name
        skill = load_skill(stage / SKILL, run.actions)
    else:
        run, skill = last_skill(path, actions, domain)
        stage = path if (path / SKILL).is_file() else folder_of_last(run) or path
    return Chosen(skill, run.domain, kind or run.kind, run, stage)


def stored_domain(path: Path) -> str | None:
    """The domain's name of a run or a stage; None without a run, RunError if it is damaged."""
    for folder in (path, path.absolute().parent):
        if (folder / "run.json").is_file():
            return settings_in(folder, RunSettings, read_about(folder).get("settings")).domain
    return None


def folder_of_last(run: StoredRun) -> Path | None:
    """The folder of the last finished stage or round; None if there is no skill yet.

    Before the first one, it is that of an interrupted one with its best skill so far.
    """
    if stages := run.stages:
        return run.folder / stages[-1]
    begun = sorted((run.folder / "journal").glob(f"*/{SKILL}"))
    return begun[-1].parent if begun else None


def without_skill(run: StoredRun, usual: str) -> str:
    """What a run without a last skill is, and what to do; `usual` unless a stage is lost."""
    stages = [*run.domain.stages]
    there = [name for name in stages if (run.folder / name / SKILL).is_file()]
    if not there:
        return usual
    lost = next(name for name in stages if name not in there)
    return f"has {there[0]}, but not {lost}, on which it builds; restore the folder of {lost}"


def last_skill(
    path: Path, trusted: Sequence[str] = (), domain: str | None = None
) -> tuple[StoredRun, Skill]:
    """The last skill of a run, or the skill of a stage such as RUN/S2.

    For `trusted` and `domain` see `read_run`. RunError if there is no run, or no skill yet.
    """
    if (path / "run.json").is_file():
        run = read_run(path, trusted, domain)
        if (last := folder_of_last(run)) is None:
            usual = (
                "has no finished stage or round, and no skill of an interrupted one; finish one "
                f"with {resuming(run)}"
            )
            raise RunError(f"run {str(path)!r} {without_skill(run, usual)}")
        return run, load_skill(last / SKILL, run.actions)
    if (path / SKILL).is_file():
        run = read_run(path.absolute().parent, trusted, domain)  # also of "."
        return run, load_skill(path / SKILL, run.actions)
    raise RunError(f"{str(path)!r} is no run and no stage of one; give RUN or RUN/S2")


def resuming(run: StoredRun) -> str:
    """The command that continues a run."""
    driver = f" --driver {quote(run.settings.driver)}" if run.settings.driver else ""
    return f"cgtorch-train --resume {as_word(run.folder)}{own_code(run)}{driver}"


def own_code(run: StoredRun) -> str:
    """The options that name the user's code of a run, as opening a run imports none by itself."""
    spec = run.settings.domain
    domain = f" --domain {quote(spec)}" if is_code(spec) else ""
    own = (name for name in run.settings.actions if ":" in name)
    return domain + "".join(f" --actions {quote(name)}" for name in own)


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
    for variant in made.variants(kind) if isinstance(made, Adaptable) else (made,):
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
    # Each variant lacks some actions of the others; the message names one that all of them lack.
    elsewhere = [f"unknown action {name!r}" for name in known]
    others = [e for e in errors if not any(said in str(e) for said in elsewhere)]
    raise ActionError(
        f"{(others or errors)[0]}; name your own domain or action with --domain or --actions "
        "package.module:Class"
    )


def stored_data(
    path: Path, name: str | None = None, trusted: Sequence[str] = (), domain: str | None = None
) -> tuple[StoredRun, str, Dataset]:
    """A run, the name of a part of it, and its data, those kept aside to judge models last.

    The part is `name`, or that of a path such as RUN/S1, or the last stage or round, or "start".
    For `trusted` and `domain` see `read_run`. RunError if there is no such run or part, or it is
    stored without data.
    """
    if name is None and path.is_dir() and not (path / "run.json").exists():
        run, part = read_run(path.absolute().parent, trusted, domain), path.absolute().name
    else:
        run = read_run(path, trusted, domain)
        part = name or (*run.stages, START)[max(0, len(run.stages) - 1)]
    if part not in (START, *run.stages):
        known = ", ".join((START, *run.stages))
        raise RunError(f"run {str(run.folder)!r} has no part {part!r:.40}; give one of {known}")
    folder = run.folder / part
    if not (folder / DATA).is_file():
        raise RunError(
            f"{str(folder)!r} has no data: the run is stored without them, or no models were "
            "learned; give another run"
        )
    data = load_dataset(folder / DATA).extended(load_dataset(folder / ASIDE))
    return run, part, data

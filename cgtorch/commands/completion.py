"""Shell completion: the script for a shell, and words that come from files.

Nothing here imports torch, so completion is fast.
"""

from collections.abc import Callable, Iterable
from importlib.metadata import distribution, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from click import Command, Context, Parameter
from click.shell_completion import CompletionItem, get_completion_class

from cgtorch.ground.errors import CgtorchError

if TYPE_CHECKING:
    from cgtorch.domains.domain import Domain

DOMAIN = "cgtorch.domain"
"""The key of the domain's name in the context of a command line."""
SHELLS = ("bash", "zsh", "fish")
SCENARIOS = ("perimeter", "near", "left", "right", "far", "general", "general-clutter")
STAGES = ("S0", "S1", "S2", "S3", "auto")

Completer: TypeAlias = Callable[[Context, Parameter, str], list[CompletionItem]]
"""Maps click's context, parameter and incomplete word to completions."""


def script(shell: str) -> str:
    """The script that a shell reads to complete the words of all cgtorch commands."""
    complete = get_completion_class(shell)
    if complete is None:
        raise ValueError(f"shell is {shell!r}; use one of {', '.join(SHELLS)}")
    commands = distribution("cgtorch").entry_points.select(group="console_scripts")
    return "\n".join(
        complete(Command(name), {}, name, f"_{name}_COMPLETE".replace("-", "_").upper()).source()
        for name in sorted(commands.names)
    )


def completing(words: Callable[[Context], Iterable[str]]) -> Completer:
    """Completes the words that a function of the context returns."""

    def complete(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem]:
        return [CompletionItem(word) for word in words(context) if word.startswith(incomplete)]

    return complete


def one_of(words: Iterable[str]) -> Completer:
    """Completes these words."""
    return completing(lambda context: words)


@completing
def domains(context: Context) -> Iterable[str]:
    """Names of the domains of the library and of installed packages."""
    from cgtorch.domains.registry import known_names

    return known_names()


@completing
def kinds_of_domain(context: Context) -> Iterable[str]:
    """The kinds of scenarios on which a run of the command line's domain can train."""
    return _of_domain(context, SCENARIOS, lambda domain: domain.kinds)


@completing
def stages(context: Context) -> Iterable[str]:
    """The stages of the command line's domain, and auto."""
    return _of_domain(context, STAGES, lambda domain: (*domain.stages, "auto"))


@completing
def skill_names(context: Context) -> Iterable[str]:
    """Names of the skills of the run on the command line."""
    # While an option lacks its value, click has not yet taken the arguments out of `args`.
    run = context.params.get("path") or next(iter(context.args), ".")
    return sorted(path.parent.name for path in Path(run).glob("*/skill.json"))


@completing
def declared_actions(context: Context) -> Iterable[str]:
    """Names of the actions that installed packages declare."""
    return sorted(entry_points(group="cgtorch.actions").names)


def _of_domain(
    context: Context, of_tabletop: Iterable[str], of: Callable[["type[Domain[Any]]"], Iterable[str]]
) -> Iterable[str]:
    """Words of the command line's domain; none if there is no such domain."""
    from cgtorch.domains.registry import TABLETOP, domain_class

    spec = context.meta.get(DOMAIN, TABLETOP)
    if spec == TABLETOP:
        return of_tabletop
    try:
        return of(domain_class(spec))
    except CgtorchError:
        return ()


def runs(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem]:
    """Folders of runs that begin with a word, first those in runs/; else any folder."""
    return _runs(incomplete) or [CompletionItem(incomplete, type="dir")]


def runs_or_skills(context: Context, parameter: Parameter, incomplete: str) -> list[CompletionItem]:
    """Folders of runs as in `runs`; else any file."""
    return _runs(incomplete) or [CompletionItem(incomplete, type="file")]


def _runs(incomplete: str) -> list[CompletionItem]:
    place, slash, begins = (incomplete or "runs/").rpartition("/")
    names = sorted(path.parent.name for path in Path(place + slash).glob("*/run.json"))
    return [CompletionItem(place + slash + name) for name in names if name.startswith(begins)]

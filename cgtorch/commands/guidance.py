"""What `cgtorch-train` says about a new run: what it will do, where to watch it, what is next."""

from collections.abc import Iterator

from cgtorch.domains.registry import TABLETOP, is_code
from cgtorch.runs.skills import last_skill
from cgtorch.runs.stored_run import StoredRun
from cgtorch.training.session import Work
from cgtorch.training.stages import stages_to_make


def before(work: Work) -> Iterator[str]:
    """The lines printed before a new run begins."""
    run, settings = work.run, work.run.settings
    about = f"domain {settings.domain}, seed {settings.seed}"
    if work.auto:
        aim = run.domain.target_return if run.domain.rewarded else work.goal.target
        yield f"New run {run.folder}: evolve skills until the target of {aim:.4g} is met ({about})."
    else:
        stages = ", ".join(stages_to_make(run, work.stage))
        yield f"New run {run.folder}: evolve one skill for each of {stages} ({about})."
    if run.learns:
        read = "Read the data that you give" if settings.data else ""
        collect = "collect more" if read else "Collect data"
        parts = ", ".join(part for part in (read, settings.transitions and collect) if part)
        yield f"  1. {parts}, and fit the transition model Γ and the success classifier C."
        yield "  2. Evolve skills inside Γ and C, and try the best of them in the world."
        yield "  3. Accept a skill if it forgets nothing and solves something new."
    else:
        yield "  1. Evolve skills in the world itself; no models are learned."
        yield "  2. Accept a skill if it forgets nothing and solves something new."
    yield f"  {_duration(work)} Progress appears here, and in TensorBoard:"
    yield f"    tensorboard --logdir {run.folder}"
    yield f"  Ctrl-C stops the run, and this command continues it: {resuming(run)}"


def resuming(run: StoredRun) -> str:
    """The command that continues a run."""
    driver = f" --driver {run.settings.driver}" if run.settings.driver else ""
    return f"cgtorch-train --resume {run.folder}{_code(run)}{driver}"


def after(work: Work) -> Iterator[str]:
    """The lines printed at the end of a run: what to look at next."""
    run = work.run
    if not run.stages:
        return
    yield from _use_of_own_actions(run)
    code = _code(run)
    yield "Next:"
    yield f"  cgtorch-evaluate {run.folder}{code}  # try the skill on fresh scenarios"
    if run.settings.domain == TABLETOP:
        yield f"  cgtorch-view {run.folder}{code}  # watch it at work in the browser"
    yield f"  cgtorch-report {run.folder}{code} --output report.html  # the run as one page"
    later = [name for name in run.domain.stages if name not in run.stages]
    if later and not work.auto:
        yield f"  {resuming(run)} --stage {later[-1]}  # more stages"


def _use_of_own_actions(run: StoredRun) -> Iterator[str]:
    """A line on each additional action: whether any node of the last skill has it."""
    added = set(run.actions.names) - set(run.domain.actions().names)
    if not added:
        return
    _, skill = last_skill(run.folder, run.settings.actions, run.settings.domain)
    for name in sorted(added):
        if name in skill.used_actions:
            yield f"{skill.name} uses the action {name}."
        else:
            unused = f"No node of {skill.name} is {name}: the search found no use for it."
            yield f"{unused} Another --seed may."


def _duration(work: Work) -> str:
    if work.auto:
        return f"No round begins after {work.goal.minutes:g} minutes (--minutes)."
    if work.run.settings.domain == TABLETOP:
        return (
            "On two quiet cores, S0 to S2 take some 10 seconds, S0 to S3 some 15, and about ten "
            "times as long in physics (--world mujoco)."
        )
    return "The time depends on the domain."


def _code(run: StoredRun) -> str:
    """The options that name the user's code of a run, as opening a run imports none by itself."""
    spec = run.settings.domain
    domain = f" --domain {spec}" if is_code(spec) else ""
    return domain + "".join(f" --actions {name}" for name in run.settings.actions if ":" in name)

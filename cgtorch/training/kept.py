"""The best skill so far of a stage that is interrupted, which lies beside its journal."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress

from cgtorch.graphs import Skill, load_skill, merged, save_skill
from cgtorch.ground import distributed as ranks
from cgtorch.ground.errors import CgtorchError
from cgtorch.ground.files import writing
from cgtorch.improvement.checkpoint import Kept
from cgtorch.runs.journal import FOLDER
from cgtorch.runs.log import read_log
from cgtorch.runs.stored_run import SKILL, StoredRun
from cgtorch.runs.writer import place_now
from cgtorch.training.tally import Tally


def kept_skill(run: StoredRun, stage: str, name: str) -> Kept | None:
    """The best skill of an interrupted stage, whose journal has this name, and how far it was.

    None if there is none, or it is damaged. How far the stage was is what the log tells of it since
    it last found no skill.
    """
    path = run.folder / FOLDER / name / SKILL
    if not path.is_file():
        return None
    generations = episodes = 0
    for row in read_log(run.folder):
        if row.get("stage") == stage:
            if row["event"] == "failed":
                generations = episodes = 0
            generations += row["event"] == "generation"
            episodes = row["episodes"] if row["event"] == "mean" else episodes
    with suppress(CgtorchError):
        return Kept(load_skill(path, run.actions), generations, episodes)
    return None


@contextmanager
def best_at_hand(run: StoredRun, name: str, tally: Tally, kept: Kept | None) -> Iterator[None]:
    """A context that an interruption leaves with the best skill so far beside the journal.

    The one that is `kept` there stays while the search has not come as far again. A run that was
    moved has it in its new place.
    """
    try:
        yield
    except BaseException:
        skill, fittest = tally.skill, tally.champion
        if skill is None and fittest is not None:
            skill = Skill(name, merged(fittest.graphs), run.actions, run.settings.max_transitions)
        behind = kept is not None and kept.ahead_of(tally.generations, tally.episodes)
        if skill is not None and not behind and ranks.first() and (place := place_now(run.folder)):
            folder = place / FOLDER / name
            with writing(folder):
                folder.mkdir(parents=True, exist_ok=True)
            save_skill(folder / SKILL, skill)
        raise

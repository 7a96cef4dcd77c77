"""What a run knows before its first stage: data, labels, Γ and C (section V)."""

import time
from typing import Any

from torch import Generator

from cgtorch.domains.knowledge import fit_models
from cgtorch.domains.transition import TransitionModel
from cgtorch.evolution.islands import generator_of
from cgtorch.ground import distributed as ranks
from cgtorch.ground.files import whole_folder
from cgtorch.improvement.events import ModelsFitted
from cgtorch.improvement.setup import Progress
from cgtorch.runs.storage import load_progress, save_progress
from cgtorch.training.context import Training

OWN = 40  # the generator of what C is judged by, derived like an island's


def initial_progress(training: Training) -> Progress[Any]:
    """Data, labels and models before the first stage, made once and kept in the run.

    A run whose skills are evolved in the world itself has none. What can be done side by side is,
    where compiled code may use more than one thread.
    """
    run, working = training.run, training.working
    nothing = run.like()
    if not run.learns:
        return Progress(None, nothing, nothing, None)
    start = run.folder / "start"
    if start.is_dir():
        return load_progress(run, start)
    settings, domain, kind = run.settings, run.domain, run.kind
    generator = Generator().manual_seed(settings.seed)
    with working("acting at random and testing success"):
        dataset = domain.explore(kind, settings.transitions, settings.labels, generator)
    own = generator_of(generator, OWN)

    def fresh(gamma: TransitionModel) -> Any:
        return domain.try_transition(kind, gamma, settings.labels, generator)

    began = time.perf_counter()
    with working("fitting both models, trying the transition model"):
        # Several ranks share out work in the world, which forked processes cannot.
        alone = ranks.count() > 1
        knowledge, found = fit_models(domain, dataset, settings.seed, fresh, alone)
    seconds = time.perf_counter() - began
    with working("trying the success classifier"):
        summary = domain.summary(kind, knowledge, found, own)
    training.watch(ModelsFitted("start", summary, seconds))
    progress = Progress(None, nothing, nothing, knowledge)
    if ranks.first():
        with whole_folder(start) as folder:
            save_progress(folder, progress, settings.seed)
    return progress

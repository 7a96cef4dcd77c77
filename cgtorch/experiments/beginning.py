"""What a run knows before its first stage: data, labels, Γ and C (section V)."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TypeAlias

from torch import Generator

from cgtorch import ranks
from cgtorch.data import collect, domain_of
from cgtorch.evolution.islands import generator_of
from cgtorch.experiments.progress import load_progress, save_progress
from cgtorch.experiments.run import Run, whole_folder
from cgtorch.improvement.events import ModelsFitted, Watch
from cgtorch.improvement.knowledge import fit_models_meanwhile
from cgtorch.improvement.setup import Progress
from cgtorch.models import (
    FreshLabels,
    TransitionModel,
    TransitionQuality,
    fresh_labels,
    success_quality,
    transition_quality,
)
from cgtorch.world import Scenarios, stage_scenarios

FRESH_TRANSITIONS = 1500  # which tell the models' errors
FRESH_LABELS = 500  # at most, as many as were learnt from
OWN = 40  # the generator of what C is judged by, derived like an island's

Working: TypeAlias = Callable[[str], AbstractContextManager[None]]
"""Makes a context in which a long step runs under a message."""


def beginning(run: Run, watch: Watch, working: Working) -> Progress[Scenarios]:
    """Data, labels and models before the first stage, made once and kept in the run.

    What can be done side by side is, where compiled code may use more than one thread.
    """
    start = run.folder / "start"
    if start.is_dir():
        return load_progress(run, start)
    settings, domain = run.settings, domain_of(run.settings.scenarios)
    generator = Generator().manual_seed(settings.seed)
    with working("driving at random and trying grasps"):
        dataset = collect(run.world_of, settings.transitions, settings.labels, generator, domain)
    count, own = min(FRESH_LABELS, settings.labels), generator_of(generator, OWN)

    def fresh(gamma: TransitionModel) -> tuple[TransitionQuality, FreshLabels]:
        world_of, rows = run.world_of, FRESH_TRANSITIONS
        quality = transition_quality(world_of, gamma, rows, generator, domain)
        return quality, fresh_labels(world_of, count, generator, domain)

    began = time.perf_counter()
    with working("fitting both models, trying the transition model"):
        # Several ranks share out grasps, which forked processes cannot.
        alone = ranks.count() > 1
        knowledge, (quality, labels) = fit_models_meanwhile(dataset, settings.seed, fresh, alone)
    seconds = time.perf_counter() - began
    with working("trying the success classifier on fresh labels"):
        judged = success_quality(run.world_of, knowledge.classifier, labels, own, domain)
    watch(ModelsFitted("start", knowledge, seconds, quality, judged))
    nothing = stage_scenarios("near", 0)
    progress = Progress(None, nothing, nothing, knowledge)
    if ranks.first():
        with whole_folder(start) as folder:
            save_progress(folder, progress, settings.seed)
    return progress

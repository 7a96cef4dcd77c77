"""Journals: how a stage that was interrupted goes on as if nothing had happened.

Everything here depends on seeds alone, so a stage that is made again does the same again. A journal
holds what its long steps came to, in their order, each with the state of the random numbers after
it. Made again, the stage reads them instead of computing them, and goes on computing where the
journal ends. Of an evolution there is, too, a checkpoint: where it stood a while ago.
"""

from torch import Tensor

from cgtorch.improvement.checkpoint import Checkpoint


class Journal:
    """What a stage has done so far, told in the order in which it was done; this one keeps nothing.

    `cgtorch.runs.journal.FileJournal` keeps it in files.
    """

    def recall(self, step: str) -> dict[str, Tensor] | None:
        """What the next step came to; None if it has not ended yet.

        Args:
            step: what the step is; the stage asks for its steps in the order it took them.

        Raises:
            RunError: the journal says that another step came next.
        """
        return None

    def record(self, step: str, result: dict[str, Tensor]) -> None:
        """Keep what a step that was not recalled has come to."""

    def recall_checkpoint(self, step: str) -> Checkpoint | None:
        """Where the next step stood when it was interrupted; None if that was not kept."""
        return None

    def record_checkpoint(self, step: str, checkpoint: Checkpoint) -> None:
        """Keep where a step stands, unless that was kept a moment ago; all ranks call it."""

"""Draw the pictures of the README from runs/reference."""

from pathlib import Path

import torch

from cgtorch.report import draw_skill
from cgtorch.runs.chosen import last_skill
from cgtorch.training.evaluate import evaluate_skill

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    """Write docs/images/skill.png and docs/images/table.png."""
    run, skill = last_skill(ROOT / "runs" / "reference")
    images = ROOT / "docs" / "images"
    images.mkdir(parents=True, exist_ok=True)
    draw_skill(skill).savefig(images / "skill.png", dpi=80)
    score = evaluate_skill(skill, run.domain, "perimeter", 200, 5)
    nothing = torch.zeros_like(score.succeeded)
    picture = run.pictures.scenarios(score.scenarios, score.succeeded, nothing)
    assert picture is not None  # noqa: S101  of a tabletop there is one
    picture.savefig(images / "table.png", dpi=80)


if __name__ == "__main__":
    main()

"""Draw the pictures of the README from runs/reference."""

from pathlib import Path

from cgtorch.training.evaluate import evaluate_skill
from cgtorch.runs.run import last_skill
from cgtorch.report import draw_skill, draw_table_top

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    """Write docs/images/skill.png and docs/images/table.png."""
    run, skill = last_skill(ROOT / "runs" / "reference")
    images = ROOT / "docs" / "images"
    images.mkdir(parents=True, exist_ok=True)
    draw_skill(skill).savefig(images / "skill.png", dpi=80)
    score = evaluate_skill(skill, run.world_of, "perimeter", 200, 5)
    footprint = run.robot.description.footprint
    picture = draw_table_top(score.scenarios, score.succeeded, footprint=footprint)
    picture.savefig(images / "table.png", dpi=80)


if __name__ == "__main__":
    main()

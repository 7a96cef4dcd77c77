import re
from pathlib import Path

from chromium import served, visit
from playwright.sync_api import Browser, expect
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"


def test_tensorboard_draws_the_scalars_of_a_run(chromium: Browser) -> None:
    written = EventAccumulator(str(REFERENCE))
    written.Reload()
    tags = [tag for tag in written.Tags()["scalars"] if tag.startswith(("fitness/", "solved/"))]
    assert sorted(tags) == ["fitness/best", "fitness/mean", "solved/M", "solved/W"]
    words = ("tensorboard.main", "--logdir", str(REFERENCE), "--host", "127.0.0.1", "--port", "0")
    with served(*words) as url, visit(chromium, f"{url}#scalars&tagFilter=fitness%7Csolved") as at:
        for tag in tags:
            card = at.page.locator("tf-scalar-card").filter(
                has=at.page.get_by_text(f"tag: {tag}", exact=True)
            )
            line = card.first.locator("path.line").first
            card.first.scroll_into_view_if_needed()
            # A corner for each generation, but for those that are outside the picture.
            corners = len(written.Scalars(tag)) * 3 // 4
            expect(line).to_have_attribute("d", re.compile(rf"^M[^L]+(L[^L]+){{{corners},}}$"))
        assert at.errors == []

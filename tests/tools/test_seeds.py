"""Seeds of tools: a first one, and one past the last."""

import click
import pytest
from click.testing import CliRunner
from options.seeds import seeds_option


@click.command()
@seeds_option("0:3")
def command(seeds: range) -> None:
    click.echo(list(seeds))


@pytest.mark.parametrize(("words", "said"), [((), "[0, 1, 2]"), (("--seeds", "20:22"), "[20, 21]")])
def test_the_second_number_is_past_the_last(words: tuple[str, ...], said: str) -> None:
    assert CliRunner().invoke(command, words).output.strip() == said


@pytest.mark.parametrize("value", ["5", "a:b", "1:2:3", "3:3", "4:2", "-1:2"])
def test_what_holds_no_seeds_is_refused(value: str) -> None:
    found = CliRunner().invoke(command, ["--seeds", value])
    assert found.exit_code == 2
    assert value in found.output

"""Every message is one printable line of bounded length, whatever it quotes."""

import pytest

from cgtorch.ground.errors import BEGINNING, END, CgtorchError, RunError


@pytest.mark.parametrize("kind", [CgtorchError, *CgtorchError.__subclasses__()])
def test_what_a_file_says_cannot_reach_the_terminal(kind: type[CgtorchError]) -> None:
    said = str(kind("name is \x1b[2J\n\ud800\u2028; give another"))
    assert said == r"name is \x1b[2J\n\ud800\u2028; give another"
    assert said.encode().decode().isprintable()


def test_of_a_long_message_stays_what_is_wrong_and_what_to_do() -> None:
    said = str(RunError(f"name is {'x' * 10**6}; give a shorter one"))
    assert said.startswith("name is xxx")
    assert said.endswith("xxx; give a shorter one")
    assert len(said) == BEGINNING + END + 3
    assert str(RunError("Γ holds é; restore it")) == "Γ holds é; restore it"
    assert str(RunError()) == ""

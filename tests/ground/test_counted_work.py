"""What is counted is told to whoever listens, and to nobody else."""

from cgtorch.ground.processes import counted, listening


def test_a_listener_is_told_from_the_beginning_to_the_end() -> None:
    told: list[tuple[str, int, int]] = []
    with listening(lambda *given: told.append(given)):
        more = counted("grasps", 5)
        more(2)
        more(4)
    assert told == [("grasps", 0, 5), ("grasps", 2, 5), ("grasps", 5, 5)]


def test_nobody_listens_outside() -> None:
    told: list[str] = []
    more = counted("grasps", 2)
    more(1)
    with listening(lambda what, done, total: told.append("outer")):
        with listening(lambda what, done, total: told.append("inner")):
            counted("motions", 1)
        more(1)
    more(1)
    assert told == ["inner", "outer"]

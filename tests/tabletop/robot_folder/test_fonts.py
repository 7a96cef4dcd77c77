"""Names in other writings are drawn without a word, with a font that has them if there is one."""

import warnings
from types import SimpleNamespace

from matplotlib import rcParams

from cgtorch.tabletop.robot_folder import fonts
from cgtorch.tabletop.robot_folder.fonts import fonts_for, without_glyph_warnings


def test_a_font_with_what_the_usual_one_lacks_is_added(monkeypatch):
    usual = list(rcParams["font.family"])
    assert fonts_for("arm") == usual
    known = {"a.ttf": set(map(ord, "腕")), "b.ttf": set(map(ord, "右腕")), "c.ttf": set()}
    files = [SimpleNamespace(fname=name, name=name[0]) for name in known]
    monkeypatch.setattr(fonts, "fontManager", SimpleNamespace(ttflist=files))
    monkeypatch.setattr(fonts, "_characters", lambda file: known.get(file, {ord("x")}))
    assert fonts_for("x右腕") == [*usual, "b"]
    assert fonts_for("x左") == usual
    assert fonts_for("x") == usual


def test_a_font_that_cannot_be_read_has_no_characters(tmp_path):
    (tmp_path / "broken.ttf").write_bytes(b"no font")
    assert fonts._characters(str(tmp_path / "broken.ttf")) == set()
    assert fonts._characters(str(tmp_path / "none.ttf")) == set()


def test_a_missing_glyph_is_no_warning():
    with warnings.catch_warnings(record=True) as caught, without_glyph_warnings():
        warnings.warn("Glyph 21488 (\\N{CJK}) missing from font(s) DejaVu Sans.", stacklevel=1)
    assert not caught

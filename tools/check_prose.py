"""Check README, documentation, help texts and public docstrings against docs/style.md.

    python tools/check_prose.py

Prints each sentence that breaks a rule, with its place, and exits with 1 if there is one.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST = 45
"""Words that a sentence may have."""
PRIVATE = {
    r"\bthe house\b": "say architecture, package or project",
    r"\bhouse style\b": "say code style",
    r"\bas one looks at it\b": "say what is done with it",
    r"\bwhat is not Γ\b": "say overhead outside model inference",
    r"\bmodels promise\b|\bpromises? (?:are|is|was|were) kept\b": "say robust success",
    r"\bits crew\b|\bfound standing\b": "use the field's word",
    r"\bnobody wrote here\b|\bnobody here wrote\b": "say independent",
    r"\bit says which,? too\b": "say what is selected",
    r"\ba first one and one after\b": "say initial population, and after ten generations",
    r"\bwhere nothing else is said\b": "say unless noted otherwise",
    r"\bwhat one (?:sees|begins|looks)\b": "name the thing",
}
"""Private words and riddles, and what to say in their place."""
OPENING = re.compile(r"(?:At the end of this page|After reading (?:it|this page)|This page)\b")
NO_OPENING = {"index.md", "changelog.md", "contributing.md"}


def main() -> None:
    """Check everything."""
    found = [*in_pages(), *in_docstrings(), *in_helps()]
    print("\n".join(found) or "prose: no findings")
    sys.exit(1 if found else 0)


def in_pages() -> Iterator[str]:
    """What is wrong in the pages."""
    for page in [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *sorted((ROOT / "docs").rglob("*.md")),
    ]:
        where, text = page.relative_to(ROOT), page.read_text()
        if page.name == "style.md":
            continue  # it quotes what is wrong
        history = "decisions" in where.parts
        prose = re.sub(r"```.*?```|<!--.*?-->|^(?:    .*|\|.*)$", "\n", text, flags=re.S | re.M)
        yield from in_prose(str(where), prose, LONGEST)
        if "docs" in where.parts and page.name not in NO_OPENING:
            beginning = text.partition("\n## ")[0]
            if not history and not OPENING.search(beginning):
                yield f"{where}: does not begin with what the reader has at its end"


def in_docstrings() -> Iterator[str]:
    """What is wrong in docstrings of public things."""
    for path in sorted((ROOT / "cgtorch").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                text = ast.get_docstring(node) or ""
                name = getattr(node, "name", "")
                if text and not name.startswith("_"):
                    yield from in_prose(f"{path.relative_to(ROOT)} {name}", text, 2 * LONGEST)


def in_helps() -> Iterator[str]:
    """What is wrong in the help of options: it has to be one or more sentences."""
    for path in [*(ROOT / "cgtorch" / "commands").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            named = isinstance(node, ast.keyword) and node.arg == "help"
            if named and isinstance(node.value, ast.Constant):
                text = str(node.value.value)
                if not re.search(r"\.(?:  \[.*\])?$", text):
                    yield f"{path.relative_to(ROOT)}: help {text!r} is no sentence"


def in_prose(where: str, text: str, longest: int) -> Iterator[str]:
    """Private words and long sentences of a text."""
    for pattern, advice in PRIVATE.items():
        for match in re.finditer(pattern, " ".join(text.split()), re.IGNORECASE):
            yield f"{where}: {match[0]!r}: {advice}"
    for paragraph in re.split(r"\n\s*(?:\n|[-*] |\d+\. |:   )", text):
        for sentence in re.split(r"(?<=[.!?:;])\s+", " ".join(paragraph.split())):
            words = len(re.findall(r"[A-Za-zΓ]\S*", re.sub(r"`[^`]*`|\]\([^)]*\)", "x", sentence)))
            if words > longest:
                yield f"{where}: {words} words in one sentence: {sentence[:60]}…"


if __name__ == "__main__":
    main()

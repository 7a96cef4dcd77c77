"""The changes of a C file that tests should notice, found by patterns.

The sources write operators with a space on each side, and pointers without one behind the star.
"""

import re
from itertools import accumulate

from mutants.edits import Edit

OPERATORS = {
    "<": "<= >", "<=": "< >", ">": ">= <", ">=": "> <", "==": "!=", "!=": "==", "&&": "||",
    "||": "&&", "+": "-", "-": "+", "*": "/", "/": "*", "%": "*", "+=": "-=", "-=": "+=",
    "*=": "/=", "/=": "*=", "&": "|", "|": "&", "<<": ">>", ">>": "<<", "&=": "|=", "|=": "&=",
}  # fmt: skip
_OPERATOR = re.compile(
    rf"(?<= )({'|'.join(map(re.escape, sorted(OPERATORS, key=len)[::-1]))})(?= )"
)
_NUMBER = re.compile(r"(?<![\w.])(\d+\.\d+|\d+)(?![\w.])")
_ROOM = re.compile(
    r"\b(?!return\b|else\b|case\b)\w+ (?:restrict )?\*?(?:restrict )?\w+(?:\[[^\]]*\])*"
    r"(?:, \*?\w+(?:\[[^\]]*\])*)*\[$"
)
"""Before the size of an array that is declared: larger ones change nothing."""
_NEGATION = re.compile(r"(?<![\w)\]])(!|~|-)(?=[\w(])")
_DECLARED = r"\w+ \*?\w+[ ;\[]|const "
_STATEMENT = re.compile(rf"^\s++(?!return|goto|break|continue|for \(|{_DECLARED})([^{{]*;)$")
_LEAVE = re.compile(r"\b(break|continue)(?=;)")
_STEP = re.compile(r"(\+\+|--)")
_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*|\"(?:[^\"\\\n]|\\.)*\"", re.DOTALL)
_BODY = re.compile(r"^(?!typedef|#)[^\n;]*\{\n.*?^\}", re.DOTALL | re.MULTILINE)


def c_edits(source: bytes) -> list[Edit]:
    """Every change of the bodies of functions of a file; not each of them compiles."""
    text = source.decode()
    bare = _COMMENT.sub(lambda m: re.sub(r"[^\n]", " ", m[0]), text)
    inside = {
        number
        for body in _BODY.finditer(bare)
        for number in range(bare.count("\n", 0, body.start()) + 1, bare.count("\n", 0, body.end()))
    }
    starts = [0, *accumulate(len(line) for line in text.splitlines(keepends=True))]
    found = []
    for number, line in enumerate(bare.splitlines()):
        if number in inside and not line.lstrip().startswith("#"):
            for first, last, new in _in_line(line):
                edit = starts[number] + first, starts[number] + last
                start = len(text[: edit[0]].encode())
                found.append(Edit(start, start + len(text[edit[0] : edit[1]].encode()), new))
    return found


def _in_line(line: str) -> list[tuple[int, int, str]]:
    """Changes of a line without comments and texts: first and last column, and the new text."""
    found = [
        (*match.span(1), new)
        for match in _OPERATOR.finditer(line)
        for new in OPERATORS[match[1]].split()
    ]
    for match in _NUMBER.finditer(line):
        if _ROOM.search(line[: match.start()]):
            continue
        whole = "." not in match[1]
        new = {"0": "1", "1": "0"}.get(match[1], str(int(match[1]) + 1)) if whole else ""
        found.append((*match.span(1), new or str(2 * float(match[1]) or 1.0)))
    found += [(*match.span(1), "") for match in _NEGATION.finditer(line)]
    swapped = {"break": "continue", "continue": "break", "++": "--", "--": "++"}
    for pattern in (_LEAVE, _STEP):
        found += [(*match.span(1), swapped[match[1]]) for match in pattern.finditer(line)]
    if (match := _STATEMENT.search(line)) and line.count("(") == line.count(")"):
        found.append((*match.span(1), ";"))
    return found

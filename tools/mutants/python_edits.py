"""The changes of a Python file that tests should notice, found by its syntax tree.

Numbers of a module, a class or a default other than 0 and 1 were chosen by measurements. They stay,
as tests that know them would only repeat them.
"""

import ast
import re
from itertools import accumulate, pairwise

from mutants.edits import Edit

COMPARISONS: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", "<= >"), ast.LtE: ("<=", "< >"), ast.Gt: (">", ">= <"), ast.GtE: (">=", "> <"),
    ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.Is: ("is", "is_not"),
    ast.IsNot: ("is not", "is"), ast.In: ("in", "not_in"), ast.NotIn: ("not in", "in"),
}  # fmt: skip
ARITHMETIC: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"), ast.Mod: ("%", "*"), ast.Pow: ("**", "*"),
    ast.BitAnd: ("&", "|"), ast.BitOr: ("|", "&"), ast.BitXor: ("^", "&"),
    ast.LShift: ("<<", ">>"), ast.RShift: (">>", "<<"),
}  # fmt: skip
OPPOSITES = [
    ("any", "all"), ("min", "max"), ("amin", "amax"), ("argmin", "argmax"), ("floor", "ceil"),
    ("minimum", "maximum"), ("zeros", "ones"), ("zeros_like", "ones_like"),
]  # fmt: skip
NAMES = {**dict(OPPOSITES), **{b: a for a, b in OPPOSITES}}
TRUTHS = (ast.Compare, ast.BoolOp, ast.UnaryOp)


def python_edits(source: bytes) -> list[Edit]:
    """Every change of a file."""
    finder = _Finder(source)
    finder.visit(ast.parse(source))
    return finder.found


class _Finder(ast.NodeVisitor):
    """Collects changes; annotations, decorators, texts, imports and assertions stay."""

    def __init__(self, source: bytes) -> None:
        self.source = source
        self.lines = [0, *accumulate(len(line) for line in source.splitlines(keepends=True))]
        self.found: list[Edit] = []
        self.truth = False  # whether the function returns a bool
        self.inside = False  # a function, and not among the figures of a module or class

    def place(self, node: ast.AST) -> tuple[int, int]:
        start = self.lines[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        return start, self.lines[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]

    def replace(self, node: ast.AST, text: str) -> None:
        self.found.append(Edit(*self.place(node), text))

    def between(self, left: ast.AST, right: ast.AST, old: str, new: str) -> None:
        """Replace an operator between two operands."""
        start, end = self.place(left)[1], self.place(right)[0]
        gap = re.sub(rb"#[^\n]*", lambda m: b" " * len(m[0]), self.source[start:end])
        pattern = re.escape(old) if not old[0].isalpha() else rf"\b{old}\b".replace(" ", r"\s+")
        if match := re.search(pattern.encode(), gap):
            self.found.append(Edit(start + match.start(), start + match.end(), new))

    def wrapped(self, node: ast.expr) -> None:
        """A condition is turned into its opposite."""
        start, end = self.place(node)
        self.replace(node, f"(not ({self.source[start:end].decode()}))")

    def visit_Compare(self, node: ast.Compare) -> None:
        operands = [node.left, *node.comparators]
        for (left, right), kind in zip(pairwise(operands), node.ops, strict=True):
            old, others = COMPARISONS[type(kind)]
            for new in others.split():
                self.between(left, right, old, new.replace("_", " "))
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        text = isinstance(node.left, ast.JoinedStr) or isinstance(node.right, ast.JoinedStr)
        for side in (node.left, node.right):
            text |= isinstance(side, ast.Constant) and isinstance(side.value, str | bytes)
        numbers = isinstance(node.left, ast.Constant) and isinstance(node.right, ast.Constant)
        if type(node.op) in ARITHMETIC and not text and (self.inside or not numbers):
            self.between(node.left, node.right, *ARITHMETIC[type(node.op)])
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        if type(node.op) in ARITHMETIC:
            old, new = ARITHMETIC[type(node.op)]
            self.between(node.target, node.value, f"{old}=", f"{new}=")
        self.replace(node, "pass")
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in pairwise(node.values):
            self.between(left, right, old, new)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if not isinstance(node.op, ast.UAdd):
            start = self.place(node)[0]
            sign = re.compile(rb"not\s+|not\b|.").match(self.source, start)
            self.found.append(Edit(start, sign.end() if sign else start, ""))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, bool):
            self.replace(node, str(not node.value))
        elif not self.inside and node.value not in (0, 1):
            return  # it was chosen by measurements, and tests need not know it
        elif isinstance(node.value, int):
            self.replace(node, {0: "1", 1: "0"}.get(node.value, str(node.value + 1)))
        elif isinstance(node.value, float):
            self.replace(node, {0.0: "1.0", 1.0: "2.0"}.get(node.value, repr(node.value * 2)))

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else None
        name = node.func.id if isinstance(node.func, ast.Name) else name
        if name in NAMES:
            end = self.place(node.func)[1]
            self.found.append(Edit(end - len(name), end, NAMES[name]))
        for word in node.keywords:
            start, end = self.place(word)
            if word.arg == "strict":
                continue
            if word.arg and (comma := re.match(rb"\s*,\s*", self.source[end:])):
                self.found.append(Edit(start, end + comma.end(), ""))
            elif word.arg:
                before = re.search(rb"(,\s*)?$", self.source[:start])
                self.found.append(Edit(before.start() if before else start, end, ""))
        self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg != "strict":  # of zip, which is an assertion
            self.generic_visit(node)

    def visit_condition(self, node: ast.If | ast.IfExp | ast.While) -> None:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return
        if not isinstance(node.test, TRUTHS):
            self.wrapped(node.test)
        self.generic_visit(node)

    visit_If = visit_IfExp = visit_While = visit_condition  # noqa: N815  names of ast

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            if not isinstance(test, TRUTHS):
                self.wrapped(test)
        self.generic_visit(node)

    def visit_Return(self, node: ast.Return) -> None:
        if node.value is not None and self.truth:
            self.wrapped(node.value)
        self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.replace(node, "pass")
            self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> None:
        self.replace(node, "pass")

    def visit_Assign(self, node: ast.Assign) -> None:
        if not any(isinstance(target, ast.Name | ast.Tuple) for target in node.targets):
            self.replace(node, "pass")
        self.generic_visit(node)

    def visit_Break(self, node: ast.Break) -> None:
        self.replace(node, "continue")

    def visit_Continue(self, node: ast.Continue) -> None:
        self.replace(node, "break")

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        for default in [*node.args.defaults, *filter(None, node.args.kw_defaults)]:
            self.visit(default)
        outer = self.truth, self.inside
        self.truth, self.inside = getattr(node.returns, "id", "") == "bool", True
        for part in node.body:
            self.visit(part)
        self.truth, self.inside = outer

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for part in node.body:
            self.visit(part)

    def leave(self, node: ast.AST) -> None:
        """Nothing in here changes."""

    visit_Assert = visit_JoinedStr = visit_Import = visit_ImportFrom = leave  # noqa: N815

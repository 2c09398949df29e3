"""Mutants of a Python source: copies in which one place is changed, each of which some test should notice.

| what | changed to |
|---|---|
| comparison | ``<`` to ``<=`` and ``>=``, ``==`` to ``!=``, ``in`` to ``not in``, ``is`` to ``is not``, and back |
| arithmetic | ``+`` and ``-``, ``*`` and ``/``, ``//`` to ``/``, ``%`` to ``*``, ``**`` to ``*``, ``&`` and ``|`` |
| number | a whole number plus 1, any other doubled, 0.0 to 1.0; True and False |
| function | min and max, minimum and maximum, any and all, zeros and ones, floor and ceil, argmin and argmax |
| sign | ``-``, ``not`` and ``~`` left out |
| logic | ``and`` and ``or`` |
| condition | of an if, a while, a conditional expression or a comprehension: negated |
| statement | left out: a call, an assignment in place or to a bound name, raise, continue, break, an early return |

Texts are left alone, and so are annotations, decorators, imports, what stands inside a ``raise``, and guards that no
test is meant to reach: assertions and ``strict`` of zip.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

COMPARISONS = {
    "<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"), "==": ("!=",), "!=": ("==",),
    "in": ("not in",), "not in": ("in",), "is": ("is not",), "is not": ("is",),
}  # fmt: skip
ARITHMETIC = {
    "+": "-", "-": "+", "*": "/", "/": "*", "//": "/", "%": "*", "**": "*", "&": "|", "|": "&", "<<": ">>", ">>": "<<",
}  # fmt: skip
FUNCTIONS = [
    ("min", "max"), ("minimum", "maximum"), ("any", "all"), ("zeros", "ones"), ("zeros_like", "ones_like"),
    ("floor", "ceil"), ("argmin", "argmax"),
]  # fmt: skip
OTHER_FUNCTION = {a: b for pair in FUNCTIONS for a, b in (pair, pair[::-1])}
SYMBOLS = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.In: "in",
    ast.NotIn: "not in", ast.Is: "is", ast.IsNot: "is not", ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/",
    ast.FloorDiv: "//", ast.Mod: "%", ast.Pow: "**", ast.BitAnd: "&", ast.BitOr: "|", ast.LShift: "<<",
    ast.RShift: ">>", ast.And: "and", ast.Or: "or",
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One change of a module's source."""

    module: str
    """Path of the module from the root of the tree."""
    line: int
    what: str
    """Kind of change, as in the table above."""
    before: str
    """The lines changed, as they were and as they become, without indentation at their ends."""
    after: str
    source: bytes
    """The whole mutated module."""


@dataclass(frozen=True)
class _Edit:
    start: int
    end: int
    text: str
    what: str


def mutants_of(module: str, source: bytes) -> list[Mutant]:
    """All mutants of a module that are valid Python, in the order of their lines."""
    finder = _Finder(source)
    finder.block(ast.parse(source).body, None)
    found = []
    for edit in sorted(finder.edits, key=lambda e: (e.start, e.end, e.text)):
        mutated = source[: edit.start] + edit.text.encode() + source[edit.end :]
        try:
            compile(mutated, module, "exec", dont_inherit=True)
        except SyntaxError:
            continue
        first, last = source.rfind(b"\n", 0, edit.start) + 1, source.find(b"\n", edit.end)
        last = len(source) if last < 0 else last
        after = source[first : edit.start] + edit.text.encode() + source[edit.end : last]
        line = source.count(b"\n", 0, edit.start) + 1
        before = source[first:last].decode().strip()
        found.append(Mutant(module, line, edit.what, before, after.decode().strip(), mutated))
    return found


class _Finder(ast.NodeVisitor):
    """Collects the edits of a module; byte positions, as the syntax tree counts columns in bytes."""

    def __init__(self, source: bytes):
        self.source = source
        self.edits: list[_Edit] = []
        self._line_starts = [0, *(match.end() for match in re.finditer(b"\n", source))]

    def start(self, node: ast.expr | ast.stmt) -> int:
        return self._line_starts[node.lineno - 1] + node.col_offset

    def end(self, node: ast.expr | ast.stmt) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._line_starts[node.end_lineno - 1] + node.end_col_offset

    def edit(self, start: int, end: int, text: str, what: str) -> None:
        self.edits.append(_Edit(start, end, text, what))

    def between(self, left: ast.expr, right: ast.expr, symbol: str, becomes: str, what: str, suffix: str = "") -> None:
        """Change the operator between two expressions, among brackets and spaces."""
        first = self.end(left)
        pattern = re.escape(symbol + suffix).replace(r"\ ", r"\s+").encode()
        match = re.search(pattern, self.source[first : self.start(right)])
        if match:
            self.edit(first + match.start(), first + match.end(), becomes + suffix, what)

    # --- statements ------------------------------------------------------------------------------

    def block(self, body: list[ast.stmt], function: ast.FunctionDef | ast.AsyncFunctionDef | None) -> None:
        for statement in body:
            if _may_go(statement, function):
                self.edit(self.start(statement), self.end(statement), "pass", "statement")
            self.statement(statement, function)

    def statement(self, node: ast.stmt, function: ast.FunctionDef | ast.AsyncFunctionDef | None) -> None:
        if isinstance(node, ast.Raise | ast.Assert | ast.Import | ast.ImportFrom | ast.Global | ast.Nonlocal):
            return
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for default in (*node.args.defaults, *node.args.kw_defaults):
                if default is not None:
                    self.visit(default)
            return self.block(node.body, node)
        if isinstance(node, ast.ClassDef):
            return self.block(node.body, None)
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'"):
            return None
        if isinstance(node, ast.If | ast.While):
            self.condition(node.test)
        if isinstance(node, ast.AugAssign):
            symbol = SYMBOLS.get(type(node.op), "")
            if symbol in ARITHMETIC:
                self.between(node.target, node.value, symbol, ARITHMETIC[symbol], "arithmetic", suffix="=")
        for name, field in ast.iter_fields(node):
            if name == "annotation":
                continue
            for part in field if isinstance(field, list) else [field]:
                if isinstance(part, ast.stmt):
                    self.block([part], function)
                elif isinstance(part, ast.ExceptHandler | ast.match_case):
                    self.block(part.body, function)
                elif isinstance(part, ast.withitem):
                    self.visit(part.context_expr)
                elif isinstance(part, ast.expr):
                    self.visit(part)
        return None

    # --- expressions -----------------------------------------------------------------------------

    def condition(self, test: ast.expr) -> None:
        single = isinstance(test, ast.Compare) and len(test.ops) == 1
        if single or isinstance(test, ast.Constant) or (isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not)):
            return  # negated by a change of its own
        first, last = self.start(test), self.end(test)
        self.edit(first, last, f"not ({self.source[first:last].decode()})", "condition")

    def visit_Compare(self, node: ast.Compare) -> None:
        sides = [node.left, *node.comparators]
        for left, op, right in zip(sides, node.ops, sides[1:], strict=False):
            symbol = SYMBOLS[type(op)]
            for becomes in COMPARISONS[symbol]:
                self.between(left, right, symbol, becomes, "comparison")
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        symbol = SYMBOLS.get(type(node.op), "")
        text = isinstance(node.left, ast.Constant | ast.JoinedStr) and not _is_number(node.left)
        if symbol in ARITHMETIC and not text:
            self.between(node.left, node.right, symbol, ARITHMETIC[symbol], "arithmetic")
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        symbol = SYMBOLS[type(node.op)]
        for left, right in zip(node.values, node.values[1:], strict=False):
            self.between(left, right, symbol, "or" if symbol == "and" else "and", "logic")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        first = self.start(node)
        match = re.match(rb"-|~|not\s+|not(?=\()", self.source[first:])
        if match:
            self.edit(first, first + match.end(), "", "sign")
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in OTHER_FUNCTION:
            last = self.end(node.func)
            self.edit(last - len(name), last, OTHER_FUNCTION[name], "function")
        for part in (node.func, *node.args, *(k.value for k in node.keywords if k.arg != "strict")):
            self.visit(part)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self.condition(node.test)
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            self.condition(test)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self.edit(self.start(node), self.end(node), str(not value), "number")
        elif isinstance(value, int):
            self.edit(self.start(node), self.end(node), str(value + 1), "number")
        elif isinstance(value, float):
            self.edit(self.start(node), self.end(node), repr(2.0 * value if value else 1.0), "number")

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """A text: left alone."""


def _is_number(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def _may_go(node: ast.stmt, function: ast.FunctionDef | ast.AsyncFunctionDef | None) -> bool:
    """Whether a module without this statement may still run to its end."""
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Call)
    if isinstance(node, ast.Raise | ast.Continue | ast.Break | ast.AugAssign):
        return True
    if isinstance(node, ast.Return):
        return function is not None and node is not function.body[-1]
    if isinstance(node, ast.Assign | ast.AnnAssign) and function is not None:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if node.value else []
        bound = {name for name, at in _bindings(function) if at < node.lineno}
        names = {name for target in targets for part in ast.walk(target) if (name := _stored(part))}
        return bool(targets) and names <= bound
    return False


def _stored(node: ast.AST) -> str:
    """The name that a node binds, or an empty text."""
    return node.id if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) else ""


def _bindings(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[tuple[str, int]]:
    """Names of a function's arguments and variables, with the lines where they are bound."""
    for node in ast.walk(function):
        if isinstance(node, ast.arg):
            yield node.arg, node.lineno - 1
        elif (name := _stored(node)) and isinstance(node, ast.Name):
            yield name, node.lineno

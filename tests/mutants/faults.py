"""Where a module can be wrong in a number, and its source with one such fault.

Faults change what a user would read: signs, operators, comparisons, constants, missing square
roots, forgotten negations. Words, types, docstrings and defaults of options are left alone.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

_SWAPPED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
#: Functions of one argument whose absence is a fault.
_DROPPED = {"abs", "sqrt", "exp", "log", "square", "sin", "cos", "cumsum", "radians", "deg2rad"}


@dataclass(frozen=True)
class Fault:
    """line : where; text : what is changed; source : the whole module with it"""

    line: int
    text: str
    source: str


def places(source: str) -> list[int]:
    """Numbers of a module's faults, for `fault`, in the order of its lines."""
    lines = [node.lineno for node, _, _ in _sites(ast.parse(source))]
    return sorted(range(len(lines)), key=lambda k: lines[k])


def fault(source: str, number: int) -> Fault:
    """One fault of a module."""
    tree = ast.parse(source)
    node, act, text = next(islice(_sites(tree), number, None))
    line = node.lineno
    act(node)
    return Fault(line, text, ast.unparse(ast.fix_missing_locations(tree)))


Site = tuple[ast.expr, Callable[[ast.expr], None], str]


def _sites(tree: ast.Module) -> Iterator[Site]:
    skipped = _words(tree)
    for node in ast.walk(tree):
        if not isinstance(node, ast.expr) or id(node) in skipped:
            continue
        if (isinstance(node, ast.BinOp) and type(node.op) in _SWAPPED) or isinstance(
            node, ast.BoolOp
        ):
            yield node, _operator, ast.unparse(node)
        elif isinstance(node, ast.Compare) and type(node.ops[0]) in _SWAPPED:
            yield node, _comparison, ast.unparse(node)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            yield node, _unary, ast.unparse(node)
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield node, _constant, ast.unparse(node)
        elif isinstance(node, ast.Call) and _name(node) in _DROPPED and len(node.args) == 1:
            yield node, _dropped, ast.unparse(node)


def _operator(node: ast.expr) -> None:
    assert isinstance(node, ast.BinOp | ast.BoolOp)
    node.op = _SWAPPED[type(node.op)]()  # type: ignore[assignment]


def _comparison(node: ast.expr) -> None:
    assert isinstance(node, ast.Compare)
    node.ops[0] = _SWAPPED[type(node.ops[0])]()  # type: ignore[assignment, call-overload]


def _unary(node: ast.expr) -> None:
    assert isinstance(node, ast.UnaryOp)
    node.op = ast.UAdd() if isinstance(node.op, ast.USub) else ast.Not()
    if isinstance(node.op, ast.Not):
        node.operand = ast.UnaryOp(ast.Not(), node.operand)


def _constant(node: ast.expr) -> None:
    assert isinstance(node, ast.Constant)
    value = node.value
    assert isinstance(value, int | float)
    node.value = value + 1 if isinstance(value, int) else (2.0 * value if value else 1.0)


def _dropped(node: ast.expr) -> None:
    """f(x) becomes x, in a call that stays: +(x)."""
    assert isinstance(node, ast.Call)
    node.func, node.args = ast.parse("(lambda x: x)", mode="eval").body, node.args


def _name(node: ast.Call) -> str:
    of = node.func
    return of.attr if isinstance(of, ast.Attribute) else of.id if isinstance(of, ast.Name) else ""


def _words(tree: ast.Module) -> set[int]:
    """Annotations, decorators, format specifications and messages of errors: no number there."""
    out: set[int] = set()
    for node in ast.walk(tree):
        some: list[ast.AST] = []
        if isinstance(node, ast.AnnAssign) or (isinstance(node, ast.arg) and node.annotation):
            some.append(node.annotation)
        elif isinstance(node, ast.FunctionDef):
            some += [*node.decorator_list, *([node.returns] if node.returns else [])]
        elif isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert):
            some.append(node)
        for part in some:
            out |= {id(inner) for inner in ast.walk(part)}
    return out

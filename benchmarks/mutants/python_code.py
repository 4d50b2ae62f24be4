"""The mutants of a Python file: Cosmic Ray's operators, one plausible change of each, and three of our own.

Code that changes no result is left out: annotations, decorators, imports, `assert` (which tells mypy a type), `raise` (error
texts have their own tests), `__repr__`, and operators that floats lack.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from mutants.mutant import Mutant, mutant

try:
    from cosmic_ray.ast import Visitor, get_ast
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator
except ImportError as missing:
    raise SystemExit('Mutants need the extra mutation: pip install "gelform[mutation]".') from missing

# `+` becomes `-` and so on; a comparison moves its boundary, or is reversed.
OPERATORS = [
    *(
        f"ReplaceBinaryOperator_{change}"
        for change in (
            *("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Mul", "Mod_FloorDiv", "Pow_Mul"),
            *("BitAnd_BitOr", "BitOr_BitAnd", "BitXor_BitOr"),
        )
    ),
    *(
        f"ReplaceComparisonOperator_{change}"
        for change in (
            *("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt", "Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is"),
            *("Lt_GtE", "LtE_Gt", "Gt_LtE", "GtE_Lt"),
        )
    ),
    *(
        "ReplaceUnaryOperator_USub_UAdd",
        "ReplaceUnaryOperator_Delete_Not",
        "ReplaceUnaryOperator_Delete_Invert",
    ),
    *("ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd", "AddNot"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop"),
]
LARGE = 20  # larger numbers are doubled and halved: 5,001 samples instead of 5,000 is no fault
SWAPPED = [
    *(("minimum", "maximum"), ("min", "max"), ("argmin", "argmax"), ("any", "all"), ("floor", "ceil")),
    *(("cos", "sin"), ("zeros", "ones"), ("zeros_like", "ones_like")),
]
DROPPED = {"abs", "sqrt", "clip", "maximum", "minimum", "max", "min", "exp", "log", "ceil", "floor", "hypot"}
SKIPPED_FUNCTIONS = {"__repr__", "__str__", "_repr_html_"}


def python_mutants(source: str) -> list[Mutant]:
    """Every mutant of a file's text, in the order of its lines."""
    tree = ast.parse(source)
    skipped = [*_skipped(tree)]
    found = [*_from_cosmic_ray(source), *_of_numbers(source, tree), *_of_calls(source, tree)]
    found += _of_statements(source, tree)
    kept = [
        mutant(source, changed, place[0], change)
        for place, change, changed in found
        if changed != source
        and not source.splitlines()[place[0] - 1][place[1] :].startswith("*,")  # of a signature
        and not any(start <= place < end for start, end in skipped)
        and _compiles(changed)
    ]
    return sorted(kept, key=lambda one: (one.line, one.change, one.after))


Found = tuple[tuple[int, int], str, str]  # (line, column), the operator's name, the changed text


class _Places(Visitor):
    """The places where an operator applies."""

    def __init__(self, operator: object) -> None:
        self.operator = operator
        self.places: list[tuple[int, int]] = []

    def visit(self, node: object) -> object:
        self.places += [start for start, _ in self.operator.mutation_positions(node)]
        return node


def _from_cosmic_ray(source: str) -> Iterator[Found]:
    for name in OPERATORS:
        operator = get_operator(f"core/{name}")()
        places = _Places(operator)
        places.walk(get_ast(source))
        for occurrence, place in enumerate(places.places):
            changed = mutate_code(source, operator, occurrence)
            if changed is not None:
                yield place, name, changed


def _of_numbers(source: str, tree: ast.AST) -> Iterator[Found]:
    """A number changes by 1; a large one is doubled and halved."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            value = node.value
            others = (value * 2, value // 2) if abs(value) > LARGE else (value + 1, value - 1)
            for other in others:
                yield _place(node), "Number", _replaced(source, node, repr(other))


def _of_calls(source: str, tree: ast.AST) -> Iterator[Found]:
    """`np.minimum` becomes `np.maximum`; `np.abs(x)` becomes `x`."""
    swapped = dict([*SWAPPED, *((after, before) for before, after in SWAPPED)])
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        if name in swapped:
            called = ast.get_source_segment(source, node.func) or ""
            yield (
                _place(node),
                "Function",
                _replaced(source, node.func, re.sub(rf"{name}$", swapped[name], called)),
            )
        if name in DROPPED and node.args:
            yield _place(node), "DropCall", _replaced(source, node, _argument(source, node))


def _argument(source: str, call: ast.Call) -> str:
    """The replacement of a call: its first argument, or the object of the method."""
    library = isinstance(call.func, ast.Name) or getattr(call.func.value, "id", "") in ("np", "cv2", "math")
    kept = call.args[0] if library else call.func.value
    return f"({ast.get_source_segment(source, kept)})"


def _of_statements(source: str, tree: ast.AST) -> Iterator[Found]:
    """A statement is removed: a call for its effect, an update in place, a second assignment to a name."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        bound = {argument.arg for argument in [*function.args.args, *function.args.kwonlyargs]}
        for node in _statements(function.body):
            if _can_go(node, bound):
                yield _place(node), "DropStatement", _replaced(source, node, "pass")
            bound |= {name.id for name in ast.walk(node) if isinstance(name, ast.Name)}


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    for node in body:
        yield node
        for inner in ("body", "orelse"):
            if not isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                yield from _statements(getattr(node, inner, []))


def _can_go(node: ast.stmt, bound: set[str]) -> bool:
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Call)
    if isinstance(node, ast.AugAssign):
        return True
    if not isinstance(node, ast.Assign):
        return False
    target = node.targets[0]
    return isinstance(target, ast.Subscript) or (isinstance(target, ast.Name) and target.id in bound)


def _skipped(tree: ast.AST) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Ranges of the text without mutants."""
    for node in ast.walk(tree):
        parts = [getattr(node, "annotation", None), getattr(node, "returns", None)]
        parts += getattr(node, "decorator_list", [])
        if isinstance(node, (ast.Raise, ast.Assert, ast.Import, ast.ImportFrom, ast.JoinedStr)):
            parts.append(node)
        if isinstance(node, ast.FunctionDef) and node.name in SKIPPED_FUNCTIONS:
            parts.append(node)
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "")[:1].isupper():
            parts += [node] if "TypeVar" in ast.dump(node.value) or "NDArray" in ast.dump(node.value) else []
        yield from (
            ((part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)) for part in parts if part
        )


def _place(node: ast.expr | ast.stmt) -> tuple[int, int]:
    return node.lineno, node.col_offset


def _replaced(source: str, node: ast.expr | ast.stmt, text: str) -> str:
    """The text with a node replaced; columns count bytes."""
    lines = [line.encode() for line in source.splitlines(keepends=True)]
    start = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    end = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    whole = b"".join(lines)
    return (whole[:start] + text.encode() + whole[end:]).decode()


def _compiles(source: str) -> bool:
    try:
        compile(source, "mutant", "exec")
    except (SyntaxError, ValueError):
        return False
    return True

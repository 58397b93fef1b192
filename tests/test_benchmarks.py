"""The options of the benchmarks: a quick look writes nothing, and nothing else is less than the whole."""

import ast
import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"
BENCHMARKS = sorted(path for path in FOLDER.glob("*.py") if "add_argument" in path.read_text())
WRITES = re.compile(r"\b(save|fill|write_text|savefig|insert|plot|tables)\(")
PARTS = {"--quick", "--only", "--tables", "--point", "--variant"}
"""Options that leave the documents alone, or write into them what the whole measurement finds."""


@pytest.mark.parametrize("path", BENCHMARKS, ids=lambda path: path.stem)
def test_no_option_writes_a_rough_result_into_the_documents(path):
    text = path.read_text()
    options = set(re.findall(r'add_argument\(\s*"(--[\w-]+)"', text))
    assert options <= PARTS
    if "--quick" in options and WRITES.search(text):
        assert _writes_under_quick(ast.parse(text)) == []


def _writes_under_quick(module: ast.Module) -> list[int]:
    """List the lines of the functions with the option where something is written though ``quick`` is set."""
    found = []
    for function in ast.walk(module):
        if (
            isinstance(function, ast.FunctionDef)
            and "quick" in ast.unparse(function)
            and function.name in ("main", "run")
        ):
            found += _unguarded(function.body)
    return found


def _unguarded(body: list[ast.stmt]) -> list[int]:
    lines: list[int] = []
    for statement in body:
        if isinstance(statement, ast.If) and re.fullmatch(r"not (arguments\.)?quick", ast.unparse(statement.test)):
            lines += _unguarded(statement.orelse)
            continue
        if isinstance(statement, ast.If) and re.fullmatch(r"(arguments\.)?quick", ast.unparse(statement.test)):
            lines += _unguarded(statement.body)
            if isinstance(statement.body[-1], ast.Return | ast.Continue):
                return lines  # the rest is not reached
            lines += _unguarded(statement.orelse)
            continue
        if isinstance(statement, ast.If) and ast.unparse(statement.test) == "arguments.tables":
            continue  # writes the tables from what is saved
        inner = [part for name in ("body", "orelse") for part in getattr(statement, name, [])]
        if inner:
            lines += _unguarded(inner)
        elif any(_writes(call) for call in ast.walk(statement) if isinstance(call, ast.Call)):
            lines.append(statement.lineno)
    return lines


def _writes(call: ast.Call) -> bool:
    """Tell whether a call writes a result: by its name, on its own or as a method."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    return name in ("save", "fill", "write_text", "savefig", "insert", "plot", "tables", "write_bytes")

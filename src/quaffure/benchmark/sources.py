"""The sources that a module's behaviour hangs on: its own, and those of the modules that it imports."""

import ast
import inspect
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import quaffure

PACKAGE = Path(quaffure.__file__).parent
ROOMS = ("geometry", "body", "hair", "scene", "energies", "model", "solvers", "baselines")
"""Parts of the package that decide where hair ends up; all others only bring, measure or show it."""
_PREFIXES = tuple(f"quaffure.{room}" for room in ROOMS)


@cache
def sources_of(module: str) -> tuple[tuple[str, str], ...]:
    """Name and source of a loaded module and of all modules of `ROOMS` that it imports, directly or not.

    Imports count wherever they stand, those inside of functions too. Sources come without comments and docstrings.
    """
    found = {module: inspect.getsource(sys.modules[module])}
    unread = [module]
    while unread:
        for name in _imported(found[unread.pop()]):
            if name not in found:
                found[name] = _path(name).read_text(encoding="utf-8")
                unread.append(name)
    return tuple(sorted((name, _without_words(source)) for name, source in found.items()))


def _without_words(source: str) -> str:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [line for line in node.body if not _is_bare_constant(line)]
    return ast.unparse(tree)


def _is_bare_constant(line: ast.stmt) -> bool:
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant)


def _imported(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):  # the package has no relative imports: ruff's TID252
            names = [f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)]
        yield from (name for name in names if name.startswith(_PREFIXES) and _path(name).is_file())


def _path(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py")

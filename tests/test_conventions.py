"""The conventions that a linter does not check: sizes of files and functions, weight of the assets, cheap imports."""

import ast
import builtins
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import quaffure

SOURCE = Path(__file__).parents[1] / "src" / "quaffure"
MODULES = sorted(SOURCE.rglob("*.py"))
MOST_LINES_OF_A_FILE, MOST_LINES_OF_A_FUNCTION, MOST_PARAMETERS = 400, 60, 8
MOST_ASSET_BYTES = 16_000_000
HEAVY = ("pxr", "alembic3d", "onnxruntime", "moderngl", "av", "anny", "igl", "trimesh", "PIL", "viser")


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    every = function.args
    names = [argument.arg for argument in (*every.posonlyargs, *every.args, *every.kwonlyargs)]
    return names[1:] if names[:1] in (["self"], ["cls"]) else names


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_files_and_functions_stay_small(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_LINES_OF_A_FILE
    for function in functions(path):
        assert (function.end_lineno or 0) - function.lineno < MOST_LINES_OF_A_FUNCTION, function.name
        assert len(parameters(function)) <= MOST_PARAMETERS, function.name


def fields_written(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[str]:
    """Fields of tuples whose elements a parallel kernel assigns itself: numba may drop that as dead code."""
    if not any("parallel=True" in ast.unparse(decorator) for decorator in function.decorator_list):
        return
    for node in ast.walk(function):
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
            array: ast.expr = node
            while isinstance(array, ast.Subscript):
                array = array.value
            if isinstance(array, ast.Attribute):
                yield ast.unparse(array)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_parallel_kernels_leave_fields_of_tuples_to_the_functions_that_they_call(path: Path) -> None:
    assert [name for function in functions(path) for name in fields_written(function)] == []


def test_assignments_to_fields_are_found() -> None:
    (function,) = ast.parse("@njit(parallel=True)\ndef f(a):\n    a.x[0][1] += 1\n    a.y[2], b = 1, a.z[3]").body
    assert isinstance(function, ast.FunctionDef)
    assert sorted(fields_written(function)) == ["a.x", "a.y"]


def test_assets_stay_light() -> None:
    sizes = {path.name: path.stat().st_size for path in (SOURCE / "assets").rglob("*") if path.is_file()}
    assert sum(sizes.values()) <= MOST_ASSET_BYTES, sizes
    assert sizes["body.npz"] <= 3_000_000


def imported(statement: str) -> set[str]:
    """Modules that a fresh interpreter holds after `statement`."""
    listing = subprocess.run(
        [sys.executable, "-c", f"{statement}\nimport sys\nprint(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(listing.stdout.split())


def test_importing_the_package_costs_next_to_nothing() -> None:
    loaded = imported("import quaffure")
    assert not {"torch", "numpy", "numba", "scipy", *HEAVY} & loaded
    assert {name for name in loaded if name.startswith("quaffure")} == {
        "quaffure",
        "quaffure._lazy",
    }


@pytest.mark.parametrize(
    "statement",
    [
        "import quaffure.apps.cli.main",
        "import quaffure as qf\nqf.load_groom, qf.load_body, qf.load_model, qf.HairEnergy",
    ],
)
def test_heavy_libraries_wait_until_they_are_needed(statement: str) -> None:
    loaded = imported(statement)
    assert "torch" in loaded
    assert not set(HEAVY) & loaded


def test_every_public_name_is_there() -> None:
    assert len(quaffure.__all__) <= 16
    for name in quaffure.__all__:
        assert getattr(quaffure, name).__doc__
    assert set(quaffure.__all__) <= set(dir(quaffure))
    with pytest.raises(AttributeError, match="no attribute 'magic'"):
        _ = quaffure.magic


def test_the_example_of_the_docstring_runs() -> None:
    code = (quaffure.__doc__ or "").split("\n\n", 1)[1]
    assert "qf.load_groom" in code
    names: dict[str, object] = {}
    exec(compile(code, "the docstring of quaffure", "exec"), names)
    assert tuple(names["hair"].shape)[::2] == (1, 24)  # type: ignore[attr-defined]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_errors_that_are_raised_are_imported(path: Path) -> None:
    """Neither ruff nor mypy looks names up, because axes of jaxtyping are none."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    known = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    known |= {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)} | {*dir(builtins)}
    raised = (node.exc for node in ast.walk(tree) if isinstance(node, ast.Raise))
    names = {each.func.id for each in raised if isinstance(each, ast.Call) and isinstance(each.func, ast.Name)}
    assert names - known == set()

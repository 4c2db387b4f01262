"""The conventions that a linter does not check: sizes of files and functions, weight of the assets, cheap imports."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import quaffure

SOURCE = Path(__file__).parents[1] / "src" / "quaffure"
MODULES = sorted(SOURCE.rglob("*.py"))
MOST_LINES_OF_A_FILE, MOST_LINES_OF_A_FUNCTION, MOST_PARAMETERS = 400, 60, 8
MOST_ASSET_BYTES = 12_000_000
HEAVY = ("pxr", "moderngl", "av", "anny", "igl", "trimesh", "PIL", "viser")

KERNELS_WITH_MANY_PARAMETERS = {}


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    every = function.args
    names = [argument.arg for argument in (*every.posonlyargs, *every.args, *every.kwonlyargs)]
    return names[1:] if names[:1] in (["self"], ["cls"]) else names


def is_kernel(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return any("njit" in ast.unparse(decorator) for decorator in function.decorator_list)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_files_and_functions_stay_small(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_LINES_OF_A_FILE
    module = str(path.relative_to(SOURCE))
    for function in functions(path):
        assert (function.end_lineno or 0) - function.lineno < MOST_LINES_OF_A_FUNCTION, function.name
        allowed = function.name in KERNELS_WITH_MANY_PARAMETERS.get(module, ())
        assert not allowed or is_kernel(function), f"{function.name} is no kernel: take it off the list"
        assert allowed or len(parameters(function)) <= MOST_PARAMETERS, function.name


def test_the_list_of_kernels_is_not_out_of_date() -> None:
    for module, names in KERNELS_WITH_MANY_PARAMETERS.items():
        many = {f.name for f in functions(SOURCE / module) if len(parameters(f)) > MOST_PARAMETERS}
        assert names == many, module


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
    assert {name for name in loaded if name.startswith("quaffure")} == {"quaffure", "quaffure._lazy"}


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
    assert len(quaffure.__all__) <= 12
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

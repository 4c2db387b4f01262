"""Packages export their public names lazily: for checkers and at run time the same names, from the same modules."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

from quaffure._lazy import lazy_exports

MOST_UNCHECKED = 20
SOURCE = Path(__file__).parents[1] / "src"
PACKAGES = sorted(
    ".".join(file.parent.relative_to(SOURCE).parts)
    for file in SOURCE.rglob("__init__.py")
    if "lazy_exports" in file.read_text(encoding="utf-8")
)


def folder(package: str) -> Path:
    return SOURCE.joinpath(*package.split("."))


def names_for_checkers(package: str) -> dict[str, str]:
    """Module of each name that `package` imports under TYPE_CHECKING."""
    tree = ast.parse((folder(package) / "__init__.py").read_text(encoding="utf-8"))
    (branch,) = (node for node in tree.body if isinstance(node, ast.If))
    return {
        alias.name: str(statement.module)
        for statement in branch.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }


def test_packages_export_names() -> None:
    assert {"quaffure", "quaffure.hair", "quaffure.body", "quaffure.procedural"} <= set(PACKAGES)


@pytest.mark.parametrize("package", PACKAGES)
def test_every_exported_name_exists(package: str) -> None:
    exporting = import_module(package)
    assert set(exporting.__all__) - {"__version__"} == set(names_for_checkers(package))
    for name, module in names_for_checkers(package).items():
        assert getattr(exporting, name) is getattr(import_module(module), name), name
        assert name in dir(exporting)


def test_few_public_functions_have_unchecked_shapes() -> None:
    """Numba compiles what a decorator returns, so `tests.shape_checks` cannot wrap compiled functions."""
    exported = {(package, name) for package in PACKAGES for name in names_for_checkers(package)}
    functions = [(name, getattr(import_module(package), name)) for package, name in sorted(exported)]
    functions = [(name, function) for name, function in functions if callable(function)]
    unchecked = sorted(name for name, function in functions if isinstance(function, Dispatcher))
    print(f"unchecked: {len(unchecked)} of {len(functions)} public functions and classes:", *unchecked)
    assert len(unchecked) <= MOST_UNCHECKED


@pytest.mark.parametrize("package", PACKAGES)
def test_no_exported_name_is_that_of_a_module(package: str) -> None:
    # `from quaffure.x import y` would give the function before, and the module after, y.py has been imported.
    modules = {path.stem for path in folder(package).iterdir()}
    assert not modules & set(names_for_checkers(package))


def imported_names(source: str) -> set[tuple[str, str]]:
    """Module and name of each `from module import name` in Python."""
    statements = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)]
    return {(str(statement.module), alias.name) for statement in statements for alias in statement.names}


def test_tests_import_exported_names_from_the_package() -> None:
    # So that a file of the package can move. Names that are not exported are imported from their module.
    exported = {(module, name) for package in PACKAGES for name, module in names_for_checkers(package).items()}
    sources = {file.name: file.read_text(encoding="utf-8") for file in (SOURCE.parent / "tests").rglob("*.py")}
    assert Path(__file__).name in sources
    modules = {module for module, _ in exported}
    candidates = [name for name, text in sources.items() if any(f"from {module} import" in text for module in modules)]
    assert not [(name, found) for name in candidates for found in imported_names(sources[name]) & exported]


def test_programs_import_functions_and_not_modules_of_their_name() -> None:
    # `from quaffure.io import load_groom` gives the module, which cannot be called, and nothing checks types there.
    root = SOURCE.parent
    modules = {
        (".".join(file.relative_to(SOURCE).parts[:-1]), file.stem)
        for file in SOURCE.rglob("*.py")
        if f"\ndef {file.stem}(" in file.read_text(encoding="utf-8")
    }
    assert ("quaffure.io", "load_groom") in modules
    programs = [file for folder in ("scripts", "benchmarks", "examples") for file in (root / folder).rglob("*.py")]
    found = {file.name: imported_names(file.read_text(encoding="utf-8")) & modules for file in programs}
    assert not {name: names for name, names in found.items() if names}


def test_an_unknown_name_is_refused_by_name() -> None:
    _, get_attribute, _ = lazy_exports("quaffure.hair")
    with pytest.raises(AttributeError, match=r"module 'quaffure\.hair' has no attribute 'Wig'"):
        get_attribute("Wig")


def test_packages_load_without_their_modules() -> None:
    statement = "\n".join([f"import {package}" for package in PACKAGES] + ["import sys", "print(*sys.modules)"])
    run = subprocess.run([sys.executable, "-c", statement], capture_output=True, text=True, check=True)
    assert not {"torch", "numpy", "numba", "pxr", "moderngl", "viser"} & set(run.stdout.split())

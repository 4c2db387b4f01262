"""What a wheel installs: a drape works with the required packages alone, and what needs more says so in one line."""

import ast
import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from quaffure import InputError
from quaffure.extras import EXTRAS, is_installed, require_extra

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
MODULES_OF = {"alembic3d": {"alembic3d", "imath"}, "libigl": {"igl"}, "pillow": {"PIL"}, "usd-core": {"pxr"}}
"""Modules of packages with other names, or with more than one."""
OPTIONAL = {module: extra for extra, modules in EXTRAS.items() for module in modules}
BODY_TOOLS = {"anny", "igl", "trimesh"}
WITHOUT_EXTRAS = f"""
import json
import sys
from importlib.machinery import PathFinder

class Finder(PathFinder):
    @classmethod
    def find_spec(cls, name, *more):
        return None if name.partition(".")[0] in {sorted(OPTIONAL)!r} else super().find_spec(name, *more)

sys.meta_path = [Finder if finder is PathFinder else finder for finder in sys.meta_path]
from quaffure.apps.cli.main import main
for words in json.loads(sys.argv[1]):
    try:
        main(words)
    except SystemExit as stop:
        print("exit code", stop.code)
"""
LARGE = {"ray"}
"""Extras that `all` leaves out."""


def modules_of(requirements: list[str]) -> set[str]:
    names = {requirement.partition(">")[0].partition("=")[0] for requirement in requirements}
    return set().union(*(MODULES_OF.get(name, {name}) for name in names))


def imported_modules(path: Path) -> set[str]:
    """Top-level names of what a module imports anywhere."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name.partition(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {"quaffure"}


def without_extras(*commands: list[str]) -> "subprocess.CompletedProcess[str]":
    """Commands where no package of an extra is installed; their exit codes other than 0 are printed."""
    command = [sys.executable, "-c", WITHOUT_EXTRAS, json.dumps(commands)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_every_import_is_a_requirement_or_belongs_to_an_extra() -> None:
    found = set().union(*(imported_modules(path) for path in (ROOT / "src").rglob("*.py")))
    required = modules_of(PROJECT["dependencies"])
    assert found - required <= set(OPTIONAL)
    assert required <= found
    for extra, modules in EXTRAS.items():
        assert set(modules) == modules_of(PROJECT["optional-dependencies"][extra])
    assert not required & set(OPTIONAL)


def test_extras_and_upper_bounds() -> None:
    extras = PROJECT["optional-dependencies"]
    assert {*EXTRAS, "all", "dev"} <= set(extras)
    assert extras["all"] == [f"quaffure[{','.join(sorted({*EXTRAS} - LARGE))}]"]
    assert "quaffure[all]" in extras["dev"]  # make sets up everything
    assert "'.[dev]'" in (ROOT / "scripts" / "set_up.sh").read_text(encoding="utf-8")
    every = PROJECT["dependencies"] + [one for extra in EXTRAS for one in extras[extra]]
    assert not [requirement for requirement in every if ",<" not in requirement]


def test_a_drape_needs_no_extra(tiny_groom_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "hair.npz"
    run = without_extras(["drape", str(tiny_groom_file), "--frames", "0:1", "--metrics", "--out", str(out)])
    assert "exit code" not in run.stdout, run.stderr
    assert out.is_file()


def test_what_needs_an_extra_names_it(tmp_path: Path) -> None:
    (tmp_path / "hair.usda").write_text("#usda 1.0\n")
    refused = [
        (["drape", "bob", "--out", "OUT/hair.png"], "render", "OUT/hair.png"),
        (["drape", "bob", "--out", "OUT/hair.mp4"], "render", "OUT/hair.mp4"),
        (["drape", "bob", "--out", "OUT/hair.usd"], "usd", "OUT/hair.usd"),
        (["drape", "bob", "--out", "OUT/hair.abc"], "alembic", "OUT/hair.abc"),
        (["drape", "OUT/hair.usda", "--out", "OUT/hair.npz"], "usd", "OUT/hair.usda"),
        (["grooms", "--out", "OUT/grooms.png"], "render", "OUT/grooms.png"),
        (["view"], "view", "quaffure view"),
    ]
    commands = [[word.replace("OUT", str(tmp_path)) for word in words] for words, _, _ in refused]
    run = without_extras(*commands)
    assert run.stdout.count("exit code 2\n") == len(refused), run.stderr
    for line, (_, extra, source) in zip(run.stderr.splitlines(), refused, strict=True):
        assert line.startswith(f"quaffure: {source.replace('OUT', str(tmp_path))}: expected the packages that ")
        assert f"pip install 'quaffure[{extra}]' brings, found no " in line
    assert [path.name for path in tmp_path.iterdir()] == ["hair.usda"]


def test_an_extra_that_is_there_is_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EXTRAS, "render", ("json",))
    require_extra("render", "a picture")
    monkeypatch.setitem(EXTRAS, "render", ("json", "no_such_module"))
    with pytest.raises(InputError, match=r"a picture: expected .*quaffure\[render\].* found no no_such_module"):
        require_extra("render", "a picture")
    assert not is_installed("no_such_module")


def test_processes_that_read_files_do_not_load_torch() -> None:
    """Which takes them longer than a small file."""
    pytest.importorskip("pxr")
    pytest.importorskip("alembic3d")
    modules = "quaffure.io.usd_curves, quaffure.io.usd_files, quaffure.io.alembic_curves"
    script = f"import {modules}, sys; print('torch' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False"]

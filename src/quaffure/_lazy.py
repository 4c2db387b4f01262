"""Public names of a package, imported from their modules when they are first used (PEP 562).

Torch and numba take seconds to import, pxr and moderngl more. A package lists its names once, as plain imports under
`TYPE_CHECKING`, for type checkers and for the interpreter.
"""

import ast
import inspect
import sys
from collections.abc import Callable
from importlib import import_module


def lazy_exports(package: str) -> tuple[list[str], Callable[[str], object], Callable[[], list[str]]]:
    """`__all__`, `__getattr__` and `__dir__` of a package whose modules are imported on first use of a name.

    The names are those that its `__init__.py` imports under `if TYPE_CHECKING`. No name may be that of a module of the
    package: once imported, the module would take its place.
    """
    branches = [node for node in ast.parse(inspect.getsource(sys.modules[package])).body if isinstance(node, ast.If)]
    imports = [node for branch in branches for node in branch.body if isinstance(node, ast.ImportFrom)]
    modules = {alias.name: str(node.module) for node in imports for alias in node.names}

    def get_attribute(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(modules[name]), name)

    def list_names() -> list[str]:
        return sorted({*vars(import_module(package)), *modules})

    return sorted(modules), get_attribute, list_names

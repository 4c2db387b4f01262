"""Public names of a package, imported from their modules when they are first used (PEP 562).

Torch and numba take seconds to import, pxr and moderngl more. A package lists its names here for the interpreter
and, under `TYPE_CHECKING`, as plain imports for type checkers; a test holds the two lists equal.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module


def lazy_exports(
    package: str, names_of_modules: Mapping[str, Sequence[str]]
) -> tuple[list[str], Callable[[str], object], Callable[[], list[str]]]:
    """`__all__`, `__getattr__` and `__dir__` of a package whose modules are imported on first use of a name.

    `names_of_modules` maps a module of the package, such as "groom" or "io.load_groom", to its public names. No name
    may be that of a module of the package: once imported, the module would take its place.
    """
    modules = {name: f"{package}.{module}" for module, names in names_of_modules.items() for name in names}

    def get_attribute(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(modules[name]), name)

    def list_names() -> list[str]:
        return sorted({*vars(import_module(package)), *modules})

    return sorted(modules), get_attribute, list_names

"""Run-time checks of the shapes and types in every annotation of the package, compiled functions apart.

A compiled function cannot be wrapped: numba compiles what the decorator returns, and its cache does not pickle it.
"""

import ast

from beartype import BeartypeConf, beartype
from jaxtyping import _import_hook, install_import_hook

import quaffure.config  # noqa: F401  its numbers may be tensors, where derivatives by them are wanted: not checked

check_types = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""An int may stand for a float."""


def install() -> None:
    """Check every module of the package that is imported from here on."""
    skips = _import_hook._is_no_type_check
    _import_hook._is_no_type_check = lambda node: skips(node) or "njit" in ast.unparse(node)
    install_import_hook("quaffure", "tests.shape_checks.check_types")

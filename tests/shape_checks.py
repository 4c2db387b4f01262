"""Run-time checks of the shapes and types in every annotation of the package, kernels apart.

A compiled function cannot be wrapped: numba compiles what the decorator returns, and its cache does not pickle it.
"""

import ast

import quaffure


def install() -> None:
    """Check every module of the package that is imported from here on."""
    from jaxtyping import _import_hook, install_import_hook

    skips = _import_hook._is_no_type_check
    _import_hook._is_no_type_check = lambda node: skips(node) or "njit" in ast.unparse(node)
    install_import_hook(quaffure.__name__, "beartype.beartype")

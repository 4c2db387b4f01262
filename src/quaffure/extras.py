"""Optional packages: what a drape needs is always installed, what else needs more says so before the work."""

import importlib.util

from quaffure.errors import InputError

EXTRAS = {
    "alembic": ("alembic3d", "imath"),
    "character": ("igl",),
    "view": ("viser", "msgspec", "websockets"),
    "render": ("av", "moderngl", "PIL"),
    "usd": ("pxr",),
    "docs": ("matplotlib",),
    "onnx": ("onnx", "onnxruntime", "onnxscript"),
    "ray": ("ray",),
}
"""Modules that each extra of the package brings (`pip install 'quaffure[view]'`)."""


def require_extra(extra: str, source: object) -> None:
    """Check that the modules of an extra are installed; imports none of them.

    Args:
        extra: a key of `EXTRAS`.
        source: the option, file or command that needs them.

    Raises:
        InputError: one of them is missing.
    """
    for module in EXTRAS[extra]:
        if not is_installed(module):
            raise InputError(f"{source}", f"the packages that pip install 'quaffure[{extra}]' brings", f"no {module}")


def is_installed(module: str) -> bool:
    """Whether a module can be imported; imports nothing."""
    return importlib.util.find_spec(module) is not None

"""Run-time checks of the shapes and types in every annotation of the package, compiled functions apart.

A compiled function cannot be wrapped: numba compiles what the decorator returns, and its cache does not pickle it.
"""

import ast
from collections.abc import Callable
from functools import wraps
from inspect import isfunction
from typing import Any
from weakref import WeakSet

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import _import_hook, install_import_hook

import quaffure.config  # noqa: F401  its numbers may be tensors, where derivatives by them are wanted: not checked

CHECKED_CALLS, SPACING = 20, 1.1
"""First calls of a function that are checked in each test file, and the factor from each later call that is checked to
the next. To check every one takes a fifth of the tests' time: small functions are called in long loops."""
check_types = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""An int may stand for a float."""
_check_shapes = jaxtyping.jaxtyped
_counts: WeakSet["_Count"] = WeakSet()  # functions in functions come and go


def install() -> None:
    """Check every module of the package that is imported from here on."""
    skips = _import_hook._is_no_type_check
    _import_hook._is_no_type_check = lambda node: skips(node) or "njit" in ast.unparse(node)
    jaxtyping.jaxtyped = _checked  # what the hook decorates functions and classes with
    install_import_hook("quaffure", "tests.shape_checks.check_types")


def restart() -> None:
    """Check the next calls of every function again."""
    for count in _counts:
        count.restart()


class _Count:
    """Calls of a function in this file, and the next that is checked."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        self.calls, self.next = 0, 1

    def is_checked(self) -> bool:
        """Of one more call."""
        self.calls += 1
        if self.calls < self.next:
            return False
        self.next = max(self.calls + 1, int(SPACING * self.calls) if self.calls > CHECKED_CALLS else 0)
        return True


def _checked(typechecker: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A decorator that checks some calls of a function, and all of a class' constructor."""

    def decorate(annotated: Any) -> Any:
        if not isfunction(annotated):
            return _check_shapes(annotated, typechecker=typechecker)
        checked, count = None, _Count()
        _counts.add(count)

        @wraps(annotated)
        def call(*arguments: Any, **named: Any) -> Any:
            nonlocal checked
            if not count.is_checked():
                return annotated(*arguments, **named)
            if checked is None:  # the code of a check takes milliseconds to make, and many functions are never called
                checked = _check_shapes(annotated, typechecker=typechecker)
            return checked(*arguments, **named)

        return call

    return decorate

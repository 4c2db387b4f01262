"""Run-time checks of the shapes and types in every annotation of the package, compiled functions apart.

A compiled function cannot be wrapped: numba compiles what the decorator returns, and its cache does not pickle it.
"""

import ast
from collections.abc import Callable
from functools import wraps
from inspect import isfunction
from typing import Any
from weakref import WeakKeyDictionary

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import _import_hook, install_import_hook

import quaffure.config  # noqa: F401  its numbers may be tensors, where derivatives by them are wanted: not checked

CHECKED_CALLS = 200
"""Calls of a function that are checked in each test file. To check every one takes a fifth of the tests' time: small
functions are called in long loops."""
check_types = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""An int may stand for a float."""
_check_shapes = jaxtyping.jaxtyped
_calls: WeakKeyDictionary[Callable[..., Any], int] = WeakKeyDictionary()  # functions in functions come and go


def install() -> None:
    """Check every module of the package that is imported from here on."""
    skips = _import_hook._is_no_type_check
    _import_hook._is_no_type_check = lambda node: skips(node) or "njit" in ast.unparse(node)
    jaxtyping.jaxtyped = _checked  # what the hook decorates functions and classes with
    install_import_hook("quaffure", "tests.shape_checks.check_types")


def restart() -> None:
    """Check the next calls of every function again."""
    _calls.clear()


def _checked(typechecker: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A decorator that checks the first calls of a function, and all of a class' constructor."""

    def decorate(annotated: Any) -> Any:
        checked = _check_shapes(annotated, typechecker=typechecker)
        if not isfunction(annotated):
            return checked

        @wraps(annotated)
        def call(*arguments: Any, **named: Any) -> Any:
            calls = _calls[annotated] = _calls.get(annotated, 0) + 1
            return (checked if calls <= CHECKED_CALLS else annotated)(*arguments, **named)

        return call

    return decorate

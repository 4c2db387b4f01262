"""One plain line for words that are no command, in place of the box that tyro prints."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from typing import Any, get_args, get_type_hints

KINDS = {"INT": "a whole number", "FLOAT": "a number"}
"""What tyro's words for types mean."""
NO_VALUE = "expected a value, found none"
NONE_OF_TYPES = re.compile(r"\['([^']*)'\]")
QUOTED = re.compile(r"'([^']*)'\s*$")
# tyro adds a name of its own to errors of dataclasses that refuse their values.
DUMMY = re.compile(r"^Error parsing __tyro-dummy-inner__\S*: ")


def option_error(message: str, arguments: Sequence[str], commands: Any) -> str:
    """The reason that tyro gives, as `SOURCE: expected X, found Y` where it is known, and the command with the help.

    Args:
        message: tyro's, boxed.
        arguments: the words that were typed.
        commands: the union of subcommands that they were parsed as.
    """
    command, choices = command_of(arguments, commands)
    program = " ".join(("quaffure", *command))
    blocks = _blocks(message)
    reason = _reason(blocks, program, choices)
    if reason.endswith(NO_VALUE) and (unknown := _unknown_options(arguments, _type_of(command, commands))):
        reason = f"unknown option {', '.join(unknown)}"
    return f"{reason}; see: {program} --help"


def command_of(arguments: Sequence[str], commands: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The subcommand that words begin with, as `("groom", "import")`, and the names that could follow it."""
    types = {_name(member): get_args(member)[0] for member in get_args(commands)}
    named = next((word for word in arguments if not word.startswith("-")), None)
    if named not in types:
        return (), tuple(types)
    of_fields = get_type_hints(types[named], include_extras=True).values()
    nested = next((field for field in of_fields if all(map(_name, get_args(field) or [None]))), None)
    found, choices = command_of(arguments[arguments.index(named) + 1 :], nested)
    return (named, *found), choices


def _type_of(command: Sequence[str], commands: Any) -> Any:
    """The dataclass of a subcommand."""
    found = None
    for name in command:
        found = next(get_args(member)[0] for member in get_args(commands) if _name(member) == name)
        of_fields = get_type_hints(found, include_extras=True).values()
        commands = next((field for field in of_fields if all(map(_name, get_args(field) or [None]))), None)
    return found


def _unknown_options(arguments: Sequence[str], command: Any) -> list[str]:
    """Options that a subcommand does not have: a word after one may be the value that another argument lacks."""
    given = [word.partition("=")[0] for word in arguments if word.startswith("--")]
    return [option for option in given if option not in {"--help", *_options(command)}]


def _options(command: Any) -> Iterator[str]:
    for field, kind in get_type_hints(command).items() if is_dataclass(command) else ():
        yield from (f"--{prefix}{field.replace('_', '-')}" for prefix in ("", "no-"))
        yield from _options(kind)


def _name(member: Any) -> str:
    """The name of a subcommand; empty of another type."""
    return next((part.name for part in getattr(member, "__metadata__", ()) if hasattr(part, "description")), "")


def _blocks(message: str) -> list[str]:
    """The text of a box between its rules."""
    lines = re.findall(r"^│(.*)│$", message, re.MULTILINE) or message.splitlines()
    texts = re.split(r"─{2,}", " ".join(line.strip() for line in lines))
    return [" ".join(text.split()) for text in texts]


def _reason(blocks: Sequence[str], program: str, choices: Sequence[str]) -> str:
    first = DUMMY.sub("", blocks[0]).rstrip(".")
    if unknown := re.match(r"Unrecognized options: (.+)", first):
        return _unknown(unknown[1].split(", "), blocks, program, choices)
    if misplaced := re.match(r"Unrecognized or misplaced options: ((?:\S+ \(applied to [^)]*\) ?)+)", first):
        return _unknown(re.findall(r"(\S+) \(applied to", misplaced[1]), blocks, program, choices)
    if re.match(r"Expected one of \{", first):
        return f"expected a command, one of {', '.join(choices)}, found none"
    if missing := re.match(r"Missing value for argument '(\S+)'", first):
        return f"{missing[1]}: {NO_VALUE}"
    if chosen := re.match(r"invalid choice '(.*)' for argument '(\S+)'. Expected one of \((.*)\)", first):
        names = sorted({*re.findall(r"'([^']+)'", chosen[3])} - {"None"})
        return f"{chosen[2]}: expected one of {', '.join(names)}, found '{chosen[1]}'"
    if parsed := re.match(r"Error parsing (--\S+): (.+)", first):
        return _of_another_type(parsed[1], parsed[2], " ".join(blocks[1:]))
    if lacking := re.match(r"Missing from quaffure[\w -]*: (--\S+ \S+|\S+) (.+)", first):
        lost = re.search(r"Unrecognized options: (\S+)", " ".join(blocks[1:]))
        also = f"; unknown option {lost[1]}" if lost else ""
        return f"missing {lacking[1]}: {lacking[2].replace('. (required)', ';').rstrip(';. ')}{also}"
    return first


def _unknown(words: Sequence[str], blocks: Sequence[str], program: str, choices: Sequence[str]) -> str:
    """Words that no option has; where one of the same command is similar, its name."""
    options = [word for word in words if word.startswith("-")]
    if not options and choices:
        return f"expected a command, one of {', '.join(choices)}, found '{words[0]}'"
    if not options:
        return f"unexpected {', '.join(words)}"
    similar = re.findall(r"(--[\w-]+)(?:(?! in quaffure).)* in (quaffure(?: [\w-]+)*) --help", " ".join(blocks[1:]))
    meant = next((f", did you mean {option}?" for option, place in similar if place == program), "")
    return f"unknown option {', '.join(options)}{meant}"


def _of_another_type(option: str, reason: str, details: str) -> str:
    """An option whose value is of another type than its help says."""
    value = NONE_OF_TYPES.search(reason) or QUOTED.search(reason)
    kind = next((words for name, words in KINDS.items() if re.search(rf"{option} \S*\b{name}\b", details)), None)
    if value is None or kind is None:
        return f"{option}: {reason}"
    return f"{option}: expected {kind}, found '{value[1]}'"

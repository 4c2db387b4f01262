"""The command line: subcommands, one line for a user's mistake, exit code 2."""

import sys
from typing import Annotated

import tyro

from quaffure.cli.drape import DrapeCommand
from quaffure.cli.grooms import GroomsCommand
from quaffure.cli.info import InfoCommand
from quaffure.cli.train import TrainCommand
from quaffure.errors import InputError

Command = (
    Annotated[DrapeCommand, tyro.conf.subcommand("drape")]
    | Annotated[TrainCommand, tyro.conf.subcommand("train")]
    | Annotated[GroomsCommand, tyro.conf.subcommand("grooms")]
    | Annotated[InfoCommand, tyro.conf.subcommand("info")]
)


def main(arguments: list[str] | None = None) -> None:
    """Run `quaffure`. Exits with 2 and one line on the error stream for bad input."""
    command = tyro.cli(
        Command,  # type: ignore[arg-type]
        prog="quaffure",
        description="Drape strand hair on a posed, shaped body.",
        args=arguments,
        config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes, tyro.conf.FlagConversionOff),
    )
    try:
        command.run()
    except InputError as error:
        print(f"quaffure: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)

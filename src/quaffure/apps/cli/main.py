"""The command line: subcommands; one line and exit code 2 for bad input."""

import io
import os
import signal
import sys
import threading
from contextlib import redirect_stderr
from importlib.metadata import version
from typing import Annotated, NoReturn

import tyro

from quaffure.apps.cli.benchmark import BenchmarkCommand
from quaffure.apps.cli.body import BodyCommand
from quaffure.apps.cli.characters import CharactersCommand
from quaffure.apps.cli.console import console
from quaffure.apps.cli.doctor import DoctorCommand
from quaffure.apps.cli.drape import DrapeCommand
from quaffure.apps.cli.evaluate import EvaluateCommand, ScoreCommand
from quaffure.apps.cli.export_onnx import ExportOnnxCommand
from quaffure.apps.cli.groom import GroomCommand, GroomsCommand
from quaffure.apps.cli.groomgen import GroomgenDataCommand, TrainGroomgenCommand
from quaffure.apps.cli.info import InfoCommand
from quaffure.apps.cli.inspect import InspectCommand
from quaffure.apps.cli.kernel_cache import announced_compiling
from quaffure.apps.cli.option_errors import option_error
from quaffure.apps.cli.render import RenderCommand
from quaffure.apps.cli.rig import RigCommand
from quaffure.apps.cli.train import TrainCommand
from quaffure.apps.cli.train_code import TrainCodeCommand
from quaffure.apps.cli.view import ViewCommand
from quaffure.errors import InputError
from quaffure.solvers.strand_newton import SETTLING_PASSES
from quaffure.training.stop_request import EXIT_CODE_BASE, SIGNALS

Command = (
    Annotated[DrapeCommand, tyro.conf.subcommand("drape")]
    | Annotated[TrainCommand, tyro.conf.subcommand("train")]
    | Annotated[TrainCodeCommand, tyro.conf.subcommand("train-code")]
    | Annotated[GroomgenDataCommand, tyro.conf.subcommand("groomgen-data")]
    | Annotated[TrainGroomgenCommand, tyro.conf.subcommand("train-groomgen")]
    | Annotated[CharactersCommand, tyro.conf.subcommand("crowd")]
    | Annotated[RenderCommand, tyro.conf.subcommand("render")]
    | Annotated[ExportOnnxCommand, tyro.conf.subcommand("export-onnx")]
    | Annotated[RigCommand, tyro.conf.subcommand("rig")]
    | Annotated[ViewCommand, tyro.conf.subcommand("view")]
    | Annotated[EvaluateCommand, tyro.conf.subcommand("evaluate")]
    | Annotated[ScoreCommand, tyro.conf.subcommand("score")]
    | Annotated[BenchmarkCommand, tyro.conf.subcommand("benchmark")]
    | Annotated[GroomsCommand, tyro.conf.subcommand("grooms")]
    | Annotated[GroomCommand, tyro.conf.subcommand("groom")]
    | Annotated[BodyCommand, tyro.conf.subcommand("body")]
    | Annotated[InspectCommand, tyro.conf.subcommand("inspect")]
    | Annotated[InfoCommand, tyro.conf.subcommand("info")]
    | Annotated[DoctorCommand, tyro.conf.subcommand("doctor")]
)


def main(arguments: list[str] | None = None) -> None:
    """Run `quaffure`. Exits with 2 and one line on the error stream for bad input."""
    if threading.current_thread() is threading.main_thread():
        # By default the process would end without removing the temporary files that it is writing.
        for number in SIGNALS[1:]:
            if signal.getsignal(number) is not signal.SIG_IGN:  # as `nohup` asks
                signal.signal(number, lambda number, _: sys.exit(EXIT_CODE_BASE + number))
    console.quiet, console.lost = False, ""  # after another command in the same process
    try:
        with announced_compiling(
            lambda: console.print("compiling kernels; first use of this feature only: up to some minutes")
        ):
            parse(arguments).run()
        if console.lost:
            raise InputError("standard output", "a place for what is printed; files are written", console.lost)
    except InputError as error:
        _refuse(str(error))
    except KeyboardInterrupt:
        sys.exit(130)


def parse(arguments: list[str] | None = None) -> Command:
    """The subcommand with its options, which `run` does not check yet.

    Exits with 0 after `--version`, and with 2 and one line on the error stream, in place of tyro's boxed message, for
    words that are no command.
    """
    words = sys.argv[1:] if arguments is None else arguments
    if words == ["--version"]:
        print(f"quaffure {version('quaffure')}")
        sys.exit()
    message = io.StringIO()
    try:
        with redirect_stderr(message):
            return tyro.cli(
                Command,
                prog="quaffure",
                description="Drape strand hair on a posed, shaped body. `quaffure --version` prints the version.",
                args=_in_full(words),
                config=(
                    tyro.conf.OmitSubcommandPrefixes,
                    tyro.conf.OmitArgPrefixes,
                    tyro.conf.FlagCreatePairsOff,
                    tyro.conf.DisallowNone,
                ),
            )
    except BrokenPipeError:  # `quaffure drape --help | head`: the reader has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left is written when Python ends
        sys.exit()
    except SystemExit as stop:
        if not stop.code:  # --help
            raise
        _refuse(option_error(message.getvalue(), words, Command))


def _in_full(words: list[str]) -> list[str]:
    """Words as tyro parses them, which knows neither values that may be left out nor options for what is so already."""
    if words[:1] != ["drape"]:
        return words
    full = list[str]()
    for word in (each for each in words if each != "--coherent"):
        if full[-1:] == ["--settle"] and word.startswith("--"):
            full.append(str(SETTLING_PASSES))
        full.append(word)
    return [*full, str(SETTLING_PASSES)] if full[-1] == "--settle" else full


def _refuse(reason: str) -> NoReturn:
    print("quaffure:", " ".join(reason.split()), file=sys.stderr)
    sys.exit(2)

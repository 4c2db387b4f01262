"""The folder of a training run: its settings, its logs, and the checkpoint to resume from."""

import csv
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, get_args

import torch

from quaffure.body.body_model import BodyModel
from quaffure.digest import array_digest
from quaffure.errors import InputError, refused
from quaffure.input_file import check_input_file
from quaffure.io.atomic import replacing, write_json
from quaffure.io.output_path import made_folder

CHECKPOINT, LOCK = "checkpoint.pt", ".lock"
RUN, CHECKPOINT_FILE = "a folder for the run", "a checkpoint of this training"
Table = Literal["training", "validation"]


class RunFolder:
    """Files of one run. A process killed at any moment leaves them whole.

    Attributes:
        path: the folder.
        version: of the code that this process runs, whatever becomes of the source meanwhile.
    """

    def __init__(self, path: Path) -> None:
        """
        Args:
            path: made where it does not exist.

        Raises:
            InputError: it cannot be made.
        """
        self.path = made_folder(path, RUN)
        self.version = code_version()

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep the folder for this process; the lock ends with the process, however it ends. None on Windows.

        Raises:
            InputError: another process has it.
        """
        with (self.path / LOCK).open("a") as file:
            try:
                import fcntl  # not on Windows

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except ImportError:
                pass
            except OSError as error:
                raise InputError(self.path, "a folder that no other training uses", "one that is in use") from error
            yield

    def describe(self, description: Mapping[str, object]) -> None:
        """Write `config.json`: the version of the code, and the settings of the run."""
        write_json(self.path / "config.json", {"version": self.version, **description})

    def save(self, state: Mapping[str, Any]) -> None:
        """Replace the checkpoint. `state` holds tensors, numbers and texts, `identity` among them.

        Nothing is unpickled but these when it is read back.
        """
        # Through memory: torch's own writing raises no OSError on a full disk.
        written = BytesIO()
        torch.save(dict(state), written)
        with replacing(self.path / CHECKPOINT) as path:
            path.write_bytes(written.getbuffer())

    def load(self, identity: Mapping[str, str]) -> dict[str, Any] | None:
        """The state that `save` kept, on the CPU; None where there is none.

        Args:
            identity: entries of the state, and what they have to be.

        Raises:
            InputError: it is of another run, or damaged.
        """
        path = self.path / CHECKPOINT
        if not path.exists():
            return None
        check_input_file(path, CHECKPOINT_FILE)
        with self.reading():
            state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
            _ = state["identity"]
            # Counters hold the best score, which is infinite before a validation.
            if not _is_finite({name: part for name, part in state.items() if name != "counters"}):
                raise InputError(path, CHECKPOINT_FILE, "NaN or infinity")
        for name, expected in identity.items():
            # Checkpoints made before an entry was kept lack it.
            if state.get(name, expected) != expected:
                raise InputError(self.path, f"a run of {expected}", f"{state[name]}")
        return state

    def reading(self) -> AbstractContextManager[None]:
        """What goes wrong while the checkpoint's contents are taken over is the checkpoint's fault.

        Raises:
            InputError: it is damaged, or made by another version of the code.
        """
        # On damaged bytes torch's unpickler raises many unrelated types.
        return refused(self.path / CHECKPOINT, CHECKPOINT_FILE, Exception)

    def log(self, name: Table, row: Mapping[str, object]) -> None:
        """Append a row to a table, `<name>.csv`; columns that it does not have yet are added to it, empty so far.

        Raises:
            InputError: it is damaged, or cannot be written.
        """
        path = self.path / f"{name}.csv"
        columns, rows = _read_table(path)
        new = [column for column in row if column not in columns]
        if new:
            columns += new
            _write_table(path, columns, rows)
        with (
            refused(path, "a file that can be written", OSError),
            path.open("a", newline="", encoding="utf-8") as file,
        ):
            csv.DictWriter(file, columns, restval="").writerow(row)

    def rewind_logs(self, step: int) -> None:
        """Drop rows of later steps, which the run will do again, and a row that was cut short by a kill.

        Raises:
            InputError: a table is damaged.
        """
        # Not every .csv of the folder: it may be one that holds tables of the user's.
        for path in (self.path / f"{name}.csv" for name in get_args(Table)):
            columns, rows = _read_table(path)
            whole = [row for row in rows if None not in row.values() and row.get("step", "").isdigit()]
            kept = [row for row in whole if int(row["step"]) <= step]
            if len(kept) < len(rows):
                _write_table(path, columns, kept)


def _is_finite(value: Any) -> bool:
    """Whether all real numbers of a tensor, or of those in lists and dictionaries, are finite."""
    if isinstance(value, torch.Tensor):
        return not value.is_floating_point() or bool(torch.isfinite(value).all())
    if isinstance(value, Mapping):
        return all(map(_is_finite, value.values()))
    return not isinstance(value, list | tuple) or all(map(_is_finite, value))


def body_digest(body: BodyModel) -> str:
    """Digest of a body's rest shape, the same in every process."""
    return array_digest(body.rest_vertices)[:8]


def code_version() -> str:
    """Version of the package, and in a git checkout of its source also the commit."""
    released = version("quaffure")
    root = Path(__file__).parents[3]
    if not (root / ".git").exists():
        return released
    try:
        # Without locks: a git that is killed while it has one leaves the checkout locked.
        command = ["git", "--no-optional-locks", "-C", str(root), "describe", "--always", "--dirty", "--tags"]
        described = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return released
    return f"{released} ({described})"


def _read_table(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    if not path.is_file():
        return [], []
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
        # Surplus values are those of None, which cannot be written again.
        return list(reader.fieldnames or []), [{} if None in row else row for row in rows]


def _write_table(path: Path, columns: list[str], rows: list[dict[str, str]]) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)

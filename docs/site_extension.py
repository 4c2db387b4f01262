"""What the site makes while it is built: the command line's page from its own help, equations as MathML.

Browsers draw MathML themselves, so pages need no script from another host.
"""

import io
import os
import re
from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from unittest.mock import patch

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.writers.html5 import HTML5Translator

from quaffure.apps.cli.main import main

COLUMNS = 88


def help_of(command: str) -> str:
    """What `quaffure COMMAND --help` prints."""
    printed = io.StringIO()
    with patch.dict(os.environ, COLUMNS=str(COLUMNS)), redirect_stdout(printed), suppress(SystemExit):
        main([*command.split(), "--help"])
    return "\n".join(line.rstrip() for line in printed.getvalue().strip().splitlines())


def commands(command: str = "") -> Iterator[tuple[str, str]]:
    """Every command that does something, with its help: those of `groom` and `benchmark` one by one."""
    text = help_of(command)
    if not re.search(r"^ subcommands$", text, re.MULTILINE):
        yield command, text
        return
    names = re.search(r"\{([^}]+)\}", text)
    assert names
    for name in re.split(r"[,\s]+", names[1]):
        yield from commands(f"{command} {name}".strip())


class CommandLine(SphinxDirective):
    """A section for every command, with its help as the terminal shows it."""

    def run(self) -> list[nodes.Node]:
        sections: list[nodes.Node] = []
        for command, text in commands():
            section = nodes.section(ids=[nodes.make_id(f"quaffure-{command}")])
            section += nodes.title(text=f"quaffure {command}")
            section += nodes.literal_block(text, text, language="text")
            self.state.document.note_explicit_target(section, section)
            sections.append(section)
        return sections


def inline_equation(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def equation(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("command-line", CommandLine)
    app.add_html_math_renderer("mathml", (inline_equation, None), (equation, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}

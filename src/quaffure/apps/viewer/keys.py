"""Keys of the live page. viser lists them as commands, too (Ctrl+K)."""

from collections.abc import Callable, Mapping

from viser import ClientHandle, CommandEvent, GuiApi

from quaffure.apps.render.camera import AZIMUTHS

Action = Callable[[ClientHandle], None]

PLAY, NEXT_FRAME, PREVIOUS_FRAME, FIRST_FRAME = "Play or pause", "Next frame", "Frame before", "First frame"
NEXT_GROOM, NEXT_CLIP, SHOW_GUIDES = "Next groom", "Next clip", "Guides or all hair"
SAVE_PICTURE, MAKE_LINK = "Save picture", "Link to this view"
VIEWS = {f"View from: {view}": view for view in AZIMUTHS}
# The arrows, W, A, S, D, Q and E move viser's camera.
KEYS = {
    **{PLAY: "space", NEXT_FRAME: "N", PREVIOUS_FRAME: "B", FIRST_FRAME: "home"},
    **{NEXT_GROOM: "G", NEXT_CLIP: "M", SHOW_GUIDES: "H", SAVE_PICTURE: "P", MAKE_LINK: "L"},
    **{name: f"{number}" for number, name in enumerate(VIEWS, 1)},
}
"""Key of each command."""


def keys_text() -> str:
    """The keys, as Markdown."""
    rows = [f"| {key.title()} | {name} |" for name, key in KEYS.items()]
    camera = ["| Arrows | Turn the camera |", "| W A S D Q E | Move the camera |", "| Ctrl+K | All commands |"]
    return "\n".join(["| Key | |", "|---|---|", *rows, *camera])


def add_keys(gui: GuiApi, actions: Mapping[str, Action]) -> None:
    """Call an action when its key is pressed in a browser.

    Args:
        actions: by command; all of `KEYS`.
    """
    for name, key in KEYS.items():
        command = gui.add_command(name, hotkey=key)  # type: ignore[arg-type]  # viser lists the keys as literals
        command.on_trigger(_called_with_browser(actions[name]))


def _called_with_browser(action: Action) -> Callable[[CommandEvent], None]:
    def on_trigger(event: CommandEvent) -> None:
        if event.client is not None:
            action(event.client)

    return on_trigger

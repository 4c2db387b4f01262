"""The live page in the browser: a stage, a thread that drapes, and the page's controls."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.apps.viewer.catalogue import Catalogue
    from quaffure.apps.viewer.draping_thread import DrapingThread
    from quaffure.apps.viewer.page import Address, Page
    from quaffure.apps.viewer.playback import Playback
    from quaffure.apps.viewer.session import Session
    from quaffure.apps.viewer.stage import Degrees, Stage

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "catalogue": ["Catalogue"],
        "draping_thread": ["DrapingThread"],
        "page": ["Address", "Page"],
        "playback": ["Playback"],
        "session": ["Session"],
        "stage": ["Degrees", "Stage"],
    },
)

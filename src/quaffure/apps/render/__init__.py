"""Pictures and video of draped hair, drawn offscreen by OpenGL."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.apps.render.camera import Camera
    from quaffure.apps.render.contact_sheet import NATURAL_COLOURS, write_contact_sheet
    from quaffure.apps.render.scene import StrandRenderer
    from quaffure.apps.render.video import encode_video

__all__, __getattr__, __dir__ = lazy_exports(__name__)

"""The live page's server: its own origin alone, nothing but widgets and cameras, and limits."""

import gc
import http.client
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import pytest
import viser
from viser import GuiInputHandle, ViserServer
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from quaffure.apps.viewer import guarded_server as guarded
from quaffure.apps.viewer.catalogue import REST, Catalogue
from quaffure.apps.viewer.guarded_server import MOST_BROWSERS, MOST_MESSAGES_PER_SECOND, guarded_server, is_taken
from quaffure.apps.viewer.page import Page
from quaffure.apps.viewer.settings import Settings
from quaffure.model import load_model
from tests.training_runs import tiny_groom

SECONDS = 30.0
MOST_GROWTH = 30e6
"""Growth of the resident memory over the later half of the interactions [bytes]; the allocator's own is about that."""
CAMERA = {
    **{"type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.0, -2.0, 1.0], "fov": 0.5},
    **{"near": 0.02, "far": 100.0, "image_height": 300, "image_width": 400},
    **{"look_at": [0.0, 0.0, 1.0], "up_direction": [0.0, 0.0, 1.0]},
}


@pytest.fixture(scope="module")
def server() -> Iterator[ViserServer]:
    made = guarded_server("127.0.0.1", 0)
    yield made
    made.stop()


def opened(server: ViserServer, origin: str | None = "", host: str | None = None) -> ClientConnection:
    """A browser's connection; by default from the page itself."""
    port = server.get_port()
    address = f"127.0.0.1:{port}"
    sent = f"http://{address}" if origin == "" else origin
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    headers = {} if host is None else {"Host": host}
    return connect(
        f"ws://{address}",
        origin=None if sent is None else Origin(sent),
        subprotocols=[protocol],
        additional_headers=headers,
        max_size=None,
        compression=None,
    )


def sent(browser: ClientConnection, message: dict[str, object]) -> None:
    browser.send(msgspec.msgpack.encode(message))


def update(uuid: str, value: object) -> dict[str, object]:
    return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}


def wait_until(holds: Callable[[], bool], seconds: float = SECONDS) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def close_code(browser: ClientConnection) -> int | None:
    """Why the server ended a connection."""
    try:
        while True:
            browser.recv(timeout=SECONDS)
    except ConnectionClosed as end:
        return None if end.rcvd is None else end.rcvd.code


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    model = load_model()
    groom = replace(tiny_groom(model.body), name="tiny")
    made = Page(Catalogue(model, groom), Settings("tiny", REST), ("127.0.0.1", 0), tmp_path, lambda *_: None)
    yield made
    made.stop()


def answer(server: ViserServer, path: str = "/", **headers: str) -> tuple[int, Mapping[str, str]]:
    """Status and headers of the page."""
    with closing(http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=SECONDS)) as asked:
        asked.request("GET", path, headers=headers)
        with asked.getresponse() as found:
            return found.status, dict(found.headers)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1", None]
)
def test_pages_of_other_origins_are_refused(server: ViserServer, origin: str | None) -> None:
    with pytest.raises(InvalidStatus) as refusal:
        opened(server, None if origin is None else origin.format(port=server.get_port()))
    assert refusal.value.response.status_code == 403


def test_names_that_resolve_to_this_machine_are_refused(server: ViserServer) -> None:
    """DNS rebinding: the page of evil.example comes from 127.0.0.1."""
    host = f"evil.example:{server.get_port()}"
    assert answer(server, Host=host)[0] == 403
    assert answer(server, Host=host, Upgrade="websocket", Connection="Upgrade")[0] == 403
    assert answer(server, Origin="http://evil.example")[0] == 403


def test_the_page_itself_is_served_and_in_no_frame(server: ViserServer) -> None:
    for host in (f"127.0.0.1:{server.get_port()}", f"localhost:{server.get_port()}", "[::1]:9000", "192.0.2.7"):
        status, headers = answer(server, Host=host)
        assert status == 200
        assert headers["X-Frame-Options"] == "DENY"
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    with opened(server) as browser:
        assert browser.recv(timeout=SECONDS)


@pytest.mark.parametrize(
    ("opens", "headers"),
    [
        (True, {"Sec-Fetch-Dest": "document", "Sec-Fetch-Site": "none"}),
        (True, {"Sec-Fetch-Dest": "document", "Sec-Fetch-Site": "same-origin"}),
        (True, {"Sec-Fetch-Dest": "document", "Sec-Fetch-Site": "cross-site", "Sec-Fetch-User": "?1"}),
        (True, {"Accept": "text/html,*/*"}),
        (False, {"Sec-Fetch-Dest": "document", "Sec-Fetch-Site": "cross-site"}),
        (False, {"Sec-Fetch-Dest": "document", "Sec-Fetch-Site": "none", "Sec-Purpose": "prefetch;prerender"}),
        (False, {"Sec-Fetch-Dest": "iframe", "Sec-Fetch-Site": "cross-site", "Sec-Fetch-User": "?1"}),
        (False, {"Sec-Fetch-Dest": "image", "Sec-Fetch-Site": "cross-site", "Accept": "text/html"}),
        (False, {"Accept": "image/avif,*/*"}),
    ],
)
def test_links_are_taken_where_a_user_opens_them(opens: bool, headers: dict[str, str]) -> None:
    """And not where another page loads their address, or sends the tab there."""
    taken: list[str] = []
    linked = guarded_server("127.0.0.1", 0, lambda query: taken.append(query) or "fov=1")
    status, sent_headers = answer(linked, "/?groom=bob", **headers)
    linked.stop()
    assert taken == ["groom=bob"] * opens
    assert status == (303 if opens else 200)
    assert sent_headers.get("Location") == ("/?fov=1" if opens else None)


def test_other_addresses_are_no_links() -> None:
    taken: list[str] = []
    linked = guarded_server("127.0.0.1", 0, taken.append)
    for path in ("/", "/index.html?groom=bob", "/?darkMode"):
        assert answer(linked, path, Accept="text/html")[0] == 200
    linked.stop()
    assert taken == ["darkMode"]


def test_browsers_are_limited_and_leave_their_places(server: ViserServer) -> None:
    browsers = [opened(server) for _ in range(MOST_BROWSERS)]
    with pytest.raises(InvalidStatus) as refusal:
        opened(server)
    assert refusal.value.response.status_code == 503
    for browser in browsers:
        browser.close()
    wait_until(lambda: not server.get_clients())
    with opened(server) as browser:
        assert browser.recv(timeout=SECONDS)


@pytest.mark.parametrize("message", [b"", b"\xc1", b"\x91" * 60_000, b"\x80", b"\x01", "text", b"\x00" * (1 << 17)])
def test_junk_ends_its_connection_alone(server: ViserServer, message: bytes | str) -> None:
    with opened(server) as other, opened(server) as browser:
        browser.send(message)
        assert close_code(browser) in (1007, 1009)
        sent(other, CAMERA)
        assert other.recv(timeout=SECONDS)


def test_only_widgets_and_cameras_get_through(server: ViserServer) -> None:
    slider = server.gui.add_slider("one", 0.0, 1.0, 0.1, 0.5)
    upload = server.gui.add_upload_button("file")
    transfer = {"source_component_uuid": upload._impl.uuid, "transfer_uuid": "0", "part_count": 1}
    part = {"type": "FileTransferPart", "source_component_uuid": upload._impl.uuid, "transfer_uuid": "0"}
    with opened(server) as browser:
        sent(browser, CAMERA)
        sent(
            browser, {"type": "FileTransferStartUpload", "filename": "a", "mime_type": "", "size_bytes": 1, **transfer}
        )
        sent(browser, {**part, "part": 0, "content": b"x"})
        sent(browser, {"type": "ShareUrlRequest"})
        for bad in (float("nan"), float("inf"), "nan", "-Infinity"):
            sent(browser, update(slider._impl.uuid, bad))
        sent(browser, {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": {"value": 0.1, "max": 9.0}})
        sent(browser, {**CAMERA, "fov": float("nan")})
        wait_until(lambda: len(server.get_clients()) == 1)
        (client,) = server.get_clients().values()
        sent(browser, update(slider._impl.uuid, 0.75))
        wait_until(lambda: slider.value == 0.75)
        assert upload.value.content == b""
        assert not server.gui._current_file_upload_states
        assert server._share_tunnel is None
        assert client.camera.fov == 0.5
    assert not is_taken(msgspec.msgpack.encode({"type": "RunJavascriptMessage", "source": "1"}))


def test_a_flood_is_slowed_down(server: ViserServer, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[float] = []

    def counted(message: bytes) -> bool:
        taken.append(time.monotonic())
        return is_taken(message)

    monkeypatch.setattr(guarded, "is_taken", counted)
    with opened(server) as browser:
        drain = threading.Thread(target=partial(deque, browser, 0), daemon=True)
        drain.start()
        for _ in range(600):
            sent(browser, CAMERA)
        wait_until(lambda: len(taken) == 600)
    # The first half second's worth may come at once.
    assert taken[-1] - taken[0] > 0.9 * (600 - MOST_MESSAGES_PER_SECOND / 2) / MOST_MESSAGES_PER_SECOND


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident memory is read from /proc")
@pytest.mark.parametrize("interactions", [100, pytest.param(400, marks=pytest.mark.long)])
def test_memory_stays_flat_over_many_interactions(
    page: Page, monkeypatch: pytest.MonkeyPatch, interactions: int
) -> None:
    """Pose, shape, clip, gravity and wind: each change is sent by one browser and drawn by two."""
    monkeypatch.setattr(guarded, "MOST_MESSAGES_PER_SECOND", 1e4)
    panel = page.panel
    joint, resident = next(iter(panel.joints.values())), []

    def settled() -> None:
        done = threading.Event()
        page.session.thread.request("settled", done.set)
        assert done.wait(SECONDS)

    with opened(page._server) as browser, opened(page._server) as other:
        for one in (browser, other):
            threading.Thread(target=partial(deque, one, 0), daemon=True).start()
            sent(one, CAMERA)
        settled()
        for step in range(interactions):
            share = (step + 1) % 20 / 20
            widget, value = (
                (joint[step % 3], 40.0 * share),
                (panel.shape[step % 10], share),
                (panel.motion, ("nod", "walk")[step % 2]),
                (panel.gravity[0], share),
                (panel.wind[0], share),
            )[step % 5]
            sent(browser, update(widget._impl.uuid, value))
            wait_until(partial(has_value, widget, value))
            settled()
            if (step + 1) % (interactions // 4) == 0:
                gc.collect()
                resident.append(resident_bytes())
    print("resident memory after every quarter of the interactions [MB]:", *(round(size / 1e6) for size in resident))
    assert resident[-1] - resident[len(resident) // 2 - 1] < MOST_GROWTH


def has_value(widget: GuiInputHandle[Any], value: object) -> bool:
    return bool(widget.value == value)


def test_values_beyond_a_slider_are_moved_to_its_end(page: Page) -> None:
    with opened(page._server) as browser:
        sent(browser, CAMERA)
        sent(browser, update(page.panel.speed._impl.uuid, 1e300))
        wait_until(lambda: page._playback.speed == 2.0)
        assert page.panel.speed.value == 2.0

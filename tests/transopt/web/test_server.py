"""What the server lets in: the page's own window on this machine, and nobody else."""

import http.client
import json
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.transopt.web.conftest import MISSING
from transopt.base.errors import InputError
from transopt.scene.scene import Scene

for _name in ("starlette", "uvicorn", "websockets"):
    pytest.importorskip(_name, reason=MISSING)

from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from transopt.web.serve import Page, page  # noqa: E402
from transopt.web.server import STATIC  # noqa: E402

SVG = "http://www.w3.org/2000/svg"  # the name of a language, which nobody fetches


def asked(address: str, path: str, **headers: str) -> tuple[int, http.client.HTTPMessage, bytes]:
    parts = urlsplit(address)
    assert parts.hostname is not None
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=30)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    found = answer.status, answer.headers, answer.read()
    connection.close()
    return found


def test_the_pages_files_come_with_a_policy_that_allows_nothing_from_elsewhere(address: str) -> None:
    root = urlsplit(address).path
    for name in ("", *(path.name for path in STATIC.iterdir())):
        status, headers, body = asked(address, root + name)
        assert status == 200, name
        assert body
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "script-src 'self';" in policy
        assert "https:" not in policy
    assert asked(address, f"{root}none.js")[0] == 404
    assert asked(address, f"{root}../../service.py")[0] in (403, 404)
    assert asked(address, f"{root}..%2f..%2fservice.py")[0] in (403, 404)


def test_nothing_of_the_page_names_another_place() -> None:
    for path in STATIC.iterdir():
        text = path.read_text(encoding="utf-8").replace(SVG, "")
        assert "http://" not in text
        assert "https://" not in text


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:80"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
    ],
)
def test_another_origin_or_host_is_refused(address: str, headers: dict[str, str]) -> None:
    assert asked(address, urlsplit(address).path, **headers)[0] == 403


@pytest.mark.parametrize("path", ["/", "/wrong/", "//", "/page.js"])
def test_without_the_token_there_is_nothing(address: str, path: str) -> None:
    assert asked(address, path)[0] == 403


def test_a_window_of_another_origin_or_without_the_token_is_refused(address: str) -> None:
    window = address.replace("http:", "ws:") + "window"
    origin = address[: address.index("/", 8)]
    for place, own in (
        (window, "http://evil.example"),
        (window, None),
        (f"{origin.replace('http', 'ws')}/x/window", origin),
    ):
        with pytest.raises((InvalidStatus, ConnectionClosed)), connect(place, origin=own) as strange:  # type: ignore[arg-type]
            strange.recv(timeout=30)
    with connect(window, origin=origin) as ours:  # type: ignore[arg-type]
        assert json.loads(ours.recv(timeout=60))["type"] == "scene"


def test_two_windows_do_not_see_each_others_changes(address: str) -> None:
    window, origin = address.replace("http:", "ws:") + "window", address[: address.index("/", 8)]
    change = {"type": "change", "id": 1, "selected": 1, "probe": None}
    with connect(window, origin=origin) as one, connect(window, origin=origin) as two:  # type: ignore[arg-type]
        limits = []
        for each, limit in ((one, 2.0), (two, 5.0)):
            each.recv(timeout=60)
            each.send(json.dumps({**change, "changes": {"limits.current_A": limit}}))
        for each in (one, two):
            head = each.recv(timeout=60)
            assert isinstance(head, bytes)
            limits.append(json.loads(head[4 : 4 + int.from_bytes(head[:4], "little")])["taps"][0]["input_limit"])
        assert limits == pytest.approx([2.0, 5.0])
        one.send("no JSON")
        assert "refused" in str(one.recv(timeout=60))


def test_a_busy_port_is_one_clear_line(small: Scene, address: str) -> None:
    port = urlsplit(address).port
    assert port is not None
    with pytest.raises(InputError, match=f"--port {port}: cannot be used"):
        Page(small, port=port)


def test_from_python_a_page_is_an_address_and_a_figure(small: Scene) -> None:
    served = page(small)
    try:
        assert asked(served.address, urlsplit(served.address).path)[0] == 200
        drawn = served.plot()
        assert [axes.get_title() for axes in drawn.axes[:2]] == ["grip 3 N", ""]
        shown = served._repr_html_()
        assert "data:image/png;base64," in shown
        assert "0.4" in shown
    finally:
        served.close()
    with pytest.raises(InputError, match="a scene, a library"):
        page(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        page(Path("nowhere.toml"))

"""The security rules of the studio, each against the running server."""

from __future__ import annotations

import hmac
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

pytest.importorskip("starlette", reason="needs the extra clsco[studio]")

from websockets.exceptions import ConnectionClosed, InvalidStatus

from clsco.files.png import png_parts
from clsco.studio.guard import MAX_BODY
from clsco.studio.pictures import HEADER, MESSAGE
from tests.studio.running import Running

SOCKET = "/frames?tab=none"
DEVICE = ()


def get(running: Running, path: str = "/", **headers: str) -> httpx.Response:
    given = {**running.cookie, **{name.replace("_", "-"): value for name, value in headers.items()}}
    return httpx.get(running.page + path, headers=given, timeout=30)


def status_of_socket(running: Running, path: str, headers: dict[str, str], origin: str | None) -> int:
    try:
        with running.connect(path, headers, origin):
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


def test_the_printed_address_gives_a_cookie_that_scripts_do_not_see(running: Running) -> None:
    for headers in ({}, {"Sec-Fetch-Site": "cross-site"}):  # from the file that opens it, say
        answer = httpx.get(running.address, headers=headers, timeout=30)
        assert answer.status_code == 200
        token = running.address.rpartition("=")[2]
        assert len(token) >= 43  # 256 bits
        found = re.fullmatch(
            r"clsco-[a-z2-7]{26}=([\w-]{43}); HttpOnly; SameSite=Strict; Path=(/[a-z2-7]{26})/",
            answer.headers["set-cookie"],
        )
        assert found is not None
        assert found[1] != token  # other servers of this machine may see the cookie
        assert found[2] == running.place
        assert token not in answer.text
    assert get(running).status_code == 200


def test_other_first_addresses_are_refused(running: Running) -> None:
    for query in ("t=wrong", "t=", "c=", "c=wrong", f"T={running.address.rpartition('=')[2]}"):
        assert httpx.get(f"{running.origin}/?{query}").status_code == 403


def test_the_server_proves_that_it_made_a_page(running: Running) -> None:
    (key,) = re.findall(r'data-proof="([0-9a-f]{64})"', get(running).text)
    for number in ("0" * 32, "5f" * 16):
        answer = httpx.get(f"{running.origin}/prove?{number}")
        assert answer.text == hmac.digest(bytes.fromhex(key), number.encode(), "sha256").hex()
        assert "set-cookie" not in answer.headers
    assert httpx.post(f"{running.origin}/prove?1").status_code == 403
    assert httpx.get(f"{running.origin}/prove?1", headers={"Host": "evil.example"}).status_code in (400, 403)


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example:{port}", ""]
)
@pytest.mark.parametrize("path", ["/", SOCKET])
def test_a_forged_host_is_refused(running: Running, host: str, path: str) -> None:
    forged = host.format(port=running.host.rpartition(":")[2])
    assert get(running, path, Host=forged).status_code in (400, 403)
    both = {"Host": forged, "Origin": f"http://{forged}"}  # DNS rebinding forges them alike
    assert get(running, path, **both).status_code in (400, 403)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "{own}.evil.example", "https://{host}", "{own}/"])
def test_a_foreign_origin_is_refused(running: Running, origin: str) -> None:
    foreign = origin.format(own=running.origin, host=running.host)
    assert get(running, Origin=foreign).status_code == 403
    assert status_of_socket(running, SOCKET, running.cookie, foreign) == 403


def test_requests_of_other_sites_are_refused(running: Running) -> None:
    for site in ("cross-site", "same-site"):  # another port of this machine is the same site
        assert get(running, Sec_Fetch_Site=site).status_code == 403
    assert get(running, Sec_Fetch_Site="none").status_code == 200
    assert get(running, Sec_Fetch_Site="same-origin").status_code == 200


def test_sockets_need_origin_and_token(running: Running) -> None:
    assert status_of_socket(running, SOCKET, running.cookie, running.origin) == 101
    assert status_of_socket(running, SOCKET, running.cookie, None) == 403
    assert status_of_socket(running, SOCKET, {}, running.origin) == 403
    assert status_of_socket(running, SOCKET, {**running.cookie, "Host": "evil.example"}, running.origin) in (400, 403)


def test_a_form_of_another_page_is_refused(running: Running) -> None:
    for headers in ({}, {"Origin": "null"}, {"Origin": "http://evil.example"}):
        answer = httpx.post(f"{running.page}/", data={"a": "b"}, headers={**running.cookie, **headers})
        assert answer.status_code == 403


def test_an_upload_is_counted_while_it_comes(running: Running) -> None:
    sent = 0

    def body() -> Iterator[bytes]:
        nonlocal sent
        while sent < 10 * 2**30:
            sent += 2**20
            yield bytes(2**20)

    with running.client() as client:
        assert client.post(f"/texture?tab={tab_of(running)}&kind=png", content=body()).status_code == 413
        assert sent < MAX_BODY + 2**25
        assert client.get("/").status_code == 200


def test_every_answer_has_its_headers(running: Running) -> None:
    for path in ("/", "/static/studio.js", "/no/such/page"):
        headers = get(running, path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        policy = dict(part.strip().partition(" ")[::2] for part in headers["content-security-policy"].split(";"))
        assert policy["default-src"] == "'self'"
        assert policy["object-src"] == policy["frame-ancestors"] == policy["form-action"] == "'none'"
        assert "http:" not in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert "access-control-allow-origin" not in headers


def message(data: str | bytes) -> dict[str, Any]:
    assert isinstance(data, bytes)
    found: dict[str, Any] = json.loads(data[HEADER.size :]) if HEADER.unpack_from(data)[5] == MESSAGE else {}
    return found


def tab_of(running: Running) -> str:
    found = re.search(r'data-tab="([\w-]+)"', get(running).text)
    assert found is not None
    return found[1]


def test_patches_out_of_the_root_and_too_long_ones(running: Running) -> None:
    tab = tab_of(running)
    with running.frames(tab) as opened:
        for name in ("/etc/passwd", "../../../../etc/passwd", "a/../../x.png"):
            opened.send(json.dumps({"path": "object.0.texture", "value": name}))
            while "faults" not in (said := message(opened.recv(timeout=10))) or not said["faults"]:
                pass
            assert "object.0.texture" in said["faults"]
            opened.send(json.dumps({"path": "object.0.texture", "value": "brick"}))
        opened.send("x" * (2**16 + 1))
        with pytest.raises(ConnectionClosed):
            list(opened)


def test_an_upload_that_is_no_plain_image_is_refused(running: Running, tmp_path: Path) -> None:
    drawing = b"<svg xmlns='http://www.w3.org/2000/svg'><script>alert(1)</script></svg>"
    image = b"".join(png_parts(np.full((4, 5), 7, np.uint8)))
    with running.client() as client:
        tab = tab_of(running)
        for content, kind in ((drawing, "svg"), (drawing, "png"), (image, "../x"), (image, "jpg")):
            answer = client.post("/texture", params={"tab": tab, "kind": kind}, content=content)
            assert answer.status_code == 400, (kind, answer.text)
            assert answer.headers["content-type"] == "application/json"
        assert client.post("/texture", params={"tab": "x", "kind": "png"}, content=image).status_code == 404
        answer = client.post("/texture", params={"tab": tab, "kind": "png"}, content=image)
        assert re.fullmatch(r"uploads/[0-9a-f]{20}\.png", answer.json()["name"])


PLACES = (
    "", "/", "/x", "/static/studio.js", "/sample?job=1", "/texture?tab=x&kind=png", "/frames?tab=x",
    "/scene-picture?name=x.jpg", "/result?job=1&name=x.png", "/thumbnail?tab=x&path=title", "/inpainting/mask?tab=x",
)  # fmt: skip


METHODS = ("GET", "POST", "HEAD", "PUT", "OPTIONS", "DELETE")


def test_no_request_without_all_of_it_is_answered(running: Running) -> None:
    name, _, value = running.cookie["Cookie"].partition("=")
    token = running.address.rpartition("=")[2]
    own = {"Origin": running.origin}
    wrong: list[tuple[str, dict[str, str]]] = [  # what is before the path, and what comes with it
        (running.place, {}), (running.place, {"Cookie": f"{name}={token}"}),
        (running.place, {"Cookie": f"{name}={value}x"}), (running.place, {"Cookie": f"x{name}={value}"}),
        (running.place, {"Cookie": f'{name}="{value}"'}), (running.place, {"Authorization": f"Bearer {token}"}),
        (running.place.upper(), running.cookie), (running.place[:-1], running.cookie), ("", running.cookie),
        (f"/x{running.place}", running.cookie), (f"/%2e{running.place}", running.cookie),
        (running.place, {**running.cookie, "Sec-Fetch-Site": "cross-site"}),
    ]  # fmt: skip
    count = 0
    with httpx.Client(base_url=running.origin, timeout=30) as client:
        for before, headers in wrong:
            for path in PLACES:
                for method in METHODS if headers is wrong[0][1] else METHODS[:2]:
                    answer = client.request(method, f"{before}{path}" or "/", headers={**own, **headers})
                    assert answer.status_code == 403, (method, before, path, headers)
                    assert method == "HEAD" or "clsco studio" in answer.text or "own page" in answer.text
                    count += 1
    assert count == 66 + 11 * 22


OUTSIDE = ("etc/passwd", "../guard.py", "../../../../../../../../etc/passwd")
DOTS = ("..", "%2e%2e", ".%2e", "%252e%252e", "..%2f", "..%5c", "..\\", "....//", "%c0%ae%c0%ae", "..;")


def test_no_path_leads_out(running: Running) -> None:
    with running.client() as client:
        tab = tab_of(running)
        others = ("/{}", "/scene-picture?name={}", "/result?job=1&name={}", f"/thumbnail?tab={tab}&path={{}}")
        places = [("/static/{}", path) for path in OUTSIDE] + [(place, OUTSIDE[-1]) for place in others]
        tries = [place.format(path.replace("..", dots)) for place, path in places for dots in DOTS]
        for path in dict.fromkeys(tries):
            answer = client.get(path)
            assert answer.status_code in (404, 403, 422), path
            assert b"root:" not in answer.content
            assert b"class Guard" not in answer.content

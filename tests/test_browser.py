"""The helper that other tests open pages with notices what they rely on it to notice."""

from pathlib import Path

import numpy as np
import pytest

from tests.browser import open_page

GOOD = "<title>good</title><body style='margin:0; background:#00f'><img src='data:image/gif;base64,{}'>".format(
    "R0lGODlhAQABAIAAAP8AAP///yH5BAAAAAAALAAAAAABAAEAAAICRAEAOw=="
)


def test_a_good_page_passes_and_is_seen(tmp_path: Path) -> None:
    file = tmp_path / "a good #page.html"
    file.write_text(GOOD)
    with open_page(file, width=320, height=200) as page:
        assert page.evaluate("document.title") == "good"
        picture = page.screenshot(tmp_path / "picture.png")
        page.check()
    assert picture.shape == (200, 320, 3)
    assert np.all(picture[100:, :] == [0, 0, 255])
    assert (tmp_path / "picture.png").stat().st_size > 100


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("<script>setTimeout(() => { throw new Error('late') })</script>", "late"),
        ("<script>console.error('bad', 3)</script>", "bad 3"),
        ("<script>Promise.reject(new Error('no one waits'))</script>", "no one waits"),
        ("<script src='https://example.com/library.js'></script>", "example.com"),
        ("<link rel=stylesheet href='neighbour.css'>", "neighbour.css"),
        ("<script>new WebSocket('ws://127.0.0.1:9/')</script>", "127.0.0.1:9"),
        ("<img src='data:image/png;base64,AAAA'>", "data:image/png"),
    ],
)
def test_a_page_with_a_fault_fails(tmp_path: Path, fault: str, told: str) -> None:
    file = tmp_path / "page.html"
    file.write_text(GOOD + fault)
    (tmp_path / "neighbour.css").write_text("body { color: red }")
    with open_page(file, width=320, height=200) as page:
        with pytest.raises(AssertionError, match=told):
            page.check()


def test_the_mouse_and_the_keys_reach_the_page(tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    file.write_text(
        "<button onclick='heard.push(1)'>b</button><input type=range max=4 value=2 oninput='heard.push(this.value)'>"
        "<script>heard = []; addEventListener('keydown', e => heard.push(e.key))</script>"
    )
    with open_page(file, width=320, height=200) as page:
        page.click("button")
        page.press("a")
        page.click("input")
        page.press("ArrowRight")
        assert page.wait_for("heard.length > 3 && heard") == [1, "a", "ArrowRight", "3"]

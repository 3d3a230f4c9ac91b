"""The report in a real browser: all of it is there, and a missing picture does not go unnoticed."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.browser import open_page
from touchnet.evaluation.curves import Curve, Point
from touchnet.evaluation.page import write_page
from touchnet.evaluation.pictures import Row
from touchnet.evaluation.tables import Table


@pytest.fixture
def report(tmp_path: Path) -> Path:
    picture = np.full((32, 32, 3), 200, dtype=np.uint8)
    picture[8:24, 8:24] = (20, 90, 170)
    Image.fromarray(picture).save(tmp_path / "exploration.png")
    points = [Point(8, 0.5, 0.4, 0.6), Point(16, 0.8, 0.7, 0.9)]
    path = tmp_path / "report.html"
    write_page(
        path,
        title="Made <here>",
        facts={"command": "touchnet evaluate DATA & more" + 60 * " --option"},
        tables=[Table("IoU", ["contacts", "method", "mean"], [["8", "hull", "0.500"], ["16", "hull", "n/a"]])],
        curves=[Curve("contacts", "contacts", "iou", "mean", {"hull": points, "other": points[:1]})],
        rows=[Row("ball/round", ["truth", "hull", "failed"], [picture, picture, None])],
        exploration=tmp_path / "exploration.png",
        definitions=["iou: volume < union"],
    )
    return path


def test_the_page_shows_everything_without_a_network(report: Path) -> None:
    with open_page(report) as page:
        page.check()
        assert page.evaluate("document.querySelectorAll('table.figures tbody tr').length") == 2
        assert page.evaluate("document.images.length") == 4  # a curve, two tiles, the exploration
        widths = page.evaluate("[...document.images].map(image => image.naturalWidth)")
        assert min(widths) >= 32
        said = page.evaluate("document.body.innerText")
        for words in (
            "Made <here>",
            "DATA & more",
            "n/a",
            "no surface",
            "volume < union",
            "ball/round",
            "Against contacts",
        ):
            assert words in said
        assert page.screenshot(whole=True).std() > 5
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_a_missing_picture_is_noticed(report: Path) -> None:
    whole = report.read_text()
    start = whole.index("data:image/png;base64,")
    report.write_text(whole[:start] + "data:image/png;base64,AAAA" + whole[whole.index('"', start) :])
    with open_page(report) as page:
        assert page.broken_pictures
        with pytest.raises(AssertionError):
            page.check()
    report.write_text(whole[:start] + "gallery/missing.png" + whole[whole.index('"', start) :])
    with open_page(report) as page, pytest.raises(AssertionError):
        page.check()

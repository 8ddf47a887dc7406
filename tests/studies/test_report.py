"""Reports are complete in one file and escape what they are given."""

from __future__ import annotations

from html.parser import HTMLParser

import numpy as np
import pytest

from iga.errors import InputError
from studies.figures import plot_heat_table
from studies.report import Picture, Section, write_report
from studies.table import Column, Slope, table


class Page(HTMLParser):
    """Collects tags, links and whether all tags are closed."""

    def __init__(self):
        super().__init__()
        self.open, self.sources, self.tags = [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.sources += [value for key, value in attributes if key in ("src", "href")]
        if tag not in ("meta", "img", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_is_whole_and_self_contained(tmp_path):
    plot_heat_table(tmp_path / "table.png", ["a"], ["x"], np.array([[1.0]]))
    columns = (Column("cell", "text", key=True), Column("h", key=True), Column("error"), Column("t", "time", "s"))
    rows = [(cell, 0.5**k, 0.25**k, None) for cell in ("tets <1>", "hexes") for k in range(3)]
    made = table("t", columns, rows, [Slope("h", "error", ("cell",), 2.0)])
    sections = [
        Section("One & two", "First.\n\nSecond <b>.", made, (Picture(tmp_path / "table.png", 'It "says"', True),)),
        Section("Rest", note="The end."),
    ]
    path = write_report(tmp_path / "index.html", "A report", "What it is.", sections)
    text = path.read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert page.open == []
    assert page.tags.count("table") == 2
    assert page.tags.count("section") == 2
    assert all(source.startswith(("#", "data:image/png;base64,")) for source in page.sources)
    assert "tets &lt;1&gt;" in text
    assert "http" not in text
    assert "prefers-color-scheme: dark" in text


def test_missing_picture_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.png: cannot be read"):
        write_report(tmp_path / "i.html", "t", "l", [Section("s", pictures=(Picture(tmp_path / "none.png", ""),))])
    with pytest.raises(InputError, match="png, svg or jpg"):
        write_report(tmp_path / "i.html", "t", "l", [Section("s", pictures=(Picture(tmp_path / "a.gif", ""),))])
    assert not (tmp_path / "i.html").exists()

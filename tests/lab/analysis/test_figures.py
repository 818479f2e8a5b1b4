"""Test the files of the analysis's figures."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

from tacbench_cad.lab.analysis.figures import new_figure, save, styled
from tacbench_cad.util.plotting import save_figure


def test_text_in_a_pdf_file_can_be_searched(tmp_path: Path) -> None:
    with styled():
        figure = new_figure(3.0, 2.0)
        figure.suptitle("variance")
        save_figure(figure, tmp_path / "figure.pdf")
    data = (tmp_path / "figure.pdf").read_bytes()
    assert b"/CIDFontType2" in data and b"/Type3" not in data


def test_figures_of_simulated_data_are_marked_in_metadata_and_once_below(tmp_path: Path) -> None:
    from PIL import Image

    sizes = {}
    for stem, simulated in {"real": (), "virtual": ("sensor: a formula", "stage: none")}.items():
        with styled():
            figure = new_figure(3.0, 2.0)
            picture, document = save(figure, tmp_path / stem, simulated)
        assert not figure.texts, "only the files have the mark"
        with Image.open(picture) as image:
            sizes[stem] = image.size
            assert (image.convert("L").getextrema()[0] < 200) == bool(simulated), "the drawing adds only the mark"
            expected = "simulated data: sensor: a formula; stage: none" if simulated else None
            assert image.info.get("Description") == expected
        assert (b"/Subject (simulated data: sensor: a formula; stage: none)" in document.read_bytes()) == bool(
            simulated
        )
    assert sizes["virtual"][0] == sizes["real"][0] and 10 < sizes["virtual"][1] - sizes["real"][1] < 40

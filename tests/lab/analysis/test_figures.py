"""Figures of the analysis: what their files hold."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

from tacbench_cad.lab.analysis.figures import new_figure, styled
from tacbench_cad.util.plotting import save_figure


@pytest.mark.usefixtures("own_pdf_fonts")
def test_letters_in_a_pdf_file_can_be_searched(tmp_path: Path) -> None:
    with styled():
        figure = new_figure(3.0, 2.0)
        figure.suptitle("variance")
        save_figure(figure, tmp_path / "figure.pdf", "pdf")
    data = (tmp_path / "figure.pdf").read_bytes()
    assert b"/CIDFontType2" in data and b"/Type3" not in data

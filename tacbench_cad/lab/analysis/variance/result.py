"""The result of ``tacbench variance``: its tables, notes and figures, for terminal, JSON, files and report."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.lab.analysis.conclusions import shown_answers
from tacbench_cad.lab.analysis.tables import Shown, records, write_csv, write_settings
from tacbench_cad.lab.analysis.variance import shown_tables
from tacbench_cad.lab.analysis.variance.cells import shown_levels
from tacbench_cad.lab.analysis.variance.notes import variance_notes, variance_warnings
from tacbench_cad.lab.analysis.variance.variance_data import VarianceData
from tacbench_cad.util.files import locked

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The name of the settings file beside the tables.
SETTINGS_FILE = "variance_settings.json"


class Variance(VarianceData):
    """The variance table of a study, with its components, tests and maps."""

    @property
    def notes(self) -> list[str]:
        """Notes that explain the tables."""
        return variance_notes(self)

    @property
    def warnings(self) -> list[str]:
        """The warnings about the data, one sentence each."""
        return variance_warnings(self)

    def shown(self) -> Iterator[tuple[str, Shown]]:
        """Yield the tables for readers, each with the name of the CSV file that has all digits."""
        if len(self.answers):
            yield "printer_answers", shown_answers(self.answers)
        for level in shown_levels(self.table):
            yield "variance", shown_tables.level_table(self, level)
        if "components" in self.tables:
            yield "components", shown_tables.component_table(self)
        if len(self.tables.get("permutation", ())):
            yield "permutation", shown_tables.permutation_table(self)
        if "registration" in self.tables:
            yield "registration", shown_tables.seating_table(self)

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        tables = {name: records(table) for name, table in self.tables.items()}
        simulated = list(self.design.simulated)
        return {"simulated": simulated, **self.settings, **tables, "notes": self.notes, "warnings": self.warnings}

    def figure(self) -> Figure:
        """Draw the table as points with intervals, one panel for each force.

        Raises:
            MissingToolError: matplotlib is not installed.
        """
        from tacbench_cad.lab.analysis.figures import styled
        from tacbench_cad.lab.analysis.variance.variance_figures import table_figure

        with styled():
            return table_figure(self)

    def save(self, folder: str | Path) -> list[Path]:
        """Write every table as CSV, the settings as JSON, and every figure as PNG and PDF.

        Args:
            folder: The folder; it is created if it does not exist.

        Returns:
            The paths of the files.

        Raises:
            InputError: The folder cannot be written, or another process is writing to it.
            MissingToolError: matplotlib is not installed. The tables are written nevertheless.
        """
        from tacbench_cad.lab.analysis.variance.variance_figures import draw_all

        path, simulated = Path(folder), self.design.simulated
        with locked(path):
            written = [write_csv(path / f"{name}.csv", table, simulated) for name, table in self.tables.items()]
            return [*written, write_settings(path / SETTINGS_FILE, self.settings), *draw_all(self, path)]

"""The README.md of exported data, which describes the data, the columns, and how to load them."""

from __future__ import annotations

from tacbench_cad.extensions.exchange.exporting.exported_frames import Samples
from tacbench_cad.util.text import counted, natural

#: The sentence about data that no format contains, for runs with series.
NO_SERIES = "The series of moving frames after the presses are not included."


def summary(samples: Samples) -> str:
    """Describe the exported data in three sentences."""
    kind = "data of a sensor" if samples.not_images else "images"
    devices = "; ".join(samples.simulated)
    origin = f"These are simulated data ({devices})." if devices else "Nothing is marked as simulated."
    labels = [label for label in samples.labels if label is not None]
    return (
        f"Tactile {kind}: {counted(len(samples), 'frame')}, from "
        f"{counted(len(samples.runs), 'run')} with {counted(len(labels), 'label')}. {origin} "
        "Frames without contact are not included." + (" " + NO_SERIES if samples.series else "")
    )


#: The sentence about the colours, for every format.
COLOURS = "Images in colours have the channels in the order red, green, blue (RGB)."


def card(samples: Samples, loading: str) -> str:
    """Return the README.md.

    Args:
        samples: The exported samples.
        loading: The lines of Python that load them.
    """
    labels = [
        f"| {'unknown' if label is None else label} | {count} |"
        for label, count in sorted(samples.labels.items(), key=lambda item: natural(item[0] or ""))
    ]
    columns = []
    for column in samples.columns:
        missing = samples.unknown[column.name]
        note = f" Unknown for {missing} of {len(samples)}." if missing else ""
        columns.append(f"| `{column.name}` | {column.description}{note} |")
    return "\n".join(
        [
            "# Tactile frames",
            "",
            summary(samples),
            "",
            "```python",
            loading,
            "```",
            "",
            "All frames are in one split. The frames of a print resemble each other, so a random test set would "
            "contain frames much like those of the training set. Put all frames of a print (`run`, `printer`, "
            "`filament`, `copy`) into the same set.",
            "",
            COLOURS,
            "",
            "| label | frames |",
            "|---|---|",
            *labels,
            "",
            "| column | meaning |",
            "|---|---|",
            *columns,
            "",
        ]
    )

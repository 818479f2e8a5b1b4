"""The page that lies beside exported data: what they are, what each column says, how to load them."""

from __future__ import annotations

from tacbench_cad.lab.runs.exporting.samples import Samples
from tacbench_cad.util.text import counted


def summary(samples: Samples) -> str:
    """What was exported, in three sentences."""
    kind = "data of a sensor" if samples.not_images else "images"
    told = "; ".join(samples.simulated)
    origin = f"Simulated data, not measured ones ({told})." if told else "Nothing is marked as simulated."
    labels = [label for label in samples.labels if label is not None]
    return (
        f"Tactile {kind}: {counted(len(samples), 'frame')}, from "
        f"{counted(len(samples.runs), 'run')} with {counted(len(labels), 'label')}. {origin} "
        "Frames without contact are not among them."
    )


def card(samples: Samples, loading: str) -> str:
    """The page as Markdown.

    Args:
        samples: What was exported.
        loading: Lines of Python that load it.
    """
    labels = [
        f"| {'unknown' if label is None else label} | {count} |"
        for label, count in sorted(samples.labels.items(), key=lambda item: item[0] or "")
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
            "Everything is in one split. Frames of one print are alike: a test set drawn at random from them holds "
            "what the training set holds already. Keep whole prints (`run`, `printer`, `filament`, `copy`) apart.",
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
